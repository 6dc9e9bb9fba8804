"""The paths of a system's truth, before anybody observes them."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64, PRNGKeyArray

from pinav.dynamics import (
    BrownianSwimmer,
    ForwardOnly,
    OverdampedSwimmer,
    rollout,
    sample_path,
)
from pinav.errors import InputError
from pinav.forces import AbstractCommandedForce, SampledFlow, SumFlow
from pinav.systems import System, WanderingVelocity

SUBSTEPS = 8
"""Steps of a stochastic truth between two observations."""


def true_paths(
    system: System, key: PRNGKeyArray | None, *, parts: int = 1
) -> tuple[Float64[np.ndarray, "trajectory time state"], dict[str, str | float | int]]:
    """States at the times of a system, and the method by which they were found.

    Args:
        key: random key of Brownian motion and of a wandering velocity, if any.
        parts: equal parts into which the states divide each interval of the times, a
            divisor of `SUBSTEPS`; the path does not depend on it.

    Raises:
        InputError: the truth is stochastic and there is no key.
    """
    substeps = SUBSTEPS // parts
    system = dataclasses.replace(system, times=divide_times(system.times, parts))
    truth = system.truth
    stochastic = isinstance(truth, BrownianSwimmer) or system.wandering is not None
    if not stochastic:
        solver = ForwardOnly()
        solve = eqx.filter_jit(rollout)
        runs = [solve(truth, y0, system.times, solver=solver) for y0 in system.starts]
        steps = solver.solver
        name = type(steps.method).__name__
        method = {"solver": name, "rtol": steps.rtol, "atol": steps.atol}
        return np.stack([run.ys for run in runs]), method
    if key is None:
        raise InputError(
            f"simulate: system {system.name!r} is stochastic; "
            "pass key=jax.random.key(seed)"
        )
    if not isinstance(truth, BrownianSwimmer):
        assert isinstance(truth, OverdampedSwimmer)
        truth = BrownianSwimmer(truth, 0.0)
    method = {"solver": "Euler-Maruyama", "substeps": SUBSTEPS}
    return _sample_paths(system, truth, key, substeps), method


def divide_times(times: Float[Array, " time"], parts: int) -> Float[Array, " finer"]:
    """Times that divide each interval into equal parts."""
    count = len(times) - 1
    places = jnp.arange(count * parts + 1.0) / parts
    return times if parts == 1 else jnp.interp(places, jnp.arange(count + 1.0), times)


def _sample_paths(
    system: System, truth: BrownianSwimmer, key: PRNGKeyArray, substeps: int
) -> Float64[np.ndarray, "trajectory time state"]:
    key = jax.random.fold_in(key, 1)  # apart from the noise of observation
    wandering = system.wandering

    @eqx.filter_jit
    def sample(
        truth: BrownianSwimmer, starts: Array, times: Array, indices: Array
    ) -> Array:
        def one(y0: Array, index: Array) -> Array:
            path_key = jax.random.fold_in(key, index)
            wanderer = truth
            if wandering is not None:
                drift_key = jax.random.fold_in(path_key, 1)
                grid = divide_times(times, substeps)
                wanderer = _wandering(truth, system, wandering, drift_key, grid)
            return sample_path(wanderer, y0, times, key=path_key, substeps=substeps).ys

        return jax.vmap(one)(starts, indices)

    indices = jnp.arange(len(system.starts))
    return np.asarray(sample(truth, system.starts, system.times, indices))


def _wandering(
    truth: BrownianSwimmer,
    system: System,
    wandering: WanderingVelocity,
    key: PRNGKeyArray,
    grid: Float[Array, " step"],
) -> BrownianSwimmer:
    """The swimmer carried by one draw of its wandering velocity, linear in between."""
    # Over a step the process keeps this part of its value, and gains the variance
    # that it loses: exact at the steps, whatever their length.
    kept = jnp.exp(-jnp.diff(grid) / wandering.memory)
    kicks = jax.random.normal(key, (len(grid), system.dim))

    def step(value: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        part, kick = inputs
        value = part * value + jnp.sqrt(1 - part**2) * kick
        return value, value

    later = jax.lax.scan(step, kicks[0], (kept, kicks[1:]))[1]
    unit = jnp.concatenate([kicks[:1], later])
    velocity = _deviation(truth, wandering, grid)[:, None] * unit
    flow = SumFlow((truth.swimmer.flow, SampledFlow(grid, velocity)))
    return dataclasses.replace(
        truth, swimmer=dataclasses.replace(truth.swimmer, flow=flow)
    )


def _deviation(
    truth: BrownianSwimmer, wandering: WanderingVelocity, times: Float[Array, " time"]
) -> Float[Array, " time"]:
    """Standard deviation of the wandering velocity, greater under a command."""
    propulsion = truth.swimmer.propulsion
    programme = getattr(propulsion, "programme", None)
    if not isinstance(propulsion, AbstractCommandedForce) or programme is None:
        return wandering.strength(jnp.zeros_like(times))
    return wandering.strength(jax.vmap(lambda t: programme(t)[0])(times))
