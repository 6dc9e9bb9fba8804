r"""Departures from the physics that a system states, weighed by the evidence.

The force of the environment is learned beside forces that are known. Where these are
wrong, kernels follow the trajectories all the same, with a rougher field: the residuals
may look like noise, but the evidence is far below that of the right physics. Here the
data, linearised about the fit (`ForceResponse`), are asked whether another force beside
kernels explains them better: a share of the propulsion or of the drag, the propulsion
at another time or along other axes, a push or a field that changes with time. The
kernels are as free as those of the fit. Where it has terms the departure is weighed
with these beside the kernels, too, and the better one counts on either side.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.dynamics import FixedStep, Swimmer
from pinav.fitting.checks.column_evidence import SEEN, ColumnWeigher
from pinav.fitting.matching.state import Observations
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.response import (
    ForceResponse,
    columns,
    force_response,
    group_means,
    parts_of,
    slopes,
)
from pinav.fitting.structure.starts import Region, linear_term
from pinav.forces import AbstractForce, ZeroForce, split_structure
from pinav.forces.priors import AbstractPrior, Matrix
from pinav.trajectories import Trajectories

Columns = Callable[[Scalar, Vector, Vector], Float[Array, "column dim"]]
"""Forces [L T⁻²] by time, place and velocity."""

Clause = Callable[[Float[np.ndarray, " column"]], str]
"""Clause on a departure by the coefficients of its columns."""


class Departure(eqx.Module):
    """Another force than the stated one.

    Attributes:
        name: of what departs, as tables print it.
        forces: its columns, each in units of the deviation of its coefficient.
        is_known: the coefficient is one; otherwise it has a normal prior.
    """

    name: str = eqx.field(static=True)
    forces: Columns = eqx.field(static=True)
    clause: Clause = eqx.field(static=True)
    is_known: bool = eqx.field(static=True, default=False)


class Contradiction(eqx.Module):
    """A departure, and what the data say of it.

    Attributes:
        gain: log evidence over what is stated [nats]; none of one that does not predict
            trajectories from the others better, or leaves more than the noise.
        clause: what it would be, such as "the thrust is 0.5 times the stated one".
    """

    name: str
    gain: float
    clause: str


DELAYS = (-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0)
"""Delays of commands that are tried, in intervals of the samples."""

RATES = (0.5, 0.67, 0.8, 0.9, 1.1, 1.25, 1.5, 2.0)
"""Units of time that are tried, in those of the file."""

KNOTS = 8
"""Knots in time of a push that changes."""

BROAD = 4.0
"""Deviation of a push and of a change of the field, in units of the force along the
data. Factors of stated forces have a mean of one and a deviation of two."""

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
"""A quarter turn."""

AXES = {
    "the thrust has its y axis mirrored": np.diag([1.0, -1.0]),
    "the thrust has its x axis mirrored": np.diag([-1.0, 1.0]),
    "the thrust has x and y exchanged": np.array([[0.0, 1.0], [1.0, 0.0]]),
    "the thrust has the opposite direction": -np.eye(2),
}
"""Changes of the axes of a planar thrust."""


def departures(
    model: Any, dim: int, times: Float[np.ndarray, "trajectory time"], force: float
) -> Iterator[Departure]:
    """Departures that a model of a swimmer may have.

    Args:
        times: of the samples [T].
        force: root mean square of the learned force along the data [L T⁻²].
    """
    has_inertia = isinstance(model, Swimmer)
    is_driven = not isinstance(model.propulsion, ZeroForce)

    def thrust(t: Scalar, x: Vector, v: Vector) -> Vector:
        return model.propulsion(t, x, v if has_inertia else jnp.zeros_like(x))

    if is_driven:
        steps = np.diff(times, axis=1)
        yield from _of_thrust(thrust, dim, float(np.median(steps[steps > 0])))
    if has_inertia:
        yield Departure(
            "drag",
            lambda t, x, v: 2 * model.drag(t, x, v)[None],
            lambda values: f"the drag is {_factor(values)} times the stated one",
        )
        yield Departure(
            "drag by speed",
            lambda _t, _x, v: -force * (jnp.linalg.norm(v) * v)[None],
            lambda _: "the drag changes with the speed",
        )
    if has_inertia or is_driven:
        for rate in RATES:
            yield Departure(
                "unit of time",
                _in_time(model, thrust, rate),
                lambda _, rate=rate: f"times are {rate:g} times the true ones",
                is_known=True,
            )
    yield from _in_course(model, dim, float(times.min()), float(times.max()), force)


def _of_thrust(thrust: Any, dim: int, interval: float) -> Iterator[Departure]:
    yield Departure(
        "thrust",
        lambda *at: 2 * thrust(*at)[None],
        lambda values: f"the thrust is {_factor(values)} times the stated one",
    )
    for delay in DELAYS:
        late = delay * interval
        when = f"{abs(late):.3g} {'later' if late > 0 else 'earlier'}"
        yield Departure(
            "delay",
            lambda t, x, v, d=late: (thrust(t - d, x, v) - thrust(t, x, v))[None],
            lambda _, when=when: f"commands act {when} than stated",
            is_known=True,
        )
    if dim != 2:
        return
    yield Departure(
        "heading",
        lambda *at: 2 * jnp.stack([thrust(*at), TURN @ thrust(*at)]),
        lambda values: (
            f"the thrust is {np.hypot(1 + 2 * values[0], 2 * values[1]):.2g} times the "
            f"stated one, turned by {_angle(values):.0f} degrees"
        ),
    )
    for clause, change in AXES.items():
        yield Departure(
            "axes",
            lambda *at, change=change: (change @ thrust(*at) - thrust(*at))[None],
            lambda _, clause=clause: clause,
            is_known=True,
        )


def _factor(values: Float[np.ndarray, " column"]) -> str:
    return f"{1 + 2 * values[0]:.2g}"


def _angle(values: Float[np.ndarray, " column"]) -> float:
    return float(np.degrees(np.arctan2(2 * values[1], 1 + 2 * values[0])))


def _in_time(model: Any, thrust: Any, rate: float) -> Columns:
    r"""Change of the forces where times of the file are `rate` times the true ones.

    With $t' = k t$ the equation $\ddot x = P(t) - \gamma \dot x + F$ has $P(t'/k)/k^2$
    and $\gamma/k$; without inertia the propulsion is $P(t'/k)/k$. The field is learned,
    whatever its factor.
    """
    has_inertia = isinstance(model, Swimmer)
    scale = rate**2 if has_inertia else rate

    def forces(t: Scalar, x: Vector, v: Vector) -> Float[Array, "column dim"]:
        change = thrust(t / rate, x, v) / scale - thrust(t, x, v)
        if has_inertia:
            change = change + (1 / rate - 1) * model.drag(t, x, v)
        return change[None]

    return forces


def _in_course(
    model: Any, dim: int, begin: float, end: float, force: float
) -> Iterator[Departure]:
    """Pushes and fields that change in the course of the data."""
    knots = np.linspace(begin, end, KNOTS)

    def pushes(t: Scalar, _x: Vector, _v: Vector) -> Float[Array, "column dim"]:
        # A constant push is a force of the environment, so that one hat is left out.
        hats = jnp.maximum(0.0, 1.0 - jnp.abs(t - knots[1:]) / (knots[1] - knots[0]))
        return BROAD * force * jnp.kron(hats[:, None], jnp.eye(dim))

    def fading(t: Scalar, x: Vector, _v: Vector) -> Float[Array, "column dim"]:
        course = (t - begin) / (end - begin) - 0.5
        return BROAD * course * model.environment(t, x, jnp.zeros_like(x))[None]

    yield Departure("push", pushes, lambda _: "a push that is not stated changes")
    yield Departure("course", fading, lambda _: "the field changes with time")


def weigh_departures(
    model: Any,
    states: Float[np.ndarray, "trajectory time state"],
    trajectories: Trajectories,
    *,
    noise: float | None = None,
) -> list[Contradiction]:
    """The likeliest departure of each name.

    Args:
        model: fitted, with kernels that do not change.
        states: smoothed, of the fit.
        trajectories: of the fit, with the channels of the states.
        noise: standard deviation of the observations, where it is known.
    """
    with jax.enable_x64(new_val=True):
        return _weigh(model, states, trajectories, noise)


def _weigh(
    model: Any,
    states: Float[np.ndarray, "trajectory time state"],
    trajectories: Trajectories,
    noise: float | None,
) -> list[Contradiction]:
    dim = trajectories.dim
    chosen = POLICY.looked_at(len(states), dim)
    observations = jax.tree.map(
        lambda leaf: leaf[chosen], Observations.of(trajectories, jnp.float64)
    )
    path = jnp.asarray(states[chosen])
    response = force_response(model, path, observations, FixedStep(), dim)
    times = np.asarray(observations.times)
    size = float(np.sqrt(np.mean(response.forces**2)))
    tried = list(departures(model, dim, times, size))
    forces, counts = _along([one.forces for one in tried], times, path, dim)
    data = np.column_stack([response.residuals_of_none, response.change(forces)])
    weigher = _beside_kernels(model.environment, response, data, noise)
    stated = weigher.fit()
    alone = weigher.predictions(stated, len(path))
    best: dict[str, Contradiction] = {}
    for one, first, count in zip(tried, np.cumsum([1, *counts]), counts, strict=False):
        which = np.arange(first, first + count)
        if np.linalg.norm(data[:, which]) <= SEEN * np.linalg.norm(data[:, 0]):
            continue  # it changes nothing, as the delay of a constant thrust
        fit = weigher.fit(known=which) if one.is_known else weigher.fit(normal=which)
        gain = fit.log_evidence - stated.log_evidence
        if gain > 0.0:
            added = weigher.predictions(fit, len(path)) - alone
            explains = fit.noise <= POLICY.content * response.least_noise
            gain *= explains and _helps_most(added)
        if one.name not in best or gain > best[one.name].gain:
            best[one.name] = Contradiction(one.name, gain, one.clause(fit.values))
    return list(best.values())


def _helps_most(gains: Float[np.ndarray, " trajectory"]) -> bool:
    """True if trajectories gain, beyond two standard errors; of one nothing is asked.

    What repairs a fit in one place, as beside the edge of a field that no kernels
    follow, helps some trajectories and harms others.
    """
    if len(gains) < 2:
        return True
    return bool(gains.mean() > 2.0 * gains.std(ddof=1) / np.sqrt(len(gains)))


def _beside_kernels(
    force: AbstractForce,
    response: ForceResponse,
    data: Float[np.ndarray, "datum column"],
    noise: float | None,
) -> ColumnWeigher:
    """The evidence of columns beside kernels and a linear force, or terms, too."""
    terms, kernels = split_structure(force)
    free: Any = kernels
    rows = np.concatenate([columns(part, response) for part in parts_of(free)], axis=1)
    # A thrust that never turns acts as a uniform force of the environment would.
    places = np.asarray(response.points).reshape(-1, response.points.shape[-1])
    linear = linear_term(Region.of(places))
    beside = [
        np.concatenate([slopes(term, response) for term in some], axis=1)
        for some in ([linear], [linear, *terms])[: 2 if terms else 1]
    ]
    return ColumnWeigher.of(
        rows,
        data,
        beside,
        list(_priors(free.prior())),
        squares=response.squares,
        count=response.num_free,
        noise=noise,
    )


LENGTHS = (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
"""Logarithms of length scales, relative to those at which a search begins: of fields as
rough as those that follow the data under wrong physics, and as smooth as true ones."""


def _priors(prior: AbstractPrior) -> Iterator[Matrix]:
    least, most = prior.bounds[0]
    for start in prior.starts:
        for change in LENGTHS:
            shape = start.copy()
            shape[0] = np.clip(start[0] + change, least, most)
            yield prior.covariance(shape)


def _along(
    forces: Sequence[Columns],
    times: Float[np.ndarray, "trajectory time"],
    states: Float[Array, "trajectory time state"],
    dim: int,
) -> tuple[Float[np.ndarray, "trajectory group dim column"], list[int]]:
    """Columns at the points of a response, means over the steps of each group.

    Also the number of columns of each of the forces.
    """
    middles = (states[:, 1:] + states[:, :-1]) / 2
    when = jnp.asarray(times[:, 1:] + times[:, :-1]) / 2
    places, speeds = middles[..., :dim], middles[..., dim:]
    if not speeds.shape[-1]:
        speeds = jnp.diff(states, axis=1) / np.diff(times, axis=1)[..., None]

    def all_forces(t: Scalar, x: Vector, v: Vector) -> list[Array]:
        return [force(t, x, v) for force in forces]

    # One compiled function serves all of them.
    parts = jax.jit(jax.vmap(jax.vmap(all_forces)))(when, places, speeds)
    values = np.concatenate([np.asarray(part) for part in parts], axis=2)
    means = group_means(values.reshape(*when.shape, -1))
    means = means.reshape(*means.shape[:2], -1, dim)
    return np.moveaxis(means, 2, 3), [part.shape[2] for part in parts]
