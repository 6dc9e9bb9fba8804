"""The paper's recipe against diffrax's public API, as its examples do."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from benchmarks.fit.contestants import Effort
from benchmarks.fit.problem import (
    Problem,
    Trained,
    network_arrays,
    paced,
    whole_recipe,
)


def vector_field(problem: Problem):
    """dy/dt of the swimmer with a network of (x, y, t) as its environment."""
    thrust = jnp.asarray(problem.thrust, float)

    def rate(t, y, network):
        x, v = jnp.split(y, 2)
        force = network(jnp.append(x, t))
        return jnp.concatenate([v, thrust - problem.damping * v + force])

    return rate


def rollout(problem: Problem, network, adjoint: diffrax.AbstractAdjoint, tolerance):
    """States at the sample times by adaptive Tsit5."""
    ts = jnp.asarray(problem.times, float)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(vector_field(problem)),  # pyright: ignore
        diffrax.Tsit5(),
        t0=ts[0],
        t1=ts[-1],
        dt0=ts[1] - ts[0],
        y0=jnp.asarray(problem.states[0, 0], float),
        args=network,
        saveat=diffrax.SaveAt(ts=ts),
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        adjoint=adjoint,
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys


def untrained(seed: int) -> eqx.nn.MLP:
    """The paper's network, the same as pinav's for the same seed."""
    return eqx.nn.MLP(3, 2, 32, 2, activation=jnp.tanh, key=jax.random.key(seed))


def train(problem: Problem, seed: int, effort: Effort) -> Trained:
    """Adam at 0.01, then L-BFGS, in float32."""
    params, static = eqx.partition(untrained(seed), eqx.is_inexact_array)
    states = jnp.asarray(problem.states[0], float)
    adjoint = diffrax.RecursiveCheckpointAdjoint()

    def loss(params):
        network = eqx.combine(params, static)
        return jnp.sum((rollout(problem, network, adjoint, 1e-6) - states) ** 2)

    loop = _Loop(loss, params)
    adam = loop.run(_adam_step, optax.adam(1e-2), effort.adam_steps, effort.seconds)
    lbfgs = loop.run(
        _lbfgs_step, optax.lbfgs(), effort.lbfgs_steps, fraction=adam.fraction
    )
    iterations, full, note = whole_recipe([adam, lbfgs])
    layers = eqx.combine(loop.params, static).layers
    arrays = network_arrays([(layer.weight, layer.bias) for layer in layers])
    return Trained(arrays, iterations, full_seconds=full, note=note)


class _Loop:
    """Parameters on their way, one compiled step after the other."""

    def __init__(self, loss, params):
        self.loss, self.params = loss, params

    def run(self, step, optimiser, steps, seconds=float("inf"), fraction=1.0):
        state = optimiser.init(self.params)
        compiled = jax.jit(
            lambda params, state: step(self.loss, optimiser, params, state)
        )

        def once():
            nonlocal state
            self.params, state = jax.block_until_ready(compiled(self.params, state))

        return paced(once, steps, seconds=seconds, fraction=fraction)


def _adam_step(loss, optimiser, params, state):
    gradient = jax.grad(loss)(params)
    updates, state = optimiser.update(gradient, state)
    return optax.apply_updates(params, updates), state


def _lbfgs_step(loss, optimiser, params, state):
    value, gradient = optax.value_and_grad_from_state(loss)(params, state=state)
    updates, state = optimiser.update(
        gradient, state, params, value=value, grad=gradient, value_fn=loss
    )
    return optax.apply_updates(params, updates), state
