"""optimistix's Levenberg-Marquardt on the plain rollout's residuals, in float64."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix

from benchmarks.fit.contestants import Effort
from benchmarks.fit.diffrax_adam import rollout, untrained
from benchmarks.fit.problem import Problem, Trained, network_arrays


def train(problem: Problem, seed: int, effort: Effort) -> Trained:
    """The paper's network from the same start as the paper's recipe.

    The Jacobian is forward-mode, the default, for which diffrax advises `ForwardMode`.
    """
    jax.config.update("jax_enable_x64", val=True)
    network = jax.tree.map(
        lambda leaf: leaf.astype(float) if eqx.is_inexact_array(leaf) else leaf,
        untrained(seed),
    )
    params, static = eqx.partition(network, eqx.is_inexact_array)
    states = jnp.asarray(problem.states[0], float)

    def residuals(params, _):
        network = eqx.combine(params, static)
        return rollout(problem, network, diffrax.ForwardMode(), 1e-8) - states

    solution = optimistix.least_squares(
        residuals,
        optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        params,
        max_steps=effort.marquardt_steps,
        throw=False,
    )
    steps = int(solution.stats["num_steps"])
    layers = eqx.combine(solution.value, static).layers
    arrays = network_arrays([(layer.weight, layer.bias) for layer in layers])
    note = "" if steps < effort.marquardt_steps else f"stopped after {steps} steps"
    return Trained(arrays, steps, note=note)
