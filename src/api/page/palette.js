// Colours for what is painted, read from the style sheet once and again when light and dark change.

const NAMES = ["ink", "paper", "ground", "unknown", "free", "occupied", "appeared", "gone", "doubt", "quiet", "accent", "alarm", "on-mark"];
/** Colours that differ for most eyes (Okabe and Ito, darkened for a white ground). */
const VEHICLES = ["#0072b2", "#b35900", "#00785a", "#a8497f", "#5b4bb0", "#7a6a00", "#00788f", "#b3261e"];
const VEHICLES_DARK = ["#56b4e9", "#e69f00", "#2fc79a", "#dd8fc0", "#a79bf0", "#d8c84a", "#4cc9dd", "#ff8a80"];

export const dark = matchMedia("(prefers-color-scheme: dark)");
/** @type {Record<string, string> | null} */
let colours = null;
/** @type {Map<string, number>} */
const vehicles = new Map();

/** The colours by name. */
export function palette() {
  if (colours) return colours;
  const style = getComputedStyle(document.documentElement);
  colours = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue("--" + name).trim()]));
  return colours;
}
dark.addEventListener("change", () => { colours = null; });

/**
 * The same colour for a vehicle wherever it is shown.
 * @param {string} vehicle
 */
export function vehicleColour(vehicle) {
  if (!vehicles.has(vehicle)) vehicles.set(vehicle, vehicles.size);
  const all = dark.matches ? VEHICLES_DARK : VEHICLES;
  return all[(vehicles.get(vehicle) ?? 0) % all.length];
}
