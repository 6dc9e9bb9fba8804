// The plan of a navigation: time to go from any state, and the way that makes it least.

import { arrayOf } from "./numbers.js";

const LEVELS = 65535; // steps of a value
const FLOOR = 1e-30; // least value: about seventy scales of time

export class Plan {
  /** @param packed of the run; values lie on a lattice of positions, or of velocities
   * and positions where there is inertia. */
  constructor(packed) {
    const { ahead: look, ...rest } = packed;
    Object.assign(this, rest, { look });
    this.values = arrayOf(packed.values).map((level) => level / LEVELS);
    this.shape = packed.values.shape;
    this.corners = new Int32Array(16); // of a cell of the lattice
    this.weights = new Float64Array(16);
    this.rate = PROGRAMS[packed.steered.program].rate();
  }

  /** Time to go [T] from a state: great where the goal is out of reach. */
  timeFrom(y) {
    const state = this.shape.length === 4 ? [y[2] ?? 0, y[3] ?? 0, y[0], y[1]] : y;
    const value = this.interpolate(state);
    return -this.scale * Math.log(Math.max(value, FLOOR));
  }

  /** The same from rest, as the map shows it: nothing outside or out of reach. */
  shownTime([x, y]) {
    const [[x0, y0], [x1, y1]] = this.arena;
    if (x < x0 || x > x1 || y < y0 || y > y1) return NaN;
    if (this.discs.some(([a, b, radius]) => Math.hypot(x - a, y - b) < radius)) return NaN;
    const time = this.timeFrom([x, y, 0, 0]);
    return time > this.horizon ? NaN : time;
  }

  /** Linear in every coordinate; constant beyond the lattice. */
  interpolate(state) {
    const { shape, values, lower, spacing, corners, weights } = this;
    let count = 1;
    corners[0] = 0;
    weights[0] = 1;
    for (let d = 0; d < shape.length; d++) {
      const place = Math.min(Math.max((state[d] - lower[d]) / spacing[d], 0), shape[d] - 1);
      const cell = Math.min(Math.floor(place), shape[d] - 2);
      const share = place - cell;
      for (let i = 0; i < count; i++) {
        const corner = corners[i] * shape[d] + cell;
        corners[i] = corner;
        corners[count + i] = corner + 1;
        weights[count + i] = weights[i] * share;
        weights[i] *= 1 - share;
      }
      count *= 2;
    }
    let total = 0;
    for (let i = 0; i < count; i++) total += weights[i] * values[corners[i]];
    return total;
  }

  /** One Runge-Kutta step under a thrust. */
  ahead(y, thrust, duration) {
    const k = [0, 1, 2, 3].map(() => new Float64Array(y.length));
    const along = (slope, part) => y.map((value, i) => value + part * duration * slope[i]);
    this.rate(0, y, thrust, k[0]);
    this.rate(0, along(k[0], 0.5), thrust, k[1]);
    this.rate(0, along(k[1], 0.5), thrust, k[2]);
    this.rate(0, along(k[2], 1), thrust, k[3]);
    return y.map((value, i) => value + (duration / 6) * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]));
  }

  /** The way from a state, without noise and delay: {states, arrival [T]}. */
  route(start) {
    const { goal, tolerance, step, horizon, thrusts } = this;
    let y = Float64Array.from(start);
    const states = [y];
    for (let t = 0; t < horizon; t += step) {
      const distance = Math.hypot(y[0] - goal[0], y[1] - goal[1]);
      if (distance <= tolerance) return { states, arrival: t };
      let best = Infinity;
      let chosen = thrusts[0];
      for (const thrust of thrusts) {
        const time = this.timeFrom(this.ahead(y, thrust, this.look));
        if (time < best) [best, chosen] = [time, thrust];
      }
      y = this.ahead(y, chosen, step);
      states.push(y);
      if (!y.every(Number.isFinite)) break;
    }
    return { states, arrival: Infinity };
  }
}
