// Lines and dots over the map, as many as there are: painted into a picture off the screen, a part a
// frame, and laid over the map until it no longer fits.

import { moved, view } from "./map_view.js";

/** @typedef {import("./map_view.js").Window} Window */

/** The picture is larger than the window, so that one can move before it is painted anew. */
const OVERSIZE = 1.5;
const BUDGET_MS = 6;
/** After a zoom has rested so long the picture is painted sharp again. */
const REST_MS = 150;

export class Overlay {
  /** @param {(pen: CanvasRenderingContext2D, window: Window) => Generator<void>} paint yields now and then */
  constructor(paint) {
    this.paint = paint;
    /** @type {{canvas: HTMLCanvasElement, window: Window} | null} */
    this.front = null;
    this.isStale = true;
    /** @type {Generator<void> | null} */
    this.job = null;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.rest = undefined;
  }

  /** What is painted has changed. */
  drop() {
    this.isStale = true;
    moved();
  }

  /**
   * Draws what there is; the pen measures in pixels.
   * @param {CanvasRenderingContext2D} pen
   * @param {number} ratio device pixels a pixel
   */
  draw(pen, ratio) {
    if (this.front) {
      const { canvas, window } = this.front;
      const size = view.scale / window.scale;
      const x = view.width / 2 + (window.x - view.x) * view.scale - (window.width / 2) * size;
      const y = view.height / 2 - (window.y - view.y) * view.scale - (window.height / 2) * size;
      pen.drawImage(canvas, x, y, window.width * size, window.height * size);
    }
    if (this.job) return;
    if (this.isStale || !this.covers()) { this.begin(ratio); return; }
    clearTimeout(this.rest);
    if (this.front?.window.scale !== view.scale) this.rest = setTimeout(() => { if (!this.job) this.begin(ratio); }, REST_MS);
  }

  /** Whether the picture reaches over the whole window, and is not blurred beyond use. */
  covers() {
    if (!this.front) return false;
    const { window } = this.front;
    const size = view.scale / window.scale;
    const slack = (/** @type {number} */ own, /** @type {number} */ seen) => (own * size - seen) / 2;
    return size > 0.5 && size < 2
      && Math.abs(window.x - view.x) * view.scale <= slack(window.width, view.width)
      && Math.abs(window.y - view.y) * view.scale <= slack(window.height, view.height);
  }

  /** @param {number} ratio */
  begin(ratio) {
    this.isStale = false;
    const window = { x: view.x, y: view.y, scale: view.scale, width: Math.ceil(view.width * OVERSIZE), height: Math.ceil(view.height * OVERSIZE) };
    const canvas = document.createElement("canvas");
    canvas.width = window.width * ratio;
    canvas.height = window.height * ratio;
    const pen = canvas.getContext("2d", { willReadFrequently: true });
    if (!pen) return;
    pen.scale(ratio, ratio);
    const job = this.paint(pen, window);
    this.job = job;
    const step = () => {
      const end = performance.now() + BUDGET_MS;
      let isDone = false;
      while (!isDone && performance.now() < end) {
        isDone = job.next().done ?? true;
        // Reading a pixel paints what was recorded: else all of it would be painted in one frame at the end.
        pen.getImageData(0, 0, 1, 1);
      }
      if (!isDone) { requestAnimationFrame(step); return; }
      this.job = null;
      this.front = { canvas, window };
      moved();
    };
    step();
  }
}
