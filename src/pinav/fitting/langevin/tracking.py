r"""A frame of reference that drifts slowly, and a Newton step of its path.

The likelihood depends on the path w through $h = x_i - w(t)$ alone. Its slopes by h are
those by log D and by the mean, times $\partial\log D/\partial h$ and
$\partial(v\tau)/\partial h$; the information likewise. Between knots w is linear, and
the evidence chooses amplitude and time of its prior, a process of Ornstein and
Uhlenbeck.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.errors import InputError
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.langevin.drift import divergence
from pinav.fitting.langevin.increments import Increments
from pinav.fitting.langevin.likelihood import local_terms
from pinav.fitting.langevin.rounds import RoundResult, fluctuations
from pinav.forces import KernelTensor
from pinav.forces.priors import StationaryPrior
from pinav.trajectories import Trajectories


class SlowReference(eqx.Module):
    r"""A coordinate whose zero drifts: fields depend on $x_i - w(t)$.

    w is linear between knots at equal times, its mean zero: that is a gauge, for the
    fields are learned with it.

    Attributes:
        knots: number of them, over all the time of the data.
        scale: standard deviation of w [L]; chosen by the evidence unless given.
        start: w at the knots where the fit begins [L]; at rest unless given.

    Raises:
        InputError: there are fewer than two knots, `scale` is not positive, or `start`
            has not a value for each knot.
    """

    axis: int = eqx.field(static=True)
    knots: int = eqx.field(static=True, default=46)
    scale: float | None = None
    start: tuple[float, ...] | None = eqx.field(
        static=True,
        default=None,
        converter=lambda start: None if start is None else tuple(map(float, start)),
    )

    def __check_init__(self) -> None:
        if self.knots < 2 or not (self.scale is None or self.scale > 0):
            raise InputError(
                "SlowReference: expected two or more knots and a scale > 0, got "
                f"{self.knots} and {self.scale}"
            )
        if self.start is not None and len(self.start) != self.knots:
            raise InputError(
                f"SlowReference.start: expected {self.knots} values, one for each "
                f"knot, got {len(self.start)}"
            )


RELAXATIONS, MOST_KNOTS = 5, 200
"""Times of relaxation from one knot to the next, and knots at most."""


def slow_reference(trajectories: Trajectories, axis: int) -> SlowReference:
    r"""A reference with a knot every five relaxation times of a coordinate.

    Within that time $2\tau\,\mathrm{var}(x)/\langle\Delta x^2\rangle$ the motion
    itself goes from one end of the data to the other, and cannot be told from a drift.

    Args:
        trajectories: their channels are the positions, their times those of one clock.

    Raises:
        InputError: there are no increments, or the coordinate never changes.
    """
    increments = Increments.of(trajectories)
    places, steps = increments.positions[:, axis], increments.steps[:, axis]
    change = float(np.mean(steps**2))
    if not change > 0:
        raise InputError(
            f"slow_reference axis {axis}: expected a coordinate that changes, got "
            f"{places[0]:g} throughout"
        )
    interval = float(np.median(increments.intervals))
    relaxation = 2 * interval * float(places.var()) / change
    ends = increments.times + increments.intervals
    duration = float(ends.max() - increments.times.min())
    knots = round(duration / (RELAXATIONS * relaxation))
    return SlowReference(axis, knots=min(max(knots, 2), MOST_KNOTS))


class ReferencePath(eqx.Module):
    """The path of a frame of reference.

    Attributes:
        times: of the knots [T].
        values: there [L], of mean zero.
    """

    axis: int = eqx.field(static=True)
    times: Float[np.ndarray, " knot"]
    values: Float[np.ndarray, " knot"]
    covariance: Float[np.ndarray, "knot knot"]

    def __call__(self, times: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """Where the reference is at given times [L]."""
        return np.interp(times, self.times, self.values)

    @property
    def sd(self) -> Float[np.ndarray, " knot"]:
        """Standard deviation at each knot [L]."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


LOG_TIME = float(np.log(3.0))
"""Logarithm of the correlation time, in knots, where the scale of the path is given."""


def first_path(reference: SlowReference, increments: Increments) -> ReferencePath:
    """Where the path of a reference begins, its knots over all the time of the data."""
    ends = increments.times + increments.intervals
    knots = np.linspace(increments.times.min(), ends.max(), reference.knots)
    count = reference.knots
    values = np.zeros(count) if reference.start is None else np.array(reference.start)
    return ReferencePath(
        reference.axis, knots, values - values.mean(), np.zeros((count, count))
    )


def from_reference(increments: Increments, path: ReferencePath) -> Increments:
    """Increments as recorded, but with positions that are counted from the path."""
    positions = increments.positions.copy()
    positions[:, path.axis] -= path(increments.times)
    return dataclasses.replace(increments, positions=positions)


def track_reference(
    belief: RoundResult,
    recorded: Increments,
    reference: SlowReference,
    path: ReferencePath,
) -> tuple[RoundResult, ReferencePath]:
    """The path after one step, and the belief about it that follows.

    The belief has positions from the path before, `recorded` those of the data.
    """
    slope, information = _by_height(belief, reference.axis)
    columns = _hats(path.times, recorded.times)
    quadratic = Quadratic(
        point=path.values,
        hessian=columns.T @ (columns * information[:, None]),
        gradient=columns.T @ slope,
        squares=0.0,
        num_free=len(slope),
        log_determinant=0.0,
    )
    weights = GaussianWeights(StationaryPrior(np.arange(float(len(path.times))), 1.0))
    if reference.scale is None:
        inference = weights.infer(quadratic, weights.start, 1.0)
        values, covariance = inference.mean, inference.covariance
    else:
        chosen = Hyperparameters(np.array([LOG_TIME]), reference.scale, 1.0, 0.0)
        values, covariance = weights.posterior(quadratic, chosen)
    moved = ReferencePath(
        reference.axis, path.times, values - values.mean(), covariance
    )
    there = eqx.tree_at(lambda b: b.increments, belief, from_reference(recorded, moved))
    return there.follow(belief.swimmer, there.determined), moved


def _by_height(belief: RoundResult, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Slope of the log likelihood by the coordinate of each increment; information."""
    motion, increments = belief.motion, belief.increments
    positions = jnp.asarray(increments.positions)
    data = fluctuations(belief)
    by_logs, by_drift = _slopes(
        belief.swimmer,
        motion.diffusion,
        jnp.asarray(increments.times),
        positions,
        axis,
        einstein=belief.relation.einstein,
    )
    by_means = np.asarray(by_drift) * increments.intervals[:, None]
    spread = 2 * belief.local_diffusion * increments.intervals[:, None]
    slope = np.zeros(len(positions))
    information = (by_means**2 / spread).sum(axis=1)
    for group, axes in enumerate(motion.diffusion.groups):
        terms = local_terms(motion, group, axes, data)
        by_log = np.asarray(by_logs)[:, group]
        slope += np.asarray(terms.by_log) * by_log
        slope += (np.asarray(terms.pulled) * by_means[:, list(axes)]).sum(axis=1)
        information += np.asarray(terms.information)[:, 0] * by_log**2
    return slope, information


@eqx.filter_jit
def _slopes(
    swimmer: Any,
    tensor: KernelTensor,
    times: Float[Array, " increment"],
    positions: Float[Array, "increment dim"],
    axis: int,
    *,
    einstein: bool,
) -> tuple[Float[Array, "increment group"], Float[Array, "increment dim"]]:
    """Derivatives of log D and of the drift by one coordinate."""
    unit = jnp.eye(positions.shape[1], dtype=positions.dtype)[axis]

    def at(time: Array, x: Array) -> tuple[Array, Array]:
        def drift(x: Array) -> Array:
            known = swimmer(time, x)
            return known + divergence(tensor, x) if einstein else known

        return (
            jax.jvp(tensor.logarithms, (x,), (unit,))[1],
            jax.jvp(drift, (x,), (unit,))[1],
        )

    return jax.vmap(at)(times, positions)


def _hats(
    knots: Float[np.ndarray, " knot"], times: Float[np.ndarray, " time"]
) -> Float[np.ndarray, "time knot"]:
    """Weight of each knot at given times."""
    place = (times - knots[0]) / (knots[1] - knots[0])
    return np.maximum(1 - np.abs(place[:, None] - np.arange(len(knots))), 0.0)
