// What surrounds a swimmer: flows that carry it, tensors of drag and mobility.

import { arrayOf } from "./numbers.js";

const numberOf = (value) => arrayOf(value)[0];

/** Velocity of the fluid, added to `out`: (t, x, out). */
export const FLOWS = {
  ZeroFlow: () => () => {},
  UniformFlow: (tree) => {
    const velocity = arrayOf(tree.velocity);
    return (t, x, out) => velocity.forEach((u, d) => (out[d] += u));
  },
  ShearFlow: (tree) => {
    const [rate, origin] = [tree.rate, tree.origin].map(numberOf);
    return (t, x, out) => (out[0] += rate * (x[1] - origin));
  },
  PoiseuilleFlow: (tree) => {
    const [peak, middle, half] = [tree.peak, tree.middle, tree.half_width].map(numberOf);
    return (t, x, out) => (out[0] += peak * Math.max(1 - ((x[1] - middle) / half) ** 2, 0));
  },
  VortexFlow: (tree) => {
    const [rate, width] = [tree.rate, tree.width].map(numberOf);
    const center = arrayOf(tree.center);
    return (t, x, out) => {
      const [a, b] = [x[0] - center[0], x[1] - center[1]];
      const speed = rate * Math.exp((-0.5 * (a * a + b * b)) / width ** 2);
      out[0] -= speed * b;
      out[1] += speed * a;
    };
  },
  SampledFlow: (tree) => {
    const times = arrayOf(tree.times);
    const velocities = arrayOf(tree.velocities);
    const dim = velocities.length / times.length;
    return (t, x, out) => {
      const [index, share] = placeAmong(times, t);
      for (let d = 0; d < dim; d++) {
        const before = velocities[index * dim + d];
        const after = velocities[Math.min(index + 1, times.length - 1) * dim + d];
        out[d] += before + share * (after - before);
      }
    };
  },
  SumFlow: (tree) => {
    const terms = tree.terms.map(flowOf);
    return (t, x, out) => terms.forEach((flow) => flow(t, x, out));
  },
};

export const flowOf = (tree) => FLOWS[tree.kind](tree);

/** Index of the last time before t, and how far t is to the next; ends hold beyond. */
export function placeAmong(times, t) {
  let [low, high] = [0, times.length - 1];
  if (t <= times[0]) return [0, 0];
  if (t >= times[high]) return [high, 0];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle;
    else high = middle;
  }
  return [low, (t - times[low]) / (times[low + 1] - times[low])];
}

const DIRECTORS = {
  ConstantDirector: (tree) => {
    const angle = numberOf(tree.angle);
    return () => angle;
  },
  WavyDirector: (tree) => {
    const [angle, amplitude] = [tree.angle, tree.amplitude].map(numberOf);
    const wave = arrayOf(tree.wavevector);
    return (x) => angle + amplitude * Math.sin(wave[0] * x[0] + wave[1] * x[1]);
  },
};

/** A tensor at x applied to a vector: (x, vector, out), out overwritten. */
export const TENSORS = {
  IsotropicTensor: (tree) => {
    const value = numberOf(tree.value);
    return (x, vector, out) => {
      for (let d = 0; d < vector.length; d++) out[d] = value * vector[d];
    };
  },
  UniaxialTensor: (tree) => {
    const [along, across] = [tree.along, tree.across].map(numberOf);
    const director = DIRECTORS[tree.director.kind](tree.director);
    return (x, vector, out) => {
      const angle = director(x);
      const [a, b] = [Math.cos(angle), Math.sin(angle)];
      const part = (along - across) * (a * vector[0] + b * vector[1]);
      out[0] = across * vector[0] + part * a;
      out[1] = across * vector[1] + part * b;
    };
  },
  CholeskyTensor: (tree) => {
    const diagonal = arrayOf(tree.log_diagonal).map(Math.exp);
    const below = arrayOf(tree.below);
    const n = diagonal.length;
    const lower = new Float64Array(n * n);
    for (let i = 0, k = 0; i < n; i++) {
      lower[i * n + i] = diagonal[i];
      for (let j = 0; j < i; j++) lower[i * n + j] = below[k++];
    }
    const half = new Float64Array(n);
    return (x, vector, out) => {
      for (let j = 0; j < n; j++) {
        half[j] = 0;
        for (let i = j; i < n; i++) half[j] += lower[i * n + j] * vector[i];
      }
      for (let i = 0; i < n; i++) {
        out[i] = 0;
        for (let j = 0; j <= i; j++) out[i] += lower[i * n + j] * half[j];
      }
    };
  },
  BrinkmanTensor: (tree) => {
    const [clear, radius, width] = [tree.clear, tree.radius, tree.width].map(numberOf);
    const screening = arrayOf(tree.screening);
    const centers = arrayOf(tree.centers);
    return (x, vector, out) => {
      const dim = vector.length;
      let kappa = 0;
      screening.forEach((strength, j) => {
        let square = 0;
        for (let d = 0; d < dim; d++) square += ((x[d] - centers[j * dim + d]) / width) ** 2;
        kappa += strength * Math.exp(-0.5 * square);
      });
      const thick = radius * kappa;
      const value = clear * (1 + thick + (thick * thick) / 9);
      for (let d = 0; d < dim; d++) out[d] = value * vector[d];
    };
  },
};

export const DIRECTOR_KINDS = Object.keys(DIRECTORS);

export const tensorOf = (tree) => TENSORS[tree.kind](tree);
