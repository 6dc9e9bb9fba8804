// Paths and their bands: Dormand and Prince's method, and the linearised posterior.

const A = [
  [],
  [1 / 5],
  [3 / 40, 9 / 40],
  [44 / 45, -56 / 15, 32 / 9],
  [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
  [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
  [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
];
const C = [0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1];
const ERROR = [71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40];
const DENSE = [
  -12715105075 / 11282082432,
  0,
  87487479700 / 32700410799,
  -10690763975 / 1880347072,
  701980252875 / 199316789632,
  -1453857185 / 822651844,
  69997945 / 29380423,
];

/**
 * The path of y' = rate(t, y) at `times`, by adaptive steps with dense output.
 *
 * @param tolerance absolute error of a step, beside 1e-8 of the state.
 * @returns {states: Float64Array[], finite} fewer states where it has diverged.
 * @see Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I (DOPRI5).
 */
export function rollout(model, start, times, tolerance, limit = 20000) {
  const n = model.states;
  const end = times.at(-1);
  const stops = [...model.jumps.filter((t) => t > times[0] && t < end), end];
  const k = Array.from({ length: 7 }, () => new Float64Array(n));
  const stage = new Float64Array(n);
  let y = Float64Array.from(start);
  let t = times[0];
  let next = Float64Array.from(start);
  const states = [Float64Array.from(start)];
  let h = (end - t) / 100;
  let steps = 0;
  let index = 1;
  for (const stop of stops) {
    // What jumps at the stop already has its later value there.
    const before = stop - 1e-9 * (stop - t);
    const rate = (time, state, out) => model.rate(Math.min(time, before), state, out);
    rate(t, y, k[0]);
    while (t < stop) {
      if (++steps > limit || !y.every(Number.isFinite)) return { states, finite: false };
      const last = t + h >= stop - 1e-12 * Math.abs(stop);
      const step = last ? stop - t : h;
      for (let i = 1; i < 7; i++) {
        for (let s = 0; s < n; s++) {
          let sum = 0;
          for (let j = 0; j < i; j++) sum += A[i][j] * k[j][s];
          stage[s] = y[s] + step * sum;
        }
        if (i === 6) next.set(stage);
        rate(t + C[i] * step, stage, k[i]);
      }
      let error = 0;
      for (let s = 0; s < n; s++) {
        let sum = 0;
        for (let i = 0; i < 7; i++) sum += ERROR[i] * k[i][s];
        const size = tolerance + 1e-8 * Math.max(Math.abs(y[s]), Math.abs(next[s]));
        error = Math.max(error, Math.abs(step * sum) / size);
      }
      if (error > 1 || Number.isNaN(error)) {
        h = step * (Number.isNaN(error) ? 0.1 : Math.max(0.2, 0.9 * error ** -0.2));
        continue;
      }
      while (index < times.length && times[index] <= t + step + 1e-12 * Math.abs(end)) {
        states.push(interpolate(y, next, k, step, (times[index] - t) / step));
        index++;
      }
      t = last ? stop : t + step;
      [y, next] = [next, y];
      k[0].set(k[6]);
      const grown = step * Math.min(5, 0.9 * Math.max(error, 1e-10) ** -0.2);
      h = last ? Math.max(h, grown) : grown;
    }
  }
  return { states, finite: states.length === times.length };
}

/** Dense output of a step, of fourth order. */
function interpolate(y, next, k, step, theta) {
  const out = new Float64Array(y.length);
  const rest = 1 - theta;
  for (let s = 0; s < y.length; s++) {
    const change = next[s] - y[s];
    const bend = step * k[0][s] - change;
    let fifth = 0;
    for (let i = 0; i < 7; i++) fifth += DENSE[i] * k[i][s];
    const tail = change - step * k[6][s] - bend;
    out[s] = y[s] + theta * (change + rest * (bend + theta * (tail + rest * step * fifth)));
  }
  return out;
}

/** Equal times from `from`, `count` intervals over `duration`. */
export function equalTimes(from, duration, count) {
  return Float64Array.from({ length: count + 1 }, (_, i) => from + (duration * i) / count);
}

/** Derivatives of the rate by the state, row by row, by central differences. */
function stateJacobian(model, t, y, scale, out, above, below) {
  const n = model.states;
  const moved = Float64Array.from(y);
  for (let j = 0; j < n; j++) {
    const step = 1e-5 * scale[j];
    moved[j] = y[j] + step;
    model.rate(t, moved, above);
    moved[j] = y[j] - step;
    model.rate(t, moved, below);
    moved[j] = y[j];
    for (let i = 0; i < n; i++) out[i * n + j] = (above[i] - below[i]) / (2 * step);
  }
}

/**
 * How the states at `times` change with the parameters, to first order.
 *
 * The linearised equation S' = A S + B is solved by the trapezoidal rule from time to
 * time, which is stable and needs A and B at these times alone. Beside S, the covariance
 * P of a white noise of the driven components is carried along, P' = A P + P A^T + Q.
 *
 * @param columns of `parameterColumns`.
 * @param noise standard deviation of the kicks over the root of time.
 * @param visit(k, rows, P) is called at each time; `rows`, one for each state, over the
 *   parameters, are overwritten afterwards.
 */
export function sensitivities(columns, states, times, scale, noise, visit) {
  const { model, count } = columns;
  const n = model.states;
  const width = count + n; // beside S the flow of the states, for P
  const buffer = () => Array.from({ length: n }, () => new Float64Array(width));
  const [above, below] = [new Float64Array(n), new Float64Array(n)];
  let [before, after] = [new Float64Array(n * n), new Float64Array(n * n)];
  let [b0, b1] = [buffer(), buffer()];
  let [old, right] = [buffer(), buffer()];
  let kicks = new Float64Array(n * n);
  const matrix = new Float64Array(n * n);
  stateJacobian(model, times[0], states[0], scale, before, above, below);
  columns.at(times[0], states[0], b0);
  visit(0, old, kicks);
  for (let k = 1; k < states.length; k++) {
    const half = (times[k] - times[k - 1]) / 2;
    // The commands of this interval hold until just before its end.
    const now = times[k] - 2e-9 * half;
    stateJacobian(model, now, states[k], scale, after, above, below);
    if (model.jumps.length) columns.at(times[k - 1], states[k - 1], b0);
    columns.at(now, states[k], b1);
    for (let i = 0; i < n; i++) {
      const row = right[i];
      const [source, now0, now1] = [old[i], b0[i], b1[i]];
      for (let p = 0; p < count; p++) row[p] = source[p] + half * (now0[p] + now1[p]);
      for (let j = 0; j < n; j++) {
        const factor = half * before[i * n + j];
        if (factor !== 0) addMultiple(row, old[j], factor, count);
        row[count + j] = (i === j ? 1 : 0) + factor;
        matrix[i * n + j] = (i === j ? 1 : 0) - half * after[i * n + j];
      }
    }
    solve(matrix, right, n, width);
    kicks = carried(kicks, right.map((row) => row.subarray(count)), model, 2 * half * noise ** 2);
    visit(k, right, kicks);
    [before, after] = [after, before];
    [b0, b1] = [b1, b0];
    [old, right] = [right, old];
  }
}

function addMultiple(row, source, factor, count) {
  for (let p = 0; p < count; p++) row[p] += factor * source[p];
}

/** Elimination without pivots: I - h A / 2 is close to the identity. */
function solve(matrix, right, n, width) {
  for (let k = 0; k < n; k++) {
    for (let i = k + 1; i < n; i++) {
      const factor = matrix[i * n + k] / matrix[k * n + k];
      if (factor === 0) continue;
      for (let j = k; j < n; j++) matrix[i * n + j] -= factor * matrix[k * n + j];
      addMultiple(right[i], right[k], -factor, width);
    }
  }
  for (let k = n - 1; k >= 0; k--) {
    for (let i = k + 1; i < n; i++) {
      const factor = matrix[k * n + i];
      if (factor !== 0) addMultiple(right[k], right[i], -factor, width);
    }
    const row = right[k];
    for (let p = 0; p < width; p++) row[p] /= matrix[k * n + k];
  }
}

/** Covariance of the kicks after an interval: F P F^T, half of the new ones carried. */
function carried(old, flow, model, variance) {
  const n = model.states;
  const total = Float64Array.from(old);
  for (let d = model.firstDriven; d < n; d++) total[d * n + d] += variance / 2;
  const result = new Float64Array(n * n);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) {
      let sum = 0;
      for (let a = 0; a < n; a++) {
        for (let b = 0; b < n; b++) sum += flow[i][a] * total[a * n + b] * flow[j][b];
      }
      result[i * n + j] = sum;
    }
  }
  for (let d = model.firstDriven; d < n; d++) result[d * n + d] += variance / 2;
  return result;
}

/** Standard deviations of the first two states: of parameters and kicks. */
export function positionSd(posterior, rows, kicks) {
  const n = rows.length;
  const variances = posterior ? variancesOf(posterior, rows[0], rows[1]) : [0, 0];
  return variances.map((variance, i) => Math.sqrt(variance + kicks[i * n + i]));
}

let sums = [new Float64Array(0), new Float64Array(0)];

/** |factor^T row|² of two rows in one pass over the factor, which is read row by row. */
export function variancesOf(posterior, first, second) {
  const { factor, rank, count } = posterior;
  if (sums[0].length !== rank) sums = [new Float64Array(rank), new Float64Array(rank)];
  const [a, b] = sums;
  a.fill(0);
  b.fill(0);
  for (let p = 0; p < count; p++) {
    const [u, v] = [first[p], second[p]];
    if (u === 0 && v === 0) continue;
    const start = p * rank;
    for (let k = 0; k < rank; k++) {
      const entry = factor[start + k];
      a[k] += u * entry;
      b[k] += v * entry;
    }
  }
  const square = (values) => values.reduce((total, value) => total + value * value, 0);
  return [square(a), square(b)];
}

/** A path with kicks after each of many small steps (Euler and Maruyama, Heun's drift). */
export function noisyPath(model, start, times, noise, normal) {
  const n = model.states;
  const [k0, k1, guess] = [0, 1, 2].map(() => new Float64Array(n));
  let y = Float64Array.from(start);
  const states = [y];
  for (let i = 1; i < times.length; i++) {
    const h = times[i] - times[i - 1];
    model.rate(times[i - 1], y, k0);
    for (let s = 0; s < n; s++) guess[s] = y[s] + h * k0[s];
    model.rate(times[i] - 1e-9 * h, guess, k1);
    const next = y.map((value, s) => value + (h / 2) * (k0[s] + k1[s]));
    for (let d = model.firstDriven; d < n; d++) next[d] += noise * Math.sqrt(h) * normal();
    y = next;
    states.push(y);
  }
  return states;
}
