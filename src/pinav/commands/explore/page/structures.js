// Structured terms of a force: profiles of a coordinate, and linear forces.

import { arrayOf } from "./numbers.js";

const onlyNumber = (value) => arrayOf(value)[0];

const NEAR_CENTRE = 0.05; // of distances, in widths of a kernel: as in forces/structures.py

/** Force of a hill of any tail at an offset from its top, for unit height. */
function hillForce(offset, size, form) {
  const tail = 0.5 * Math.expm1(form);
  const square = 0.5 * (offset / size) ** 2;
  const base = 1 + tail * square;
  if (base <= 0) return 0;
  const height = tail === 0 ? Math.exp(-square) : Math.exp(-Math.log1p(tail * square) / tail);
  return ((offset / size ** 2) * height) / base;
}

/** Force of a rounded step, for unit height. */
function stepForce(offset, size) {
  const rise = 1 / (1 + Math.exp(-offset / size));
  return (-rise * (1 - rise)) / size;
}

/** Forces of laws along the coordinate, as in forces/profile_laws.py. */
const LAWS = {
  HillLaw: (z, { log_size, form }) => hillForce(z, Math.exp(log_size), form),
  PlateauLaw: (z, { log_size, log_steepness }) => {
    const steepness = Math.exp(log_steepness);
    const power = (0.5 * (z / Math.exp(log_size)) ** 2) ** steepness;
    return (2 * steepness * power * Math.exp(-power)) / z;
  },
  RingLaw: (z, { radius, log_size, form }) => hillForce(z - radius, Math.exp(log_size), form),
  StepLaw: (z, { place, log_size }) => stepForce(z - place, Math.exp(log_size)),
  ChannelLaw: (z, { middle, half, log_size }) => {
    const [away, size] = [z - middle, Math.exp(log_size)];
    return stepForce(away - half, size) - stepForce(-away - half, size);
  },
  WaveLaw: (z, { place, log_size }) => Math.sin((z - place) / Math.exp(log_size)) / Math.exp(log_size),
};

/** The force of the law of a term, zero where it has none. */
function lawOf(tree) {
  if (!tree.law) return () => 0;
  const { kind, ...numbers } = tree.law;
  const height = arrayOf(tree.weights)[0];
  const constants = Object.fromEntries(Object.entries(numbers).map(([name, value]) => [name, onlyNumber(value)]));
  return (z) => height * LAWS[kind](z, constants);
}

/** The profile of a term: its force at a place along the coordinate. */
function profileOf(tree, odd) {
  const law = lawOf(tree);
  const weights = arrayOf(tree.weights).slice(tree.law ? 1 : 0);
  const places = arrayOf(tree.places);
  const width = onlyNumber(tree.width);
  return (z) => {
    let total = law(z);
    for (let j = 0; j < places.length; j++) {
      let value = Math.exp(-0.5 * ((z - places[j]) / width) ** 2);
      if (odd) value -= Math.exp(-0.5 * ((z + places[j]) / width) ** 2);
      total += weights[j] * value;
    }
    return total;
  };
}

/** A force along (a, b), turned by a right angle where the term is rotational. */
function addTurned(tree, out, a, b) {
  out[0] += tree.rotational ? -b : a;
  out[1] += tree.rotational ? a : b;
}

function centralTerm(tree) {
  const profile = profileOf(tree, true);
  const center = arrayOf(tree.center);
  const rounding = NEAR_CENTRE * onlyNumber(tree.width);
  return {
    add(t, x, v, out) {
      const [a, b] = [x[0] - center[0], x[1] - center[1]];
      const z = Math.hypot(a, b, rounding);
      const strength = profile(z) / z;
      addTurned(tree, out, strength * a, strength * b);
    },
  };
}

function ellipticTerm(tree) {
  const profile = profileOf(tree, true);
  const center = arrayOf(tree.center);
  const [p, q] = arrayOf(tree.shear);
  const rounding = NEAR_CENTRE * onlyNumber(tree.width);
  const size = Math.sqrt(p * p + q * q + 1e-12);
  const [even, odd] = [Math.cosh(size), Math.sinh(size) / size];
  const [xx, xy, yy] = [even + odd * p, odd * q, even - odd * p];
  return {
    add(t, x, v, out) {
      const [dx, dy] = [x[0] - center[0], x[1] - center[1]];
      const [a, b] = [xx * dx + xy * dy, xy * dx + yy * dy];
      const z = Math.hypot(a, b, rounding);
      const strength = profile(z) / z;
      addTurned(tree, out, strength * (xx * a + xy * b), strength * (xy * a + yy * b));
    },
  };
}

function wallTerm(tree) {
  const profile = profileOf(tree, false);
  const origin = arrayOf(tree.origin);
  const angle = onlyNumber(tree.angle);
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return {
    add(t, x, v, out) {
      const strength = profile(cos * (x[0] - origin[0]) + sin * (x[1] - origin[1]));
      addTurned(tree, out, strength * cos, strength * sin);
    },
  };
}

function linearTerm(tree) {
  const weights = arrayOf(tree.weights);
  const origin = arrayOf(tree.origin);
  const scale = onlyNumber(tree.scale);
  return {
    add(t, x, v, out) {
      const [a, b] = [(x[0] - origin[0]) / scale, (x[1] - origin[1]) / scale];
      if (tree.rotational) {
        addTurned(tree, out, (weights[0] * a) / scale, (weights[0] * b) / scale);
        return;
      }
      const [gx, gy, xx, xy, yy] = weights;
      addTurned(tree, out, (gx + xx * a + 0.5 * xy * b) / scale, (gy + 0.5 * xy * a + yy * b) / scale);
    },
  };
}

export const TERMS = {
  CentralTerm: centralTerm,
  EllipticTerm: ellipticTerm,
  WallTerm: wallTerm,
  LinearTerm: linearTerm,
};
