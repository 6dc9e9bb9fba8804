// Swimmers: the rate of change of a state, and its derivatives by the parameters.

import { FORCES, forceOf } from "./forces.js";
import { flowOf, tensorOf } from "./media.js";
import { neuralDynamics } from "./network.js";
import { arrayOf } from "./numbers.js";

const NOTHING = { kind: "ZeroForce" };

/**
 * What the operator changes: {thrust, turn, frequency, heading, commands}.
 *
 * A propulsion that takes commands gets a constant frequency and heading, or recorded
 * commands; any other is multiplied by `thrust` and turned by `turn` [rad]. A vector
 * `steer` takes its place, and may be changed between evaluations.
 */
function propulsionOf(tree, controls) {
  const { steer } = controls;
  if (steer) {
    return {
      add(t, x, v, out) {
        for (let d = 0; d < out.length; d++) out[d] += steer[d];
      },
    };
  }
  if (tree.kind === "RollingPropulsion" && !tree.programme) {
    const held = { kind: "HeldProgramme", times: [0] };
    const commands = controls.commands ?? {
      ...held,
      frequency: [controls.frequency ?? 0],
      heading: [controls.heading ?? 0],
    };
    return forceOf({ ...tree, commands });
  }
  const force = forceOf(tree);
  const { thrust = 1, turn = 0 } = controls;
  if (thrust === 1 && turn === 0) return force;
  const [cos, sin] = [thrust * Math.cos(turn), thrust * Math.sin(turn)];
  const part = [0, 0];
  return {
    ...force,
    add(t, x, v, out) {
      part.fill(0);
      force.add(t, x, v, part);
      out[0] += cos * part[0] - sin * part[1];
      out[1] += sin * part[0] + cos * part[1];
    },
  };
}

/** A model of the run, ready to be evaluated under some controls. */
export function compile(tree, dim, controls = {}) {
  if (tree.kind === "NeuralDynamics") {
    const rate = neuralDynamics(tree);
    return {
      ...{ order: 2, dim, states: 2 * dim, firstDriven: dim },
      ...{ rate, jumps: [], timed: true, environment: null },
    };
  }
  const environment = forceOf(tree.environment);
  const propulsion = propulsionOf(tree.propulsion, controls);
  const known = forceOf(tree.known_force ?? NOTHING);
  const make = tree.kind === "Swimmer" ? withInertia : withoutInertia;
  const parts = make(tree, dim, propulsion, environment, known);
  return {
    ...parts,
    dim,
    environment,
    jumps: propulsion.jumps ?? [],
    timed: Boolean(environment.timed),
  };
}

function withInertia(tree, dim, propulsion, environment, known) {
  const drag = forceOf(tree.drag);
  const x = new Float64Array(dim);
  const v = new Float64Array(dim);
  const a = new Float64Array(dim);
  return {
    order: 2,
    states: 2 * dim,
    rate(t, y, out) {
      for (let d = 0; d < dim; d++) {
        x[d] = y[d];
        v[d] = y[dim + d];
        a[d] = 0;
      }
      propulsion.add(t, x, v, a);
      drag.add(t, x, v, a);
      environment.add(t, x, v, a);
      known.add(t, x, v, a);
      for (let d = 0; d < dim; d++) {
        out[d] = v[d];
        out[dim + d] = a[d];
      }
    },
    // A force of the environment changes the velocities as it is.
    response: (x, force, out) => out.set(force),
    firstDriven: dim,
  };
}

function withoutInertia(tree, dim, propulsion, environment, known) {
  const mobility = tensorOf(tree.mobility);
  const flow = flowOf(tree.flow);
  const rest = new Float64Array(dim);
  const force = new Float64Array(dim);
  const drift = new Float64Array(dim);
  return {
    order: 1,
    states: dim,
    rate(t, y, out) {
      force.fill(0);
      propulsion.add(t, y, rest, force);
      environment.add(t, y, rest, force);
      known.add(t, y, rest, force);
      mobility(y, force, drift);
      out.set(drift);
      flow(t, y, out);
    },
    response: (x, force, out) => mobility(x, force, out),
    firstDriven: 0,
  };
}

/** A copy of the tree in which the leaves of a parameter vector have new values. */
export function withParameters(tree, leaves, theta) {
  const copy = structuredClone(tree);
  let from = 0;
  for (const { path, size } of leaves) {
    let place = copy;
    for (const word of path.slice(0, -1)) place = place[word];
    const name = path.at(-1);
    const values = Array.from(theta.subarray(from, from + size));
    place[name] = keepShape(place[name], values);
    from += size;
  }
  return copy;
}

function keepShape(old, values) {
  if (typeof old === "number") return values[0];
  const shape = Array.isArray(old) ? shapeOf(old) : old.shape;
  if (shape.length < 2) return values;
  const width = values.length / shape[0];
  return Array.from({ length: shape[0] }, (_, i) => values.slice(i * width, (i + 1) * width));
}

const shapeOf = (list) => (Array.isArray(list) ? [list.length, ...shapeOf(list[0])] : []);

/** The posterior of a run, as theta = mean + factor z with standard normal z. */
export function posteriorOf(packed) {
  if (!packed) return null;
  const mean = arrayOf(packed.mean);
  const factor = arrayOf(packed.factor); // one parameter a row, one direction a column
  const rank = factor.length / mean.length;
  const sd = new Float64Array(mean.length);
  for (let i = 0; i < mean.length; i++) {
    let total = 0;
    for (let k = 0; k < rank; k++) total += factor[i * rank + k] ** 2;
    sd[i] = Math.sqrt(total);
  }
  return {
    leaves: packed.leaves,
    count: mean.length,
    rank,
    mean,
    sd,
    factor,
    draw(normal) {
      const z = Float64Array.from({ length: rank }, normal);
      return mean.map((value, i) => {
        let total = value;
        for (let k = 0; k < rank; k++) total += factor[i * rank + k] * z[k];
        return total;
      });
    },
  };
}

/**
 * Derivatives of the rate of change by each parameter, as rows over the parameters.
 *
 * Weights of the environment have exact ones. Constants are few, and differences of the
 * compiled model serve them, by a tenth of a standard deviation: rounding is far below,
 * curvature as well.
 */
export function parameterColumns(tree, posterior, dim, controls) {
  const model = compile(tree, dim, controls);
  const rows = Array.from({ length: dim }, () => new Float64Array(posterior.count));
  const weights = weightLeaves(tree, posterior);
  const constants = [];
  let at = 0;
  let from = -1;
  for (const { path, size } of posterior.leaves) {
    const isWeight = weights.some((one) => one.path === path);
    if (isWeight && from < 0) from = at;
    for (let i = at; !isWeight && i < at + size; i++) constants.push(i);
    at += size;
  }
  const steps = constants.map((i) => {
    const step = Math.max(0.1 * posterior.sd[i], 1e-7 * Math.abs(posterior.mean[i]), 1e-12);
    const shifted = (sign) => {
      const theta = posterior.mean.slice();
      theta[i] += sign * step;
      return compile(withParameters(tree, posterior.leaves, theta), dim, controls).rate;
    };
    return { i, step, up: shifted(1), down: shifted(-1) };
  });
  const x = new Float64Array(dim);
  const unit = new Float64Array(dim);
  const driven = Array.from({ length: dim }, () => new Float64Array(dim));
  const above = new Float64Array(model.states);
  const below = new Float64Array(model.states);

  /** Fill columns[state][parameter] at time t and state y. */
  function columnsAt(t, y, columns) {
    for (const row of columns) row.fill(0);
    if (from >= 0) {
      for (let d = 0; d < dim; d++) x[d] = y[d];
      model.environment.basis(t, x, rows, from);
      const end = from + model.environment.parameters;
      for (let e = 0; e < dim; e++) {
        unit.fill(0);
        unit[e] = 1;
        model.response(x, unit, driven[e]);
      }
      for (let d = 0; d < dim; d++) {
        const column = columns[model.firstDriven + d];
        for (let e = 0; e < dim; e++) {
          const factor = driven[e][d];
          const row = rows[e];
          if (factor !== 0) for (let i = from; i < end; i++) column[i] += factor * row[i];
        }
      }
    }
    for (const { i, step, up, down } of steps) {
      up(t, y, above);
      down(t, y, below);
      for (let s = 0; s < model.states; s++) columns[s][i] = (above[s] - below[s]) / (2 * step);
    }
  }
  /** Fill rows[axis][parameter] with the derivatives of the environment's force alone. */
  function environment(t, x, into) {
    if (from >= 0) model.environment.basis(t, x, into, from);
  }
  return { model, count: posterior.count, at: columnsAt, environment };
}

/** Leaves below the environment, where that has derivatives of its own. */
function weightLeaves(tree, posterior) {
  const environment = forceOf(tree.environment);
  const below = posterior.leaves.filter((leaf) => leaf.path[0] === "environment");
  const size = below.reduce((total, leaf) => total + leaf.size, 0);
  return environment.basis && environment.parameters === size ? below : [];
}

/** Names of the classes of forces that the page evaluates, for the tests. */
export const FORCE_KINDS = Object.keys(FORCES);
