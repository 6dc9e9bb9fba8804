// Sums of Gaussian kernels: potentials, forces, stream functions, and splines in time.
//
// Kernels lie on a square grid, so that exp(-|x - c|² / 2b²) is a product of two factors
// of which there are few: one exponential for each column and row of the grid, and not
// one for each kernel. This is exact, and makes a rollout ten times faster.

import { arrayOf, rowsOf } from "./numbers.js";

/** Kernels at places: `at(x)` fills values; offsets are read by `index`. */
function placesOf(tree) {
  const centers = arrayOf(tree.centers);
  const count = rowsOf(tree.centers);
  const dim = centers.length / count;
  const width = arrayOf(tree.width)[0];
  const axes = [];
  for (let d = 0; d < dim; d++) {
    const column = Float64Array.from({ length: count }, (_, j) => centers[j * dim + d]);
    const places = Float64Array.from(new Set(column));
    const rank = new Map(Array.from(places, (place, i) => [place, i]));
    const index = Int32Array.from(column, (place) => rank.get(place));
    axes.push({
      places,
      index,
      value: new Float64Array(places.length),
      offset: new Float64Array(places.length),
    });
  }
  const phi = new Float64Array(count);
  const inverse = 1 / width;
  function at(x) {
    for (let d = 0; d < dim; d++) {
      const { places, value, offset } = axes[d];
      for (let i = 0; i < places.length; i++) {
        const z = (x[d] - places[i]) * inverse;
        offset[i] = z * inverse;
        value[i] = Math.exp(-0.5 * z * z);
      }
    }
    const first = axes[0];
    for (let j = 0; j < count; j++) phi[j] = first.value[first.index[j]];
    for (let d = 1; d < dim; d++) {
      const { index, value } = axes[d];
      for (let j = 0; j < count; j++) phi[j] *= value[index[j]];
    }
  }
  return { count, dim, axes, phi, at };
}

/** Offsets over width² of axis d, summed over kernels with these strengths. */
function moment(places, weights, d) {
  const { index, offset } = places.axes[d];
  const { phi, count } = places;
  let total = 0;
  for (let j = 0; j < count; j++) total += weights[j] * phi[j] * offset[index[j]];
  return total;
}

function weightedSum(phi, weights) {
  let total = 0;
  for (let j = 0; j < phi.length; j++) total += weights[j] * phi[j];
  return total;
}

/** Force of a potential with such weights, added to `out`. */
function addGradient(places, weights, out) {
  if (places.dim === 2) {
    const [first, second] = places.axes;
    const { phi, count } = places;
    let fx = 0;
    let fy = 0;
    for (let j = 0; j < count; j++) {
      const strength = weights[j] * phi[j];
      fx += strength * first.offset[first.index[j]];
      fy += strength * second.offset[second.index[j]];
    }
    out[0] += fx;
    out[1] += fy;
    return;
  }
  for (let d = 0; d < places.dim; d++) out[d] += moment(places, weights, d);
}

/** Derivatives of that force by the weights, into rows[d][from...]. */
function gradientBasis(places, rows, from, stride = 1, factor = 1) {
  for (let d = 0; d < places.dim; d++) {
    const { index, offset } = places.axes[d];
    const row = rows[d];
    for (let j = 0; j < places.count; j++) {
      row[from + j * stride] = factor * places.phi[j] * offset[index[j]];
    }
  }
}

export function kernelPotential(tree) {
  const places = placesOf(tree);
  const weights = arrayOf(tree.weights);
  return {
    add(t, x, v, out) {
      places.at(x);
      addGradient(places, weights, out);
    },
    potential(t, x) {
      places.at(x);
      return weightedSum(places.phi, weights);
    },
    parameters: places.count,
    basis(t, x, rows, from) {
      places.at(x);
      gradientBasis(places, rows, from);
    },
  };
}

export function kernelForce(tree) {
  const places = placesOf(tree);
  const { dim, count, phi } = places;
  const weights = arrayOf(tree.weights); // row by row, one kernel a row
  return {
    add(t, x, v, out) {
      places.at(x);
      for (let d = 0; d < dim; d++) {
        let total = 0;
        for (let j = 0; j < count; j++) total += weights[j * dim + d] * phi[j];
        out[d] += total;
      }
    },
    parameters: count * dim,
    basis(t, x, rows, from) {
      places.at(x);
      for (let d = 0; d < dim; d++) {
        for (let j = 0; j < count; j++) rows[d][from + j * dim + d] = phi[j];
      }
    },
  };
}

export function kernelStream(tree) {
  const places = placesOf(tree);
  const weights = arrayOf(tree.weights);
  return {
    add(t, x, v, out) {
      places.at(x);
      out[0] -= moment(places, weights, 1);
      out[1] += moment(places, weights, 0);
    },
    parameters: places.count,
    basis(t, x, rows, from) {
      places.at(x);
      const [first, second] = places.axes;
      for (let j = 0; j < places.count; j++) {
        rows[0][from + j] = -places.phi[j] * second.offset[second.index[j]];
        rows[1][from + j] = places.phi[j] * first.offset[first.index[j]];
      }
    },
  };
}

/** Uniform cubic B-spline about zero, with knots at the integers -2 to 2. */
function cubicSpline(offset) {
  const far = Math.abs(offset);
  if (far < 1) return 2 / 3 - far * far + (far * far * far) / 2;
  return far < 2 ? (2 - far) ** 3 / 6 : 0;
}

export function timedKernelPotential(tree) {
  const places = placesOf(tree);
  const weights = arrayOf(tree.weights); // one kernel a row, one spline a column
  const splines = weights.length / places.count;
  const first = arrayOf(tree.first)[0];
  const last = arrayOf(tree.last)[0];
  const share = new Float64Array(splines);
  const now = new Float64Array(places.count);
  function at(t) {
    const place = Math.min(Math.max((t - first) / (last - first), 0), 1) * (splines - 3);
    for (let k = 0; k < splines; k++) share[k] = cubicSpline(place - (k - 1));
    for (let j = 0; j < places.count; j++) {
      let total = 0;
      for (let k = 0; k < splines; k++) total += weights[j * splines + k] * share[k];
      now[j] = total;
    }
  }
  return {
    timed: true,
    add(t, x, v, out) {
      at(t);
      places.at(x);
      addGradient(places, now, out);
    },
    potential(t, x) {
      at(t);
      places.at(x);
      return weightedSum(places.phi, now);
    },
    parameters: weights.length,
    basis(t, x, rows, from) {
      at(t);
      places.at(x);
      for (let k = 0; k < splines; k++) {
        gradientBasis(places, rows, from + k, splines, share[k]);
      }
    },
  };
}
