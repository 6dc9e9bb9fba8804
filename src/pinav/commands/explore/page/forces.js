// Forces by the names of their classes: each adds what it gives to `out`.
//
// A compiled force is {add(t, x, v, out)}, with `potential(t, x)` where it has one,
// `basis(t, x, rows, from)` where its weights are parameters, `timed` where it depends
// on time.

import { kernelForce, kernelPotential, kernelStream, timedKernelPotential } from "./kernels.js";
import { flowOf, tensorOf } from "./media.js";
import { neuralForce, neuralPotential } from "./network.js";
import { arrayOf } from "./numbers.js";
import { rollingPropulsion } from "./propulsion.js";
import { TERMS } from "./structures.js";

const scalar = (value) => arrayOf(value)[0];

const MOTIONS = {
  LinearMotion: (tree) => {
    const velocity = arrayOf(tree.velocity);
    return (t, out) => velocity.forEach((u, d) => (out[d] = u * t));
  },
  CircularMotion: (tree) => {
    const [radius, frequency, phase] = [tree.radius, tree.frequency, tree.phase].map(scalar);
    return (t, out) => {
      out[0] = radius * Math.cos(frequency * t + phase);
      out[1] = radius * Math.sin(frequency * t + phase);
    };
  },
};

/** The sum of several compiled forces. */
function sumOf(terms) {
  const withPotential = terms.every((term) => term.potential);
  const withBasis = terms.every((term) => term.basis);
  return {
    timed: terms.some((term) => term.timed),
    add: (t, x, v, out) => {
      for (const term of terms) term.add(t, x, v, out);
    },
    potential: withPotential
      ? (t, x) => terms.reduce((total, term) => total + term.potential(t, x), 0)
      : undefined,
    parameters: withBasis ? terms.reduce((n, term) => n + term.parameters, 0) : undefined,
    basis: withBasis
      ? (t, x, rows, from) => {
          let next = from;
          for (const term of terms) {
            term.basis(t, x, rows, next);
            next += term.parameters;
          }
        }
      : undefined,
  };
}

function barrier(tree) {
  const [height, width] = [tree.height, tree.width].map(scalar);
  const center = arrayOf(tree.center);
  const potential = (t, x) => {
    let square = 0;
    for (let d = 0; d < x.length; d++) square += ((x[d] - center[d]) / width) ** 2;
    return height * Math.exp(-0.5 * square);
  };
  return {
    potential,
    add(t, x, v, out) {
      const strength = potential(t, x) / width ** 2;
      for (let d = 0; d < x.length; d++) out[d] += strength * (x[d] - center[d]);
    },
  };
}

function ridge(tree) {
  const [height, length, width] = [tree.height, tree.length, tree.width].map(scalar);
  const center = arrayOf(tree.center);
  const [cos, sin] = [Math.cos(scalar(tree.angle)), Math.sin(scalar(tree.angle))];
  const local = (x) => {
    const [a, b] = [x[0] - center[0], x[1] - center[1]];
    return [(cos * a + sin * b) / length, (cos * b - sin * a) / width];
  };
  const potential = (t, x) => {
    const [along, across] = local(x);
    return height * Math.exp(-0.5 * (along ** 2 + across ** 2));
  };
  return {
    potential,
    add(t, x, v, out) {
      const [along, across] = local(x);
      const strength = potential(t, x);
      out[0] += strength * ((cos * along) / length - (sin * across) / width);
      out[1] += strength * ((sin * along) / length + (cos * across) / width);
    },
  };
}

function swirl(tree) {
  const [strength, width] = [tree.strength, tree.width].map(scalar);
  const center = arrayOf(tree.center);
  return {
    add(t, x, v, out) {
      const [a, b] = [(x[0] - center[0]) / width, (x[1] - center[1]) / width];
      const stream = (strength * Math.exp(-0.5 * (a * a + b * b))) / width;
      out[0] -= stream * b;
      out[1] += stream * a;
    },
  };
}

function trap(tree) {
  const stiffness = scalar(tree.stiffness);
  const center = arrayOf(tree.center);
  return {
    potential: (t, x) =>
      center.reduce((total, c, d) => total + 0.5 * stiffness * (x[d] - c) ** 2, 0),
    add(t, x, v, out) {
      for (let d = 0; d < x.length; d++) out[d] -= stiffness * (x[d] - center[d]);
    },
  };
}

function magneticPropulsion(tree) {
  const moment = arrayOf(tree.moment);
  const axis = arrayOf(tree.axis);
  const gain = scalar(tree.gain);
  const [amplitude, frequency] = [tree.field.amplitude, tree.field.frequency].map(scalar);
  return {
    add(t, x, v, out) {
      const [a, b] = [Math.cos(frequency * t) * amplitude, Math.sin(frequency * t) * amplitude];
      const [p, q, r] = moment;
      const torque = Math.hypot(-r * b, r * a, p * b - q * a); // m × B, B in the plane
      for (let d = 0; d < axis.length; d++) out[d] += gain * torque * axis[d];
    },
  };
}

function moving(tree) {
  const force = forceOf(tree.force);
  const motion = MOTIONS[tree.motion.kind](tree.motion);
  const shift = new Float64Array(3);
  const place = [0, 0, 0];
  function shifted(t, x) {
    motion(t, shift);
    place.length = x.length;
    for (let d = 0; d < x.length; d++) place[d] = x[d] - shift[d];
    return place;
  }
  return {
    timed: true,
    potential: force.potential && ((t, x) => force.potential(t, shifted(t, x))),
    add: (t, x, v, out) => force.add(t, shifted(t, x), v, out),
  };
}

function relativeToFlow(tree) {
  const force = forceOf(tree.force);
  const flow = flowOf(tree.flow);
  const relative = [0, 0, 0];
  return {
    timed: true,
    add(t, x, v, out) {
      relative.length = x.length;
      relative.fill(0);
      flow(t, x, relative);
      for (let d = 0; d < x.length; d++) relative[d] = v[d] - relative[d];
      force.add(t, x, relative, out);
    },
  };
}

export const FORCES = {
  ZeroForce: () => ({ add() {}, potential: () => 0 }),
  SumForce: (tree) => sumOf(tree.terms.map(forceOf)),
  ConstantForce: (tree) => {
    const force = arrayOf(tree.force);
    return {
      add(t, x, v, out) {
        for (let d = 0; d < force.length; d++) out[d] += force[d];
      },
    };
  },
  MagneticPropulsion: magneticPropulsion,
  RollingPropulsion: rollingPropulsion,
  LinearDrag: (tree) => {
    const damping = scalar(tree.damping);
    return {
      add(t, x, v, out) {
        for (let d = 0; d < v.length; d++) out[d] -= damping * v[d];
      },
    };
  },
  TensorDrag: (tree) => {
    const tensor = tensorOf(tree.tensor);
    const drag = new Float64Array(3);
    return {
      add(t, x, v, out) {
        tensor(x, v, drag);
        for (let d = 0; d < v.length; d++) out[d] -= drag[d];
      },
    };
  },
  InFlow: relativeToFlow,
  Advection: (tree) => {
    const flow = flowOf(tree.flow);
    return { timed: tree.flow.kind === "SampledFlow", add: (t, x, v, out) => flow(t, x, out) };
  },
  Moving: moving,
  GaussianBarrier: barrier,
  GaussianRidge: ridge,
  GaussianSwirl: swirl,
  HarmonicTrap: trap,
  KernelForce: kernelForce,
  KernelPotential: kernelPotential,
  KernelStream: kernelStream,
  KernelMixture: (tree) => ({
    ...sumOf([kernelPotential(tree.gradient), kernelStream(tree.rotation)]),
    potential: kernelPotential(tree.gradient).potential,
  }),
  TimedKernelPotential: timedKernelPotential,
  ChangingPotential: (tree) =>
    sumOf([kernelPotential(tree.static), timedKernelPotential(tree.change)]),
  ...TERMS,
  StructuredForce: (tree) => sumOf([...tree.terms.map(forceOf), forceOf(tree.remainder)]),
  NeuralForce: neuralForce,
  NeuralPotential: neuralPotential,
};

export const MOTION_KINDS = Object.keys(MOTIONS);

export const forceOf = (tree) => FORCES[tree.kind](tree);
