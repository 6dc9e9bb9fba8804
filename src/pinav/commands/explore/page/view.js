// Drawing: the map with its axes, curves over it, and plots of curves beside it.

import { PAPER, colourOf, through } from "./colours.js";
import { shown } from "./numbers.js";

const MARGIN = { left: 46, right: 20, top: 10, bottom: 34 };

/** Between places and pixels of a canvas; one unit is as long along both axes. */
export class Frame {
  constructor(canvas, box, square = true) {
    const ratio = Math.min(globalThis.devicePixelRatio || 1, 2);
    const { clientWidth: width, clientHeight: height } = canvas;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    this.context = canvas.getContext("2d");
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    Object.assign(this, { width, height, box });
    this.inner = [width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom];
    this.sx = this.inner[0] / (box[1] - box[0]);
    this.sy = this.inner[1] / (box[3] - box[2]);
    if (square) this.sx = this.sy = Math.min(this.sx, this.sy);
  }

  px(x) {
    return MARGIN.left + (x - this.box[0]) * this.sx;
  }

  py(y) {
    return MARGIN.top + (this.box[3] - y) * this.sy;
  }

  place(px, py) {
    return [this.box[0] + (px - MARGIN.left) / this.sx, this.box[3] - (py - MARGIN.top) / this.sy];
  }

  clear() {
    this.context.clearRect(0, 0, this.width, this.height);
  }

  clip(draw) {
    const { context: c } = this;
    c.save();
    c.beginPath();
    c.rect(this.px(this.box[0]), this.py(this.box[3]), (this.box[1] - this.box[0]) * this.sx, (this.box[3] - this.box[2]) * this.sy);
    c.clip();
    draw(c);
    c.restore();
  }

  /** A frame with ticks and the names of its axes. */
  axes(horizontal, vertical, ink) {
    const { context: c, box } = this;
    const [left, right, top, bottom] = [this.px(box[0]), this.px(box[1]), this.py(box[3]), this.py(box[2])];
    c.strokeStyle = c.fillStyle = ink;
    c.lineWidth = 1;
    c.font = "12px system-ui, sans-serif";
    c.strokeRect(left, top, right - left, bottom - top);
    c.textAlign = "center";
    c.textBaseline = "top";
    for (const tick of ticks(box[0], box[1], Math.max(2, (right - left) / 70))) {
      line(c, [[this.px(tick), bottom], [this.px(tick), bottom + 4]]);
      c.fillText(shown(tick, 4), this.px(tick), bottom + 5);
    }
    c.fillText(horizontal, (left + right) / 2, bottom + 19);
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (const tick of ticks(box[2], box[3], Math.max(2, (bottom - top) / 45))) {
      line(c, [[left - 4, this.py(tick)], [left, this.py(tick)]]);
      c.fillText(shown(tick, 4), left - 6, this.py(tick));
    }
    c.save();
    c.translate(10, (top + bottom) / 2);
    c.rotate(-Math.PI / 2);
    c.textAlign = "center";
    c.fillText(vertical, 0, 0);
    c.restore();
  }

  /** A curve through places; `dash` and a white casing where it lies on colours. */
  curve(points, colour, { width = 2, dash = [], casing = false, alpha = 1 } = {}) {
    const pixels = points.map((point) => [this.px(point[0]), this.py(point[1])]);
    this.clip((c) => {
      c.lineJoin = c.lineCap = "round";
      c.globalAlpha = alpha;
      if (casing) {
        c.strokeStyle = through(PAPER, 0.85);
        c.lineWidth = width + 3;
        line(c, pixels);
      }
      c.setLineDash(dash);
      c.strokeStyle = colour;
      c.lineWidth = width;
      line(c, pixels);
    });
  }

  /** The area between two curves over the same horizontal places. */
  area(lower, upper, colour, alpha = 0.25) {
    this.clip((c) => {
      c.globalAlpha = alpha;
      c.fillStyle = colour;
      c.beginPath();
      [...upper, ...lower.slice().reverse()].forEach(([x, y], i) =>
        i ? c.lineTo(this.px(x), this.py(y)) : c.moveTo(this.px(x), this.py(y)),
      );
      c.fill();
    });
  }

  dot([x, y], colour, radius = 4, filled = true) {
    this.clip((c) => {
      c.beginPath();
      c.arc(this.px(x), this.py(y), radius, 0, 2 * Math.PI);
      c.fillStyle = filled ? colour : through(PAPER, 0.9);
      c.strokeStyle = filled ? PAPER : colour;
      c.lineWidth = filled ? 1.5 : 2.5;
      c.fill();
      c.stroke();
    });
  }

  arrow([x0, y0], [x1, y1], colour, width = 2) {
    const [a, b] = [[this.px(x0), this.py(y0)], [this.px(x1), this.py(y1)]];
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (length < 1) return;
    const [ux, uy] = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    const head = Math.min(9, 0.5 * length);
    this.clip((c) => {
      c.strokeStyle = colour;
      c.lineWidth = width;
      line(c, [a, b]);
      line(c, [
        [b[0] - head * (ux - 0.5 * uy), b[1] - head * (uy + 0.5 * ux)],
        b,
        [b[0] - head * (ux + 0.5 * uy), b[1] - head * (uy - 0.5 * ux)],
      ]);
    });
  }
}

function line(c, points) {
  c.beginPath();
  points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
  c.stroke();
}

/** Round numbers between two ends, about so many. */
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw) ?? raw;
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, i) => (first + i) * step);
}

/** Ends of the colour scale: robust against the few greatest numbers; zero amid signs. */
export function limitsOf(values, signed) {
  const sorted = Float64Array.from(values.filter(Number.isFinite)).sort();
  if (!sorted.length) return [0, 1];
  const at = (share) => sorted[Math.round(share * (sorted.length - 1))];
  if (signed) {
    const most = Math.max(Math.abs(at(0.01)), Math.abs(at(0.99)), 1e-300);
    return [-most, most];
  }
  const high = at(0.99);
  return [Math.min(at(0), 0), high > 0 ? high : 1];
}

/** A grid of numbers as an image of colours. */
export function imageOf(grid, limits, signed) {
  const { values, count, columns = count, rows = count } = grid;
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [columns, rows];
  const c = canvas.getContext("2d");
  const image = c.createImageData(columns, rows);
  for (let j = 0; j < rows; j++) {
    for (let i = 0; i < columns; i++) {
      const value = values[(rows - 1 - j) * columns + i];
      const share = (value - limits[0]) / (limits[1] - limits[0]);
      const place = 4 * (j * columns + i);
      image.data.set(Number.isFinite(value) ? colourOf(share, signed) : [200, 200, 200], place);
      image.data[place + 3] = 255;
    }
  }
  c.putImageData(image, 0, 0);
  return canvas;
}

/** The colour scale, from left to right. */
export function drawScale(canvas, signed) {
  canvas.width = 256;
  canvas.height = 1;
  const c = canvas.getContext("2d");
  const image = c.createImageData(256, 1);
  for (let i = 0; i < 256; i++) image.data.set([...colourOf(i / 255, signed), 255], 4 * i);
  c.putImageData(image, 0, 0);
}

/**
 * A plot of curves over a common axis.
 *
 * @param curves [{points: [[x, y]], sd: [numbers] or none, colour, dash}]
 * @param now a place of the axis that a line marks, if any.
 */
export function plot(canvas, curves, names, ink, now = null) {
  const ys = curves.flatMap(({ points, sd }) =>
    points.flatMap(([, y], i) => (sd ? [y - 2 * sd[i], y + 2 * sd[i]] : [y])),
  );
  const xs = curves.flatMap(({ points }) => points.map(([x]) => x));
  const finite = ys.filter(Number.isFinite);
  if (!xs.length || !finite.length) return;
  let [low, high] = [finite.reduce((a, b) => Math.min(a, b)), finite.reduce((a, b) => Math.max(a, b))];
  if (low === high) [low, high] = [low - 1, high + 1];
  const margin = 0.06 * (high - low);
  const [first, last] = [xs.reduce((a, b) => Math.min(a, b)), xs.reduce((a, b) => Math.max(a, b))];
  const frame = new Frame(canvas, [first, last, low - margin, high + margin], false);
  frame.clear();
  for (const { points, sd, colour } of curves) {
    if (!sd) continue;
    const edge = (sign) => points.map(([x, y], i) => [x, y + sign * 1.96 * sd[i]]);
    frame.area(edge(-1), edge(1), colour);
  }
  for (const { points, colour, dash, width = 2, dots } of curves) {
    if (dots) points.forEach((point) => frame.dot(point, colour, 1.6));
    else frame.curve(points, colour, { dash, width });
  }
  if (now !== null) frame.curve([[now, low - margin], [now, high + margin]], ink, { width: 1 });
  frame.axes(names[0], names[1], ink);
}

