// Models: the functions that Python printed for the run, called under parameters and
// commands.
//
// PROGRAMS, which stands before this module, has an object of functions for each model.
// Each is called with the parameters and the commands, and returns a function of time and
// place that fills an array, row by row.

import { arrayOf } from "./numbers.js";

const NOTHING = new Float64Array(0);

/** The arguments of controls {thrust, turn} or {frequency, heading, commands}. */
function commandsOf(controls, count) {
  if (count === null) return [controls.thrust ?? 1, controls.turn ?? 0];
  const { commands } = controls;
  if (!commands) {
    const held = (value) => new Float64Array(count).fill(value);
    return [held(0), held(controls.frequency ?? 0), held(controls.heading ?? 0)];
  }
  // The last command holds on, as often as is missing.
  return ["times", "frequency", "heading"].map((name) => {
    const given = arrayOf(commands[name]);
    return Float64Array.from({ length: count }, (_, k) => given[Math.min(k, given.length - 1)]);
  });
}

/**
 * A model of the run, ready to be evaluated under some controls.
 *
 * @param known what the run knows of it: {program, states, firstDriven, timed, parameters}.
 * @param count number of commands that propulsions take, null where they take none.
 * @param theta its parameters, if it has any.
 */
export function compile(known, count, controls = {}, theta = NOTHING) {
  const program = PROGRAMS[known.program];
  const early = [theta, ...commandsOf(controls, count)];
  const made = (name) => program[name]?.(...early);
  return {
    ...known,
    rate: made("rate"),
    // Constant commands do not jump.
    jumps: count !== null && !controls.commands ? [] : jumpsOf(made("jumps")),
    environment: environmentOf(made("force"), made("potential"), made("basis"), known),
    columns: made("columns"),
  };
}

/** Times at which a thrust jumps, each once. */
function jumpsOf(fill) {
  const times = [];
  fill?.(times);
  return [...new Set(times)].sort((a, b) => a - b);
}

/** {force(t, x, out), potential(t, x), basis(t, x, rows), timed}; null where there is none. */
function environmentOf(force, potential, basis, { parameters, timed }) {
  if (!force) return null;
  const height = [0];
  const flat = new Float64Array(2 * parameters);
  return {
    timed,
    force,
    potential: potential && ((t, x) => (potential(t, x, height), height[0])),
    basis:
      basis &&
      ((t, x, rows) => {
        basis(t, x, flat);
        rows.forEach((row, d) => row.set(flat.subarray(d * parameters, (d + 1) * parameters)));
      }),
  };
}

/** The posterior of a run, as theta = mean + factor z with standard normal z. */
export function posteriorOf(packed) {
  if (!packed) return null;
  const mean = arrayOf(packed.mean);
  const factor = arrayOf(packed.factor); // one parameter a row, one direction a column
  const rank = factor.length / mean.length;
  return {
    count: mean.length,
    rank,
    mean,
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

/** Derivatives of the rate of change by each parameter: `at` fills rows[state][parameter]. */
export function parameterColumns(model) {
  const { parameters: count, firstDriven } = model;
  const flat = new Float64Array(2 * count);
  return {
    model,
    count,
    at(t, y, rows) {
      model.columns(t, y, flat);
      for (let d = 0; d < 2; d++) rows[firstDriven + d].set(flat.subarray(d * count, (d + 1) * count));
    },
  };
}
