// Networks of tanh: values, gradients by inputs, derivatives by weights.

import { arrayOf } from "./numbers.js";

function layersOf(tree) {
  let from = 0;
  return tree.layers.map((layer) => {
    const weight = arrayOf(layer.weight);
    const bias = arrayOf(layer.bias);
    const rows = bias.length;
    const columns = weight.length / rows;
    const result = {
      weight,
      bias,
      rows,
      columns,
      from, // place of its weights among all parameters; its biases follow them
      h: new Float64Array(rows), // output, after tanh where it is hidden
      dh: new Float64Array(rows), // change of the output along a direction
      da: new Float64Array(rows), // change before tanh
      g: new Float64Array(rows), // adjoint of the output
      gd: new Float64Array(rows), // adjoint of its change
    };
    from += rows * columns + rows;
    return result;
  });
}

/** A multilayer perceptron; `u` are its inputs. */
export function networkOf(tree) {
  const layers = layersOf(tree);
  const last = layers.length - 1;
  const inputs = layers[0].columns;
  const outputs = layers[last].rows;

  function value(u) {
    let below = u;
    layers.forEach((layer, l) => {
      for (let i = 0; i < layer.rows; i++) {
        let a = layer.bias[i];
        const row = i * layer.columns;
        for (let j = 0; j < layer.columns; j++) a += layer.weight[row + j] * below[j];
        layer.h[i] = l < last ? Math.tanh(a) : a;
      }
      below = layer.h;
    });
    return below;
  }

  /** Gradient of one output by the inputs, after `value`. */
  function gradient(output, into) {
    layers[last].g.fill(0);
    layers[last].g[output] = 1;
    for (let l = last; l >= 0; l--) {
      const layer = layers[l];
      const under = l > 0 ? layers[l - 1] : null;
      const target = under ? under.g : into;
      target.fill(0);
      for (let i = 0; i < layer.rows; i++) {
        const g = layer.g[i];
        if (g === 0) continue;
        const row = i * layer.columns;
        for (let j = 0; j < layer.columns; j++) target[j] += g * layer.weight[row + j];
      }
      if (under) {
        for (let j = 0; j < under.rows; j++) under.g[j] *= 1 - under.h[j] * under.h[j];
      }
    }
    return into;
  }

  /** Derivatives of one output by all weights, after `value`, times a factor. */
  function weightGradient(u, output, factor, row, from) {
    layers[last].g.fill(0);
    layers[last].g[output] = factor;
    for (let l = last; l >= 0; l--) {
      const layer = layers[l];
      const below = l > 0 ? layers[l - 1].h : u;
      writeOuter(layer, layer.g, below, null, null, row, from);
      if (l === 0) break;
      const under = layers[l - 1];
      multiplyTransposed(layer, layer.g, under.g);
      for (let j = 0; j < under.rows; j++) under.g[j] *= 1 - under.h[j] * under.h[j];
    }
  }

  /**
   * Derivatives by all weights of the slope of output 0 along input k, after `value`.
   *
   * Forward along the direction (dh, da), then backward through both: the derivative of
   * tanh enters twice, because the slope of a hidden unit is (1 - h²) da.
   */
  function slopeGradient(u, k, factor, row, from) {
    let below = null;
    layers.forEach((layer, l) => {
      for (let i = 0; i < layer.rows; i++) {
        let da = 0;
        const start = i * layer.columns;
        if (l === 0) da = layer.weight[start + k];
        else for (let j = 0; j < layer.columns; j++) da += layer.weight[start + j] * below[j];
        layer.da[i] = da;
        layer.dh[i] = l < last ? (1 - layer.h[i] * layer.h[i]) * da : da;
      }
      below = layer.dh;
    });
    const unit = new Float64Array(inputs);
    unit[k] = 1;
    layers[last].g.fill(0);
    layers[last].gd.fill(0);
    layers[last].gd[0] = factor;
    for (let l = last; l >= 0; l--) {
      const layer = layers[l];
      const under = l > 0 ? layers[l - 1] : null;
      const h = under ? under.h : u;
      const dh = under ? under.dh : unit;
      writeOuter(layer, layer.g, h, layer.gd, dh, row, from);
      if (!under) break;
      multiplyTransposed(layer, layer.g, under.g);
      multiplyTransposed(layer, layer.gd, under.gd);
      for (let j = 0; j < under.rows; j++) {
        const slope = 1 - under.h[j] * under.h[j];
        const twice = -2 * under.h[j] * slope * under.da[j];
        under.g[j] = slope * under.g[j] + twice * under.gd[j];
        under.gd[j] *= slope;
      }
    }
  }

  const end = layers[last];
  const parameters = end.from + end.rows * end.columns + end.rows;
  return { inputs, outputs, parameters, value, gradient, weightGradient, slopeGradient };
}

function multiplyTransposed(layer, above, into) {
  into.fill(0);
  for (let i = 0; i < layer.rows; i++) {
    const row = i * layer.columns;
    for (let j = 0; j < layer.columns; j++) into[j] += above[i] * layer.weight[row + j];
  }
}

/** Derivatives by the weights and biases of a layer, from the adjoints above it. */
function writeOuter(layer, g, below, gd, dbelow, row, from) {
  const start = from + layer.from;
  const biases = start + layer.rows * layer.columns;
  for (let i = 0; i < layer.rows; i++) {
    for (let j = 0; j < layer.columns; j++) {
      let value = g[i] * below[j];
      if (gd) value += gd[i] * dbelow[j];
      row[start + i * layer.columns + j] = value;
    }
    row[biases + i] = g[i];
  }
}

function featuresOf(tree) {
  const center = arrayOf(tree.center);
  const scale = arrayOf(tree.scale);
  const timed = tree.kind === "PositionTimeFeatures";
  const u = new Float64Array(center.length);
  function at(t, x) {
    const dim = timed ? u.length - 1 : u.length;
    for (let d = 0; d < dim; d++) u[d] = (x[d] - center[d]) / scale[d];
    if (timed) u[dim] = (t - center[dim]) / scale[dim];
    return u;
  }
  return { at, scale, timed };
}

export function neuralForce(tree) {
  const network = networkOf(tree.network);
  const features = featuresOf(tree.features);
  const scale = tree.scale;
  return {
    timed: features.timed,
    add(t, x, v, out) {
      const values = network.value(features.at(t, x));
      for (let d = 0; d < network.outputs; d++) out[d] += scale * values[d];
    },
    parameters: network.parameters,
    basis(t, x, rows, from) {
      const u = features.at(t, x);
      network.value(u);
      for (let d = 0; d < network.outputs; d++) {
        network.weightGradient(u, d, scale, rows[d], from);
      }
    },
  };
}

export function neuralPotential(tree) {
  const network = networkOf(tree.network);
  const features = featuresOf(tree.features);
  const scale = tree.scale;
  const slope = new Float64Array(network.inputs);
  return {
    timed: features.timed,
    add(t, x, v, out) {
      network.value(features.at(t, x));
      network.gradient(0, slope);
      for (let d = 0; d < x.length; d++) out[d] -= (scale * slope[d]) / features.scale[d];
    },
    potential(t, x) {
      return scale * network.value(features.at(t, x))[0];
    },
    parameters: network.parameters,
    basis(t, x, rows, from) {
      const u = features.at(t, x);
      network.value(u);
      for (let d = 0; d < x.length; d++) {
        network.slopeGradient(u, d, -scale / features.scale[d], rows[d], from);
      }
    },
  };
}

/** The black box: the network of state and time that is the whole rate of change. */
export function neuralDynamics(tree) {
  const network = networkOf(tree.network);
  const center = arrayOf(tree.center);
  const scale = arrayOf(tree.scale);
  const u = new Float64Array(network.inputs);
  return (t, y, out) => {
    for (let i = 0; i < y.length; i++) u[i] = (y[i] - center[i]) / scale[i];
    u[y.length] = (t - center[y.length]) / scale[y.length];
    out.set(network.value(u));
  };
}
