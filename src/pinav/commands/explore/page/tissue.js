// Pennes' equation along a radius: temperature and thermal dose under a protocol.

import { arrayOf } from "./numbers.js";

const BREAK = 43; // °C at which the rate of CEM43 changes
const CUTOFF = 37; // °C below which nothing counts

/** The heat balance of a run, ready to be integrated. */
export class Tissue {
  constructor(packed) {
    for (const [name, values] of Object.entries(packed)) this[name] = arrayOf(values);
    this.count = this.volumes.length;
    this.sources = this.shapes.length / this.count;
  }

  /** Heat [W] of metabolism, given fluxes and sources in each cell at an amplitude. */
  heating(amplitude, into) {
    into.set(this.metabolic);
    const [index, share] = between(this.amplitudes, amplitude);
    for (let s = 0; s < this.sources; s++) {
      const below = this.levels[index * this.sources + s];
      const level = below + share * (this.levels[(index + 1) * this.sources + s] - below);
      for (let i = 0; i < this.count; i++) into[i] += level * this.shapes[s * this.count + i];
    }
  }

  /**
   * One linearly implicit Euler step, into `out`.
   *
   * Conduction and the slope of the sink are implicit, so that any step is stable; the
   * matrix is tridiagonal.
   */
  step(temperature, heat, h, out) {
    const n = this.count;
    const { conductances: g, inverse_capacity: inverse, outside } = this;
    const upper = (this.upper ??= new Float64Array(n));
    let previous = 0; // eliminated right-hand side of the cell before
    for (let i = 0; i < n; i++) {
      const [index, share] = between(this.warmth, temperature[i]);
      const [low, high] = [this.sink[index * n + i], this.sink[(index + 1) * n + i]];
      const slope = (high - low) / (this.warmth[index + 1] - this.warmth[index]);
      const taken = low + share * (high - low);
      const scale = h * inverse[i];
      let source = heat[i] - taken + slope * temperature[i];
      if (i === 0) source += g[0] * outside[0];
      if (i === n - 1) source += g[n] * outside[1];
      const diagonal = 1 + scale * (g[i] + g[i + 1] + slope);
      const lower = i > 0 ? -scale * g[i] : 0;
      const pivot = diagonal - (i > 0 ? lower * upper[i - 1] : 0);
      upper[i] = i < n - 1 ? (-scale * g[i + 1]) / pivot : 0;
      previous = (temperature[i] + scale * source - lower * previous) / pivot;
      out[i] = previous;
    }
    for (let i = n - 2; i >= 0; i--) out[i] -= upper[i] * out[i + 1];
  }

  /**
   * A run under a protocol {edges, starts, ends}, amplitudes linear in each interval.
   *
   * Two half steps against one whole give second order (Richardson). Steps begin short
   * after every switch, where temperature has its steepest change.
   *
   * @returns {times, fields, doses}: temperature and CEM43 [min] of each cell.
   */
  run({ edges, starts, ends }, most = 6) {
    const n = this.count;
    let temperature = Float64Array.from(this.start);
    let dose = new Float64Array(n);
    const result = { times: [edges[0]], fields: [temperature], doses: [dose] };
    const [heat, whole, half, fine] = [0, 1, 2, 3].map(() => new Float64Array(n));
    const longest = Math.max((edges.at(-1) - edges[0]) / 300, 1e-9, most / 1e3);
    for (let k = 0; k < starts.length; k++) {
      const duration = edges[k + 1] - edges[k];
      const at = (t) => starts[k] + ((ends[k] - starts[k]) * (t - edges[k])) / duration;
      let t = edges[k];
      let h = Math.min(longest / 16, duration / 8);
      while (t < edges[k + 1] - 1e-9 * duration) {
        h = Math.min(h, edges[k + 1] - t);
        this.heating(at(t + h), heat);
        this.step(temperature, heat, h, whole);
        this.heating(at(t + h / 2), heat);
        this.step(temperature, heat, h / 2, half);
        this.heating(at(t + h), heat);
        this.step(half, heat, h / 2, fine);
        const next = fine.map((value, i) => 2 * value - whole[i]);
        dose = dose.map((value, i) => value + (doseRate(temperature[i]) + 4 * doseRate((temperature[i] + next[i]) / 2) + doseRate(next[i])) * (h / 360));
        temperature = next;
        t += h;
        result.times.push(t);
        result.fields.push(temperature);
        result.doses.push(dose);
        h = Math.min(1.4 * h, longest);
      }
    }
    return result;
  }

  /** What a share of the target's volume exceeds: linear between middles of volumes. */
  exceeded(values, target, share) {
    const cells = [];
    target.forEach((part, i) => part > 0 && cells.push([values[i], part * this.volumes[i]]));
    if (!cells.length) return NaN;
    cells.sort((a, b) => b[0] - a[0]);
    const total = cells.reduce((sum, [, volume]) => sum + volume, 0);
    let passed = 0;
    let before = null;
    for (const [value, volume] of cells) {
      const middle = (passed + volume / 2) / total;
      if (middle >= share) {
        if (!before) return value;
        return before[0] + ((share - before[1]) / (middle - before[1])) * (value - before[0]);
      }
      before = [value, middle];
      passed += volume;
    }
    return before[0];
  }
}

/** Index of an interval of regular places and the share of it, beyond them continued. */
function between(places, value) {
  const step = places[1] - places[0];
  const place = (value - places[0]) / step;
  const index = Math.min(Math.max(Math.floor(place), 0), places.length - 2);
  return [index, place - index];
}

/** CEM43 per minute. */
function doseRate(celsius) {
  if (celsius < CUTOFF) return 0;
  return 2 ** ((celsius - BREAK) * (celsius >= BREAK ? 1 : 2));
}
