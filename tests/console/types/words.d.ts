// What /words.js exports; the service makes it of its own enumerations.

export const KINDS: Map<string, string>;
export const ACTIONS: Map<string, string>;
export const STATUSES: Map<string, string>;
export const DOUBTS: Map<string, string>;
export const REASONS: Map<string, string>;
