// The run and what is asked of it: paths, bands, draws, and where to record next.

import { compile, parameterColumns, posteriorOf } from "./model.js";
import { arrayOf, logDeterminantOfOnePlus, normalGenerator } from "./numbers.js";
import { Plan } from "./plan.js";
import { equalTimes, noisyPath, positionSd, rollout, sensitivities } from "./rollout.js";

export const NORMAL_95 = 1.959963984540054;
const INTERVALS = 300; // of a path that is drawn
const BAND_INTERVALS = 150; // of its band
const MANY = 60; // parameters from which on every second time has to do
const TOLERANCE = 1e-7; // of a step, over the extent of the data

/** A run that can be asked; `conditions` are those of `session.js`. */
export class Experiment {
  constructor(run) {
    this.run = run;
    this.posterior = posteriorOf(run.posterior);
    this.tracks = run.tracks.map((track) => ({
      ...track,
      times: arrayOf(track.times),
      x: arrayOf(track.x),
      y: arrayOf(track.y),
    }));
    this.plan = run.plan ? new Plan(run.plan) : null;
    this.units = unitsOf(run.units, run.order);
    this.compiled = new Map();
    this.conditions = { model: 0 };
    this.scale = Float64Array.from({ length: 4 }, (_, i) => this.typical(i));
  }

  /** Typical size of a state: the extent, or the extent over the longest track. */
  typical(state) {
    const { extent, clock } = this.run;
    return state < 2 ? extent : extent / (clock[1] - clock[0]);
  }

  /** The propulsion takes commands, constant ones or those of a track. */
  get isCommanded() {
    return this.run.commands !== null;
  }

  controls() {
    const c = this.conditions;
    const track = this.tracks[c.track];
    if (!this.isCommanded) return { thrust: c.thrust, turn: c.turn };
    if (c.replay && track?.commands) return { commands: track.commands };
    return { frequency: c.frequency, heading: c.heading };
  }

  /** Compiled once for the same model and controls. */
  compiledModel(name, known) {
    const controls = this.controls();
    const key = JSON.stringify([name, { ...controls, commands: Boolean(controls.commands) }, this.conditions.track]);
    const kept = this.compiled.get(name);
    if (kept?.key === key) return kept.model;
    const theta = known.parameters ? this.posterior.mean : undefined;
    const model = compile(known, this.run.commands, controls, theta);
    this.compiled.set(name, { key, model });
    return model;
  }

  learned() {
    const index = this.conditions.model ?? 0;
    return this.compiledModel(`model ${index}`, this.run.models[index]);
  }

  /** The model to which the posterior belongs. */
  first() {
    return this.compiledModel("model 0", this.run.models[0]);
  }

  physics() {
    return this.compiledModel("physics", this.run.physics);
  }

  truth() {
    return this.run.truth ? this.compiledModel("truth", this.run.truth) : null;
  }

  /** The posterior belongs to the first model. */
  get hasPosterior() {
    return this.posterior !== null && (this.conditions.model ?? 0) === 0;
  }

  columns() {
    const model = this.first();
    if (this.keptColumns?.model !== model) this.keptColumns = parameterColumns(model);
    return this.keptColumns;
  }

  samples() {
    return this.tracks.flatMap(({ x, y }) => Array.from(x, (value, i) => [value, y[i]]));
  }

  start() {
    const { x, y, vx, vy } = this.conditions;
    return this.run.order === 2 ? [x, y, vx, vy] : [x, y];
  }

  times(count = INTERVALS) {
    const { from, duration } = this.conditions;
    return equalTimes(from, duration, count);
  }

  path(model, start = this.start(), times = this.times()) {
    return rollout(model, start, times, TOLERANCE * this.run.extent);
  }

  /**
   * Mean path and standard deviations of its positions, to first order in parameters.
   *
   * Recorded commands jump, and the trapezoidal rule has to see every jump.
   */
  band(start = this.start(), times = this.bandTimes()) {
    const model = this.learned();
    const { states, finite } = this.path(model, start, times);
    const noise = this.conditions.kicks ?? 0;
    const columns = this.hasPosterior ? this.columns() : withoutParameters(model);
    const posterior = this.hasPosterior ? this.posterior : null;
    const every = columns.count > MANY ? 2 : 1;
    const band = { times: [], states: [], sd: [], finite };
    sensitivities(columns, states, times, this.scale, noise, (k, rows, kicks) => {
      if (k % every && k < states.length - 1) return;
      band.times.push(times[k]);
      band.states.push(states[k]);
      band.sd.push(positionSd(posterior, rows, kicks));
    });
    return band;
  }

  bandTimes() {
    const large = this.hasPosterior && this.posterior.count > 500;
    const times = this.times(large ? 100 : BAND_INTERVALS);
    const jumps = this.learned().jumps.filter((t) => t > times[0] && t < times.at(-1));
    if (!jumps.length || jumps.length > 4000) return times;
    return Float64Array.from(new Set([...times, ...jumps])).sort();
  }

  /** Paths of models drawn from the posterior, kicked by the noise. */
  draws(count = 12, seed = 1) {
    const normal = normalGenerator(seed);
    const noise = this.conditions.kicks ?? 0;
    const known = this.run.models[this.conditions.model ?? 0];
    return Array.from({ length: count }, () => {
      const theta = this.hasPosterior ? this.posterior.draw(normal) : undefined;
      const model = compile(known, this.run.commands, this.controls(), theta);
      if (noise === 0) return this.path(model).states;
      return noisyPath(model, this.start(), this.times(600), noise, normal);
    });
  }

  /** Force along a line: {place, mean: [x, y], sd: [x, y], truth} at each point. */
  cut([x0, y0, x1, y1], forceAt, forceSd, count = 120) {
    const t = this.conditions.mapTime;
    const environment = this.learned().environment;
    const truth = this.truth()?.environment;
    const rows = this.hasPosterior && environment.basis
      ? [0, 1].map(() => new Float64Array(this.posterior.count))
      : null;
    const length = Math.hypot(x1 - x0, y1 - y0);
    return Array.from({ length: count + 1 }, (_, i) => {
      const share = i / count;
      const x = Float64Array.of(x0 + share * (x1 - x0), y0 + share * (y1 - y0));
      return {
        place: share * length,
        mean: forceAt(environment, t, x),
        sd: rows ? forceSd(environment, this.posterior, t, x, rows) : [0, 0],
        truth: truth ? forceAt(truth, t, x) : null,
      };
    });
  }

  /**
   * Where to release the swimmer next, and what it would tell, candidate by candidate.
   *
   * The information that positions along the path have about the parameters is
   * log det(I + S Σ S^T / σ²) / 2 [nats], with the sensitivities S of a linear model. It
   * is Lindley's expected gain in entropy.
   *
   * @yields after each candidate, {done, best} with best = {x, y, gain}.
   */
  *recordNext(side = 7, moments = 16) {
    const [x0, x1, y0, y1] = this.run.box;
    const noise = Math.max(this.run.noise, 1e-4 * this.run.extent);
    const times = this.times(64);
    const candidates = [];
    for (let i = 0; i < side; i++) {
      for (let j = 0; j < side; j++) {
        candidates.push([x0 + ((i + 0.5) / side) * (x1 - x0), y0 + ((j + 0.5) / side) * (y1 - y0)]);
      }
    }
    let best = null;
    for (let k = 0; k < candidates.length; k++) {
      const start = this.start();
      [start[0], start[1]] = candidates[k];
      const { states } = this.path(this.learned(), start, times);
      const inside = states.filter(([x, y]) => x >= x0 && x <= x1 && y >= y0 && y <= y1);
      const kept = states.slice(0, inside.length); // what leaves the map is not seen
      if (kept.length > moments) {
        const gain = this.information(kept, times, noise, moments);
        if (!best || gain > best.gain) best = { x: start[0], y: start[1], gain };
      }
      yield { done: (k + 1) / candidates.length, best };
    }
    return best;
  }

  information(states, times, noise, moments) {
    const last = states.length - 1;
    const chosen = new Set(Array.from({ length: moments }, (_, i) => Math.round(((i + 1) / moments) * last)));
    const rows = [];
    sensitivities(this.columns(), states, times, this.scale, 0, (k, now) => {
      if (chosen.has(k)) rows.push(this.projected(now[0]), this.projected(now[1]));
    });
    const n = rows.length;
    const matrix = new Float64Array(n * n);
    for (let i = 0; i < n; i++) {
      for (let j = 0; j <= i; j++) {
        let dot = 0;
        for (let k = 0; k < rows[i].length; k++) dot += rows[i][k] * rows[j][k];
        matrix[i * n + j] = matrix[j * n + i] = dot / noise ** 2;
      }
    }
    return 0.5 * logDeterminantOfOnePlus(matrix, n);
  }

  /** factor^T row: what a change of the row's state is, direction by direction. */
  projected(row) {
    const { factor, rank, count } = this.posterior;
    const result = new Float64Array(rank);
    for (let p = 0; p < count; p++) {
      if (row[p] === 0) continue;
      for (let k = 0; k < rank; k++) result[k] += row[p] * factor[p * rank + k];
    }
    return result;
  }
}

const withoutParameters = (model) => ({ model, count: 0, at() {} });

/** Units of length, time and force; an empty text where there is none. */
function unitsOf(units, order) {
  const plain = (unit) => (["1", "?", undefined].includes(unit) ? "" : unit.replace("um", "µm"));
  const [length, time] = [plain(units.x), plain(units.t)];
  const rate = length && time ? `${length}/${time}${order === 2 ? "²" : ""}` : "";
  const force = (order === 1 && plain(units.force)) || rate;
  return { length, time, force };
}
