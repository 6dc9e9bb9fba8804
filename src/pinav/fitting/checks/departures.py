r"""Departures from the physics that a system states, weighed by the evidence.

The force of the environment is learned beside forces that are known. Where these are
wrong, kernels follow the trajectories all the same, with a rougher field: the residuals
may look like noise, but the evidence is hundreds of nats below that of the right
physics. Here the data, linearised about the fit (`ForceResponse`), are asked whether
another force beside kernels explains them better: a share of the propulsion or of the
drag, the propulsion at another time or with its axes mirrored, a push that changes with
time, a field that changes. The kernels are as free as in the fit, and where it has
terms these stand beside them; the best of both counts on either side.
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
from pinav.fitting.checks.column_evidence import (
    ColumnFit,
    Hypothesis,
    best_column_fit,
    column_products,
    seen_directions,
)
from pinav.fitting.matching.state import Observations
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.response import (
    ForceResponse,
    columns,
    force_response,
    group_means,
    slopes,
)
from pinav.forces import AbstractForce, ZeroForce, split_structure
from pinav.forces.kernel_mixtures import AbstractKernelSum
from pinav.forces.priors import AbstractPrior, Matrix
from pinav.trajectories import Trajectories

Columns = Callable[[Scalar, Vector, Vector], Float[Array, "column dim"]]
"""Forces [L T⁻²] by time, place and velocity."""


class Departure(eqx.Module):
    """Another force than the stated one.

    Attributes:
        name: of what departs, as a table of a fit prints it.
        forces: its columns, in units of the range in which a coefficient lies.
        is_known: the force is the column itself; otherwise each column has a
            coefficient with a flat prior.
        says: a clause on it, by the coefficients.
    """

    name: str = eqx.field(static=True)
    forces: Columns = eqx.field(static=True)
    is_known: bool = eqx.field(static=True)
    says: Callable[[Float[np.ndarray, " column"]], str] = eqx.field(static=True)


class Contradiction(eqx.Module):
    """What the evidence says of a departure.

    Attributes:
        gain: log evidence over the stated physics [nats].
        clause: what it would be, such as "the thrust is 0.5 times the stated one".
    """

    name: str
    gain: float
    clause: str


DELAYS = (-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0)
"""Delays of commands that are tried, in intervals of the samples."""

RATES = (0.5, 0.67, 0.8, 0.9, 1.1, 1.25, 1.5, 2.0)
"""Units of time that are tried, in that of the file."""

SPLINES = 8
"""Knots in time of a push that changes."""

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


def departures(
    model: Any, dim: int, times: Float[np.ndarray, "trajectory time"], force: float
) -> Iterator[Departure]:
    """Departures that the model of a swimmer may have.

    Args:
        times: of the samples; NaN beyond the end.
        force: root mean square of the learned force along the data [L T⁻²].
    """
    interval = float(np.nanmedian(np.diff(times, axis=1)))
    begin, end = float(np.nanmin(times)), float(np.nanmax(times))
    has_inertia = isinstance(model, Swimmer)

    def thrust(t: Scalar, x: Vector, v: Vector) -> Vector:
        return model.propulsion(t, x, v if has_inertia else jnp.zeros_like(x))

    if not isinstance(model.propulsion, ZeroForce):
        yield from _of_thrust(thrust, dim, interval)
    if has_inertia:
        yield Departure(
            "drag",
            lambda t, x, v: 2 * model.drag(t, x, v)[None],
            False,
            lambda c: f"the drag is {1 + 2 * c[0]:.2g} times the stated one",
        )
        yield Departure(
            "drag that grows with the speed",
            lambda t, x, v: -force * (jnp.linalg.norm(v) * v)[None],
            False,
            lambda c: "the drag grows with the speed",
        )
    if has_inertia or not isinstance(model.propulsion, ZeroForce):
        for rate in RATES:
            yield Departure(
                "unit of time",
                _in_time(model, thrust, rate),
                True,
                lambda _, rate=rate: f"times are {rate:.2g} times the true ones",
            )
    knots = jnp.linspace(begin, end, SPLINES)

    def pushes(t: Scalar, x: Vector, v: Vector) -> Float[Array, "column dim"]:
        # A constant push is a force of the environment.
        hats = jnp.maximum(0.0, 1.0 - jnp.abs(t - knots) / (knots[1] - knots[0]))[1:]
        return 4 * force * jnp.kron(hats[:, None], jnp.eye(dim))

    yield Departure("push in time", pushes, False, lambda _: "a push changes with time")

    def fading(t: Scalar, x: Vector, v: Vector) -> Float[Array, "column dim"]:
        share = (t - begin) / (end - begin) - 0.5
        return 4 * share * model.environment(t, x, jnp.zeros_like(x))[None]

    yield Departure(
        "field in time", fading, False, lambda _: "the field changes with time"
    )


def _of_thrust(thrust: Any, dim: int, interval: float) -> Iterator[Departure]:
    yield Departure(
        "thrust",
        lambda t, x, v: 2 * thrust(t, x, v)[None],
        False,
        lambda c: f"the thrust is {1 + 2 * c[0]:.2g} times the stated one",
    )
    if dim == 2:
        yield Departure(
            "heading",
            lambda t, x, v: 2 * jnp.stack([thrust(t, x, v), TURN @ thrust(t, x, v)]),
            False,
            lambda c: (
                "the thrust is turned by "
                f"{np.degrees(np.arctan2(2 * c[1], 1 + 2 * c[0])):.0f} degrees"
            ),
        )
        for name, matrix in AXES.items():
            yield Departure(
                name,
                lambda t, x, v, m=matrix: ((m - np.eye(2)) @ thrust(t, x, v))[None],
                True,
                lambda _, name=name: name,
            )
    for delay in DELAYS:
        late = delay * interval
        yield Departure(
            "delay",
            lambda t, x, v, d=late: (thrust(t - d, x, v) - thrust(t, x, v))[None],
            True,
            lambda _, d=late: f"commands act {d:.2g} later than stated",
        )


AXES = {
    "the thrust has its y axis mirrored": np.diag([1.0, -1.0]),
    "the thrust has its x axis mirrored": np.diag([-1.0, 1.0]),
    "the thrust has x and y exchanged": np.array([[0.0, 1.0], [1.0, 0.0]]),
    "the thrust has the opposite direction": -np.eye(2),
}
"""Changes of the axes of a planar thrust."""


def _in_time(model: Any, thrust: Any, rate: float) -> Columns:
    r"""Forces where times of the file are `rate` times the true ones.

    With $t' = k t$ the equation $\ddot x = P(t) - \gamma \dot x + F$ has $P(t'/k)/k^2$
    and $\gamma/k$; without inertia the propulsion counts 1/k.
    """
    order = 2 if isinstance(model, Swimmer) else 1

    def forces(t: Scalar, x: Vector, v: Vector) -> Float[Array, "column dim"]:
        change = thrust(t / rate, x, v) / rate**order - thrust(t, x, v)
        if order == 2:
            change = change + (1 / rate - 1) * model.drag(t, x, v)
        return change[None]

    return forces


def weigh_departures(
    model: Any,
    states: Float[np.ndarray, "trajectory time state"],
    trajectories: Trajectories,
    *,
    noise: float | None = None,
    solver: FixedStep | None = None,
) -> tuple[Contradiction, ...]:
    """Evidence of each departure over the stated physics, the largest first.

    Args:
        model: fitted, with kernels that do not change.
        states: smoothed, of the fit.
        trajectories: of the fit, with the channels of the states.
    """
    dim = trajectories.dim
    most = POLICY.trajectories[dim == 3]
    chosen = slice(None, None, -(-len(states) // most))
    states, times = states[chosen], np.asarray(trajectories.times)[chosen]
    observations = Observations.of(trajectories, jnp.float64)
    response = force_response(
        model,
        jnp.asarray(states),
        jax.tree.map(lambda leaf: leaf[chosen], observations),
        FixedStep() if solver is None else solver,
        dim,
    )
    size = float(np.sqrt(np.mean(response.forces**2)))
    tried = list(departures(model, dim, times, size))
    # One compiled function of all of them.
    forces, counts = _along([one.forces for one in tried], times, states, dim)
    data = np.column_stack([response.residuals_of_none, response.change(forces)])
    widths = np.cumsum([1, *counts])
    weigh = _Weigher.of(model.environment, response, data, noise)
    stated = weigh(np.zeros(0, int), np.zeros(0, int))
    gains = []
    for one, first, last in zip(tried, widths[:-1], widths[1:], strict=True):
        which = np.arange(first, last)
        none = np.zeros(0, int)
        best = weigh(which, none) if one.is_known else weigh(none, which)
        gain = best.log_evidence - stated.log_evidence
        gains.append(Contradiction(one.name, gain, one.says(best.values)))
    return tuple(sorted(gains, key=lambda one: -one.gain))


class _Weigher(eqx.Module):
    """The evidence of columns beside kernels, with the terms of a fit or without."""

    products: list
    counts: list
    num_columns: int
    squares: float
    noise: float | None

    @classmethod
    def of(cls, force: AbstractForce, response: ForceResponse, data: Any, noise: Any):
        terms, kernels = split_structure(force)
        is_sum = isinstance(kernels, AbstractKernelSum)
        parts: Any = kernels.parts if is_sum else (kernels,)
        rows = np.concatenate([columns(part, response) for part in parts], axis=1)
        priors = list(_priors(kernels.prior()))
        beside = [np.zeros((len(rows), 0))]
        if terms:
            both = [slopes(term, response) for term in terms]
            beside.append(seen_directions(np.concatenate(both, axis=1)))
        products, counts = [], []
        for flat in beside:
            left = data - flat @ (flat.T @ data)
            reached = rows - flat @ (flat.T @ rows)
            products.append(column_products(reached, left, priors))
            counts.append(response.num_free - flat.shape[1])
        return cls(products, counts, data.shape[1], response.squares, noise)

    def __call__(self, known: Any, flat: Any) -> ColumnFit:
        coefficients = np.zeros(self.num_columns)
        coefficients[0] = 1.0
        coefficients[known] = 1.0
        fits = [
            best_column_fit(
                products,
                Hypothesis(coefficients, flat),
                squares=self.squares,
                count=count,
                noise=self.noise,
            )
            for products, count in zip(self.products, self.counts, strict=True)
        ]
        return max(fits, key=lambda fit: fit.log_evidence)


LENGTHS = (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
"""Logarithms of length scales, relative to those at which a search begins."""


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
    states: Float[np.ndarray, "trajectory time state"],
    dim: int,
) -> tuple[Float[np.ndarray, "trajectory group dim column"], list[int]]:
    """Columns at the points of a response, means over the steps of each group.

    Also the number of columns of each of the forces.
    """
    middles = (states[:, 1:] + states[:, :-1]) / 2
    when = (times[:, 1:] + times[:, :-1]) / 2
    places, speeds = middles[..., :dim], middles[..., dim:]
    if not speeds.shape[-1]:
        speeds = np.diff(states, axis=1) / np.diff(times, axis=1)[..., None]

    def all_forces(t: Scalar, x: Vector, v: Vector) -> list[Array]:
        return [force(t, x, v) for force in forces]

    inputs = (jnp.asarray(one) for one in (when, places, speeds))
    parts = jax.jit(jax.vmap(jax.vmap(all_forces)))(*inputs)
    values = np.concatenate([np.asarray(part) for part in parts], axis=2)
    flat = group_means(values.reshape(*when.shape, -1))
    columns = np.moveaxis(flat.reshape(*flat.shape[:2], -1, dim), 2, 3)
    return columns, [part.shape[2] for part in parts]
