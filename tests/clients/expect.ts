// What both stories of a route ask of answers, and the arguments of a story: node STORY URL KEY.

/** The arguments of the program, whose types are not there without those of Node.js. */
export const [url = "", key = ""] = (globalThis as unknown as { process: { argv: string[] } }).process.argv.slice(2);

export function expect(holds: boolean, what: unknown): asserts holds {
  if (!holds) throw new Error("not as expected: " + JSON.stringify(what));
}

export const sleep = (ms: number) => new Promise<void>((resolve) => { setTimeout(resolve, ms); });
