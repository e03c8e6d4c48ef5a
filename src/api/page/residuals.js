// A route's residual series: each closure's ΔF on a logarithmic scale, with zoom along the series.

import { button, iconButton, make } from "./dom.js";
import { get, routePath } from "./http.js";
import { TEXTS } from "./texts.js";

/** @typedef {import("./types").ResidualEntry} ResidualEntry */

const SVG = "http://www.w3.org/2000/svg";
const POINTS_MAX = 2000;
const LEAST = 1e-9;
const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [800, 360, 64, 10, 12, 32];
const T = TEXTS.residuals;

/**
 * @param {Element} parent
 * @param {string} name
 * @param {Record<string, string | number>} attributes
 * @param {string} [text]
 */
function draw(parent, name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  if (text) made.textContent = text;
  parent.append(made);
  return made;
}

class Chart {
  /** @param {import("./types").ResidualSeries} series */
  constructor(series) {
    this.series = series;
    this.all = { from: 1, to: series.entries.at(-1)?.n ?? 1 };
    this.window = { ...this.all };
    this.svg = document.createElementNS(SVG, "svg");
    this.svg.setAttribute("viewBox", "0 0 " + WIDTH + " " + HEIGHT);
    this.svg.setAttribute("role", "img");
    this.svg.setAttribute("aria-label", T.label);
    this.svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY / 400), (event.offsetX / this.svg.clientWidth * WIDTH - LEFT) / (WIDTH - LEFT - RIGHT));
    }, { passive: false });
    this.draw();
  }

  /**
   * @param {number} factor of the closures that are seen
   * @param {number} about where they stay, 0 to 1
   */
  zoom(factor, about = 0.5) {
    const { from, to } = this.window;
    const length = Math.min(Math.max((to - from) * factor, 10), this.all.to - this.all.from);
    this.show(from + (to - from - length) * Math.min(Math.max(about, 0), 1), length);
  }

  /** @param {number} share of the window to the right */
  pan(share) {
    const length = this.window.to - this.window.from;
    this.show(this.window.from + length * share, length);
  }

  /**
   * @param {number} from
   * @param {number} length
   */
  show(from, length) {
    const first = Math.min(Math.max(from, this.all.from), this.all.to - length);
    this.window = { from: first, to: first + length };
    this.draw();
  }

  draw() {
    const { from, to } = this.window;
    const seen = this.series.entries.filter(({ n }) => n >= from && n <= to);
    const values = seen.map(({ delta_f }) => Math.max(delta_f, LEAST));
    const { threshold } = this.series;
    const all = threshold ? [...values, threshold] : values;
    const [low, high] = [Math.floor(Math.log10(Math.min(...all, 1))), Math.ceil(Math.log10(Math.max(...all, LEAST * 10)))];
    const x = (/** @type {number} */ n) => LEFT + (WIDTH - LEFT - RIGHT) * (n - from) / Math.max(to - from, 1);
    const y = (/** @type {number} */ value) => HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (Math.log10(Math.max(value, LEAST)) - low) / Math.max(high - low, 1);
    this.svg.replaceChildren();
    for (let decade = low; decade <= high; decade += Math.ceil((high - low) / 8)) {
      draw(this.svg, "line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: y(10 ** decade), y2: y(10 ** decade) });
      draw(this.svg, "text", { class: "tick", x: LEFT - 8, y: y(10 ** decade) + 4, "text-anchor": "end" }, "1e" + decade);
    }
    for (const part of [0, 0.5, 1]) {
      const n = Math.round(from + (to - from) * part);
      draw(this.svg, "text", { class: "tick", x: x(n), y: HEIGHT - 10, "text-anchor": ["start", "middle", "end"][part * 2] }, String(n));
    }
    for (const [k, entry] of seen.entries()) {
      const dot = draw(this.svg, "circle", { class: "dot " + entry.verdict, cx: x(entry.n).toFixed(1), cy: y(values[k]).toFixed(1), r: entry.verdict === "contradiction" ? 4 : 2.5 });
      draw(dot, "title", {}, T.entry(entry));
    }
    if (threshold) draw(this.svg, "line", { class: "threshold", x1: LEFT, x2: WIDTH - RIGHT, y1: y(threshold), y2: y(threshold) });
  }
}

/** @param {string} route */
export async function residuals(route) {
  /** @type {import("./types").ResidualSeries} */
  const series = await get(routePath(route) + "/residuals?max_points=" + POINTS_MAX);
  if (series.entries.length === 0) return make("p", "quiet", TEXTS.nothing);
  const chart = new Chart(series);
  const tools = make("div", "row", iconButton("+", TEXTS.zoomIn, () => chart.zoom(0.5)), iconButton("−", TEXTS.zoomOut, () => chart.zoom(2)),
    iconButton("‹", T.earlier, () => chart.pan(-0.5)), iconButton("›", T.later, () => chart.pan(0.5)), button(TEXTS.fit, () => chart.zoom(Infinity)));
  const figure = make("figure", "chart", make("figcaption", "quiet", T.caption(series.entries.length, series.threshold)), tools);
  figure.append(chart.svg);
  return figure;
}
