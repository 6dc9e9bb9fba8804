"""One loss gradient of the paper's 501-sample rollout, by every gradient method.

Run with `python -m benchmarks gradient`. Float32, the paper's untrained network (seed
42), the same loss in every row; the methods take turns, so that a change of the
machine's speed meets all of them. "error" is the relative distance of the gradient from
a float64 reference (our fixed step against itself in float64; the others against
diffrax at 1e-10), so it holds rounding and, for the continuous adjoints, their own
solver error.
"""

import time
from collections.abc import Sequence
from typing import Annotated

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import tyro
from jax.flatten_util import ravel_pytree

from benchmarks.continuous_adjoint import InterpolatingAdjoint
from pinav.commands.parsing import parse
from pinav.dynamics import (
    RK4,
    AbstractSolver,
    Adaptive,
    FixedStep,
    with_dtype,
)
from pinav.fitting.environments.summary import learned_part
from pinav.fitting.matching.state import split_trainable
from pinav.forces import paper_force
from pinav.scenarios import paper
from pinav.trajectories import simulate


class PlainScan(AbstractSolver):
    """The same Runge-Kutta steps, differentiated by JAX through the scan."""

    method: FixedStep = FixedStep()

    def solve(self, vector_field, y0, ts):
        def record(y, interval):
            y = self.method.step(vector_field, y, interval[0], interval[1])
            return y, y

        _, later = jax.lax.scan(record, y0, jnp.stack([ts[:-1], ts[1:]], axis=1))
        ys = jnp.concatenate([y0[None], later])
        return ys, jnp.all(jnp.isfinite(ys))


class DiffraxFixedStep(AbstractSolver):
    """diffrax's Tsit5 with the constant step of the samples and its default adjoint."""

    def solve(self, vector_field, y0, ts):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, field: field(t, y)),  # pyright: ignore
            diffrax.Tsit5(),
            ts[0],
            ts[-1],
            ts[1] - ts[0],
            y0,
            args=vector_field,
            saveat=diffrax.SaveAt(ts=ts),
            max_steps=1024,
            throw=False,
        )
        return jnp.asarray(solution.ys), solution.result == diffrax.RESULTS.successful


def adaptive(adjoint: diffrax.AbstractAdjoint, tolerance: float = 1e-6) -> Adaptive:
    return Adaptive(tolerance, tolerance, diffrax.Tsit5(), adjoint, 4096)


METHODS: dict[str, AbstractSolver] = {
    "pinav FixedStep Tsit5 (default)": FixedStep(),
    "pinav FixedStep RK4": FixedStep(RK4),
    "lax.scan of Tsit5 steps": PlainScan(),
    "diffrax Tsit5 1e-6, RecursiveCheckpointAdjoint": adaptive(
        diffrax.RecursiveCheckpointAdjoint()
    ),
    "diffrax Tsit5 1e-6, DirectAdjoint": adaptive(diffrax.DirectAdjoint()),
    "diffrax Tsit5 step 0.1, RecursiveCheckpointAdjoint": DiffraxFixedStep(),
    "diffrax Tsit5 1e-6, BacksolveAdjoint": adaptive(diffrax.BacksolveAdjoint()),
    "InterpolatingAdjoint 1e-6 (as in the paper)": InterpolatingAdjoint(),
}


def gradient_function(solver: AbstractSolver, dtype: type):
    """Compiled gradient of the loss, and the weights to call it with."""
    scenario = paper()
    states = jnp.asarray(simulate(scenario).states[0], dtype)
    times = jnp.asarray(scenario.times, dtype)
    model = with_dtype(
        scenario.swimmer.with_environment(paper_force(jax.random.key(42))), dtype
    )
    params, static = split_trainable(model, learned_part, dtype)

    def loss(params):
        ys, _ = solver.solve(eqx.combine(params, static), states[0], times)
        return jnp.sum((ys - states) ** 2)

    return jax.jit(jax.value_and_grad(loss)), params


def reference(solver: AbstractSolver) -> np.ndarray:
    fixed = isinstance(solver, FixedStep | PlainScan)
    exact = solver if fixed else adaptive(diffrax.RecursiveCheckpointAdjoint(), 1e-10)
    function, params = gradient_function(exact, jnp.float64)
    return np.asarray(ravel_pytree(function(params)[1])[0])


class Options(msgspec.Struct, frozen=True):
    """Time one loss gradient of the paper's rollout, by every gradient method."""

    rounds: Annotated[int, tyro.conf.arg(help="Times that each method is timed.")] = 30


def main(argv: Sequence[str]) -> None:
    options = parse(Options, argv, prog="python -m benchmarks gradient")
    if options is not None:
        compare(options.rounds)


def compare(rounds: int) -> None:
    jax.config.update("jax_enable_x64", val=True)
    compiled, first, times = {}, {}, {name: [] for name in METHODS}
    errors = {}
    for name, solver in METHODS.items():
        function, params = gradient_function(solver, jnp.float32)
        start = time.perf_counter()
        _, gradient = jax.block_until_ready(function(params))
        first[name] = time.perf_counter() - start
        compiled[name] = function, params
        exact = reference(solver)
        difference = np.asarray(ravel_pytree(gradient)[0]) - exact
        errors[name] = np.linalg.norm(difference) / np.linalg.norm(exact)
    for _ in range(rounds):
        for name, (function, params) in compiled.items():
            start = time.perf_counter()
            jax.block_until_ready(function(params))
            times[name].append(time.perf_counter() - start)
    ours = np.median(times["pinav FixedStep Tsit5 (default)"])
    print(
        f"{'gradient method':<52}{'median ms':>10}{'min ms':>8}{'ratio':>7}"
        f"{'first call s':>14}{'error':>9}"
    )
    for name, values in times.items():
        median = np.median(values)
        print(
            f"{name:<52}{1e3 * median:>10.2f}{1e3 * min(values):>8.2f}"
            f"{median / ours:>7.1f}{first[name]:>14.1f}{errors[name]:>9.0e}"
        )
