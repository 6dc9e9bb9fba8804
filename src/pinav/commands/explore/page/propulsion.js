// Rolling by commands: frequency and heading over time, with response, delay and lag.

import { placeAmong } from "./media.js";
import { arrayOf } from "./numbers.js";

const first = (value) => arrayOf(value)[0];
const ROUNDING = 0.1; // relative width of the rounded corner of a step-out

const saturated = (f, corner) => f / Math.sqrt(1 + (f / corner) ** 2);

/** Effective frequency at a commanded one. */
export const RESPONSES = {
  LinearResponse: () => (f) => f,
  SaturatingResponse: (tree) => {
    const corner = first(tree.corner);
    return (f) => saturated(f, corner);
  },
  SlippingResponse: (tree) => {
    const [corner, residual] = [first(tree.corner), first(tree.residual)];
    return (f) => residual * f + (1 - residual) * saturated(f, corner);
  },
  StepOutResponse: (tree) => {
    const corner = first(tree.corner);
    const start = (Math.sqrt(1 + ROUNDING ** 2) - 1) / 2; // no slip at rest
    return (f) => {
      const above = (f / corner) ** 2 - 1;
      const rounded = (above + Math.sqrt(above ** 2 + ROUNDING ** 2)) / 2;
      return f - corner * (Math.sqrt(rounded) - Math.sqrt(start));
    };
  },
};

export const responseOf = (tree) => RESPONSES[tree.kind](tree);

/** What the robot has reached at each time: behind the commands by a lag. */
function followed(times, asked, lag) {
  if (!(lag > 0)) return asked;
  const reached = asked.map((c) => [...c]);
  for (let k = 1; k < times.length; k++) {
    const kept = Math.exp(-(times[k] - times[k - 1]) / lag);
    for (const d of [0, 1]) {
      reached[k][d] = kept * reached[k - 1][d] + (1 - kept) * asked[k - 1][d];
    }
  }
  return reached;
}

/**
 * Propulsion under commands {times, frequency, heading}, which hold until the next one,
 * or under those of its own programme. It jumps: `jumps` are the times at which a
 * solver has to end a step.
 */
export function rollingPropulsion(tree) {
  const programme = tree.commands ?? tree.programme;
  let gain = arrayOf(tree.gain); // a matrix, or one number, or one for each axis
  if (gain.length < 4) gain = [gain[0], 0, 0, gain[gain.length - 1]];
  const response = responseOf(tree.response);
  const [delay, lag] = [first(tree.delay), first(tree.lag)];
  const [times, frequency, heading] = programme
    ? [programme.times, programme.frequency, programme.heading].map(arrayOf)
    : [[0], [0], [0]];
  const linear = programme?.kind === "LinearProgramme";
  const asked = Array.from(times, (_, k) => {
    const f = response(frequency[k]);
    return [f * Math.cos(heading[k]), f * Math.sin(heading[k])];
  });
  const reached = followed(times, asked, lag);
  const turned = unwrapped(heading);
  function command(t) {
    const [k, share] = placeAmong(times, t - delay);
    if (linear) {
      const next = Math.min(k + 1, times.length - 1);
      const f = response(frequency[k] + share * (frequency[next] - frequency[k]));
      const angle = turned[k] + share * (turned[next] - turned[k]);
      return [f * Math.cos(angle), f * Math.sin(angle)];
    }
    if (!(lag > 0)) return asked[k];
    const behind = Math.exp(-Math.max(t - delay - times[k], 0) / lag);
    return [0, 1].map((d) => asked[k][d] + (reached[k][d] - asked[k][d]) * behind);
  }
  return {
    timed: times.length > 1,
    jumps: linear || times.length === 1 ? [] : Array.from(times, (t) => t + delay),
    add(t, x, v, out) {
      const [a, b] = command(t);
      out[0] += gain[0] * a + gain[1] * b;
      out[1] += gain[2] * a + gain[3] * b;
    },
  };
}

/** Angles without jumps of whole turns. */
function unwrapped(angles) {
  const result = Float64Array.from(angles);
  let turns = 0;
  for (let k = 1; k < result.length; k++) {
    turns += Math.round((angles[k] - angles[k - 1]) / (2 * Math.PI));
    result[k] -= 2 * Math.PI * turns;
  }
  return result;
}
