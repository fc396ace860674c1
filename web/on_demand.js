// A canvas that is drawn when it has to be, at most once per frame of the display, in the colours of the theme.

import { colours, onTheme } from "./dom.js";

export class OnDemand {
  /** Duration of the last drawing. */
  drawMs = 0;
  #isDirty = false;

  /** `draw()` draws the canvas. `names` are the custom properties whose colours it uses; `onChange` is called when these, or the size of the canvas, change. */
  constructor(canvas, names, draw, onChange = () => this.invalidate()) {
    this.canvas = canvas;
    this.ctx = canvas.getContext("2d");
    this.draw = draw;
    const readColours = () => {
      this.colours = colours(names);
      onChange();
    };
    onTheme(readColours);
    // Not before the owner of this object knows it.
    this.colours = colours(names);
    new ResizeObserver(onChange).observe(canvas);
  }

  /** Draws with the next frame of the display. */
  invalidate() {
    if (this.#isDirty) return;
    this.#isDirty = true;
    requestAnimationFrame(() => {
      this.#isDirty = false;
      const beganMs = performance.now();
      this.draw();
      this.drawMs = performance.now() - beganMs;
    });
  }

  /**
   * Makes the canvas as large as its place on the page, and clears it: {width, height, ratio} in pixels of the page, and how
   * many of the canvas each of them has. Null if there is no room.
   */
  clear() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width < 50 || height < 10) return null;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const size = [width, height].map((length) => Math.round(length * ratio));
    if (this.canvas.width !== size[0] || this.canvas.height !== size[1]) [this.canvas.width, this.canvas.height] = size;
    this.ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.ctx.clearRect(0, 0, width, height);
    return { width, height, ratio };
  }
}

/** Draws columns {first, low, high, last, isWhole} as a line, which ends at every gap. `x(i)` and `y(value)` are its place. */
export function drawColumns(ctx, columns, x, y) {
  ctx.beginPath();
  let isPenDown = false;
  columns.forEach((found, i) => {
    if (!found) {
      isPenDown = false;
      return;
    }
    const at = x(i);
    if (isPenDown && found.isWhole) ctx.lineTo(at, y(found.first));
    else ctx.moveTo(at, y(found.first));
    if (found.low !== found.high) {
      for (const value of [found.high, found.low, found.last]) ctx.lineTo(at, y(value));
    } else if (!found.isWhole) {
      // A row beside a gap, which no line reaches.
      ctx.lineTo(at, y(found.first) + 1);
    }
    isPenDown = found.isWhole;
  });
  ctx.stroke();
}
