"""Displacements between samples, and their observation by a camera."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.arguments import check_positive
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.fitting.engine.posterior import Estimate
from pinav.forces import KernelTensor
from pinav.trajectories import Trajectories


class LearnedObservation(eqx.Module):
    r"""An observation whose exposure and error are learned, with weak priors.

    The exposure is a share of the median interval whose log odds are normal about zero;
    the variance of the error, relative to $D\tau$ of that interval, is log-normal about
    `error`. Where D is the same everywhere and the intervals are equal, the two trade
    off, and only their effect $\tfrac13 D T - \sigma^2$ on neighbours is known; D is
    not touched by that.

    Attributes:
        spread: standard deviation of the log odds of the exposure.
        error: median of $\sigma^2 / D\tau$.
        error_spread: standard deviation of its logarithm.

    Raises:
        InputError: a number is not positive.
    """

    spread: float = 1.5
    error: float = 0.05
    error_spread: float = 2.0

    def __check_init__(self) -> None:
        check_positive(self, "spread", "error", "error_spread")


class ObservedAxes(eqx.Module):
    """What a fit says of the observation of some axes.

    Attributes:
        exposure: T [T].
        error: standard deviation of the error [L].
        interval: the median interval [T], beyond which no exposure lasts.
    """

    axes: tuple[int, ...] = eqx.field(static=True)
    exposure: Estimate
    error: Estimate
    interval: float


class Relation(eqx.Module):
    """How drift and diffusion hang together, and what of them is known.

    Attributes:
        thermal_energy: $k_BT$ of Einstein's relation; None for a free drift.
    """

    thermal_energy: float | None
    learn_diffusion: bool
    observation: LearnedObservation | None

    @property
    def einstein(self) -> bool:
        r"""Whether the drift is $\beta D F + \nabla\cdot D$."""
        return self.thermal_energy is not None

    def swimmer_in(
        self, swimmer: OverdampedSwimmer, diffusion: KernelTensor
    ) -> OverdampedSwimmer:
        """The swimmer with the mobility that belongs to the diffusion."""
        if self.thermal_energy is None:
            return swimmer
        mobility = diffusion.scale_by(1 / self.thermal_energy)
        return eqx.tree_at(
            lambda m: m.mobility,
            swimmer,
            mobility,
            is_leaf=lambda leaf: leaf is swimmer.mobility,
        )


class Increments(eqx.Module):
    r"""Displacements between observed samples that follow one another.

    Attributes:
        times: at the start of each [T].
        positions: there [L].
        steps: displacement [L].
        intervals: duration [T].
    """

    times: Float[np.ndarray, " increment"]
    positions: Float[np.ndarray, "increment dim"]
    steps: Float[np.ndarray, "increment dim"]
    intervals: Float[np.ndarray, " increment"]
    counts: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, trajectories: Trajectories) -> "Increments":
        """All increments; one spans the gap where samples are missing."""
        parts = []
        for piece in trajectories:
            is_observed = np.flatnonzero(piece.observed.all(axis=1))
            times, positions = piece.times[is_observed], piece.states[is_observed]
            row = times[:-1], positions[:-1], np.diff(positions, axis=0), np.diff(times)
            parts.append(row)
        times, positions, steps, intervals = map(
            np.concatenate, zip(*parts, strict=True)
        )
        if not len(times):
            raise InputError(
                "fit_langevin trajectories: expected two or more samples with all "
                "positions observed in one of them, got none"
            )
        counts = tuple(len(part[0]) for part in parts)
        return cls(times, positions, steps, intervals, counts)

    @property
    def log_determinant(self) -> float:
        r"""$\log\det$ of the change from residuals to displacements."""
        return float(np.log(self.intervals).sum() * self.steps.shape[1])

    def wrap(self, periods: dict[int, float]) -> "Increments":
        """The increments with those of periodic coordinates the shortest way round."""
        steps = self.steps.copy()
        for axis, period in periods.items():
            # The shortest way round, which is right while a step is below half a
            # period.
            steps[:, axis] -= period * np.round(steps[:, axis] / period)
        return dataclasses.replace(self, steps=steps)

    def __call__(self, model: OverdampedSwimmer) -> Float[Array, " residual"]:
        r"""Residuals $(\text{drift}\,\Delta t - \Delta x) / \sqrt{\Delta t}$ ."""
        # Increments over the root of their interval have one variance, whatever the
        # interval.
        root = jnp.sqrt(jnp.asarray(self.intervals))[:, None]
        drift = jax.vmap(model)(jnp.asarray(self.times), jnp.asarray(self.positions))
        return (drift * root - jnp.asarray(self.steps) / root).reshape(-1)

    def in_time(
        self, residuals: Float[np.ndarray, " residual"]
    ) -> list[Float[np.ndarray, "_ channel"]]:
        """Residuals of each trajectory in the order of time."""
        rows = residuals.reshape(len(self.times), -1)
        return np.split(rows, np.cumsum(self.counts)[:-1])


class Padding(eqx.Module):
    """Increments of all tracks side by side, time first, and back.

    Attributes:
        sources: the increment that stands at each place.
        mask: one where there is an increment, else zero.
        places: where each increment stands.
    """

    sources: Int[Array, "time track"]
    mask: Float[Array, "time track"]
    places: Int[Array, " increment"]

    @classmethod
    def of(cls, counts: tuple[int, ...]) -> "Padding":
        """The layout of tracks with so many increments each."""
        lengths = np.array([count for count in counts if count])
        starts = np.cumsum(lengths) - lengths
        time = np.arange(lengths.max())[:, None]
        inside = time < lengths[None]
        # Padding repeats a real increment: what is computed there stays finite.
        sources = np.where(inside, starts[None] + time, 0)
        tracks = np.repeat(np.arange(len(lengths)), lengths)
        within = np.concatenate([np.arange(length) for length in lengths])
        return cls(
            jnp.asarray(sources),
            jnp.asarray(inside.astype(float)),
            jnp.asarray(within * len(lengths) + tracks),
        )

    def pad(
        self, values: Float[Array, " increment *rest"]
    ) -> Float[Array, "time track *rest"]:
        """Values of increments at their places; those of padding are of no meaning."""
        return values[self.sources]

    def flatten(
        self, values: Float[Array, "time track *rest"]
    ) -> Float[Array, " increment *rest"]:
        """Values at places, in the order of the increments."""
        shape = values.shape[0] * values.shape[1], *values.shape[2:]
        return values.reshape(shape)[self.places]
