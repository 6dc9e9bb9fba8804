// Structured terms of a force: profiles of a coordinate, and linear forces.

import { arrayOf } from "./numbers.js";

const onlyNumber = (value) => arrayOf(value)[0];

const NEAR_CENTRE = 1e-3; // of distances, in widths of a kernel: as in forces/structures.py

/** The profile of a term: its force at a place along the coordinate. */
function profileOf(tree, odd) {
  const weights = arrayOf(tree.weights);
  const places = arrayOf(tree.places);
  const width = onlyNumber(tree.width);
  return (z) => {
    let total = 0;
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
