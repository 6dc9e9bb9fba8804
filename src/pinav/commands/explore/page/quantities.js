// What the map can show: each quantity fills a grid row by row, so that the page stays
// responsive while a slow one is computed.

import { variancesOf } from "./rollout.js";

export const POINTS = 101;

/** Places of the grid along one side. */
function places(low, high, count) {
  return Float64Array.from({ length: count }, (_, i) => low + ((high - low) * i) / (count - 1));
}

/**
 * A grid over a box, filled by `at(x) -> number`, one row at each step.
 *
 * @yields nothing, after each row; the grid is returned at last.
 */
export function* grid(box, at, count = POINTS) {
  const [xs, ys] = [places(box[0], box[1], count), places(box[2], box[3], count)];
  const values = new Float64Array(count * count);
  const x = new Float64Array(2);
  for (let j = 0; j < count; j++) {
    for (let i = 0; i < count; i++) {
      x[0] = xs[i];
      x[1] = ys[j];
      values[j * count + i] = at(x);
    }
    yield;
  }
  return { values, count, box };
}

/** Force of an environment at rest, as [x, y]. */
export function forceAt(environment, t, x) {
  const force = [0, 0];
  environment.force(t, x, force);
  return force;
}

/** Rotation ∂Fy/∂x - ∂Fx/∂y by central differences over a step. */
function rotationAt(environment, t, x, step) {
  const along = (d, axis) => {
    const place = Float64Array.from(x);
    place[axis] += step;
    const above = forceAt(environment, t, place)[d];
    place[axis] -= 2 * step;
    return (above - forceAt(environment, t, place)[d]) / (2 * step);
  };
  return along(1, 0) - along(0, 1);
}

/** Standard deviations of the force's components at rest. */
export function forceSd(environment, posterior, t, x, rows) {
  environment.basis(t, x, rows);
  return variancesOf(posterior, rows[0], rows[1]).map(Math.sqrt);
}

/** Distance to the nearest of the samples, over a grid of buckets. */
export function distanceTo(samples, box) {
  const side = 40;
  const size = Math.max(box[1] - box[0], box[3] - box[2]) / side;
  const buckets = new Map();
  const key = (i, j) => i * 4096 + j;
  const cell = (x, y) => [Math.floor((x - box[0]) / size), Math.floor((y - box[2]) / size)];
  for (const [x, y] of samples) {
    const [i, j] = cell(x, y);
    if (!buckets.has(key(i, j))) buckets.set(key(i, j), []);
    buckets.get(key(i, j)).push([x, y]);
  }
  return (x) => {
    const [ci, cj] = cell(x[0], x[1]);
    let best = Infinity;
    // A ring r holds no sample nearer than (r - 1) cells.
    for (let r = 0; r <= 2 * side && (r - 1) * size < best; r++) {
      for (let i = ci - r; i <= ci + r; i++) {
        const whole = Math.abs(i - ci) === r;
        for (let j = cj - r; j <= cj + r; j += whole ? 1 : Math.max(2 * r, 1)) {
          for (const [a, b] of buckets.get(key(i, j)) ?? []) {
            best = Math.min(best, Math.hypot(a - x[0], b - x[1]));
          }
        }
      }
    }
    return best;
  };
}

/**
 * The quantities that this run has, by name: {label, unit, signed, at(time)}.
 *
 * @param experiment of the run.
 */
export function quantitiesOf(experiment) {
  const { run } = experiment;
  const environment = () => experiment.learned().environment;
  const step = 1e-3 * run.extent;
  const { length, force } = experiment.units;
  const list = [["none", { label: "nothing", unit: "", at: null }]];
  if (environment()) {
    list.push([
      "force",
      { label: "force, size", unit: force, at: (t) => (x) => size(forceAt(environment(), t, x)) },
    ]);
    if (environment().potential) {
      const at = (t) => (x) => environment().potential(t, x);
      list.push(["potential", { label: "potential", unit: product(force, length), signed: true, at }]);
    }
    const curl = (t) => (x) => rotationAt(environment(), t, x, step);
    list.push(["rotation", { label: "rotation", unit: ratio(force, length), signed: true, at: curl }]);
  }
  if (environment()?.basis && experiment.posterior) {
    const rows = [0, 1].map(() => new Float64Array(experiment.posterior.count));
    const at = (t) => (x) => size(forceSd(experiment.first().environment, experiment.posterior, t, x, rows));
    list.push(["sd", { label: "standard deviation of the force", unit: force, at, slow: true }]);
  }
  if (experiment.plan) {
    const at = () => (x) => experiment.plan.shownTime(x);
    list.push(["go", { label: "time to the goal, from rest", unit: experiment.units.time, at }]);
  }
  const nearest = distanceTo(experiment.samples(), run.box);
  list.push(["distance", { label: "distance to the data", unit: length, at: () => nearest }]);
  const truth = experiment.truth()?.environment;
  if (truth) {
    list.push([
      "truth",
      { label: "true force, size", unit: force, at: (t) => (x) => size(forceAt(truth, t, x)) },
    ]);
  }
  if (truth && environment()) {
    const at = (t) => (x) => {
      const [a, b] = [forceAt(environment(), t, x), forceAt(truth, t, x)];
      return Math.hypot(a[0] - b[0], a[1] - b[1]);
    };
    list.push(["error", { label: "error of the force, size", unit: force, at }]);
  }
  return new Map(list);
}

const size = (vector) => Math.hypot(...vector);
const bare = (unit) => ["1", "", "?"].includes(unit);

function product(a, b) {
  return bare(a) || bare(b) ? (bare(a) ? b : a) : `${a} ${b}`;
}

function ratio(a, b) {
  return bare(b) ? a : bare(a) ? `1/${b}` : `${a}/${b}`;
}
