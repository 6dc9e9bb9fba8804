"""Open-loop rollouts on the held-out part of a track: errors and bands."""

import math
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from pinav.dynamics import OverdampedSwimmer
from pinav.fitting import EvidenceFit
from pinav.identification.drive import AbstractDrive, drive_numbers, drive_of, gain_of
from pinav.identification.estimates import drift_of, entries
from pinav.identification.kalman import Disturbance, State, begin, predict, transitions
from pinav.identification.likelihood import disturbance_of
from pinav.identification.parameters import (
    DRIFT,
    GAIN,
    Coordinates,
    coordinates_of,
    fitted_coordinates,
)
from pinav.identification.tracks import Blocks, Track, commands_of, round_up_to
from pinav.recordings.drive import command_vector
from pinav.systems import FreeNumber
from pinav.trajectories import Trajectory

Vectors = Float[np.ndarray, "time 2"]
"""A vector at each sample of a segment."""

Displacement = Callable[[Trajectory], Vectors]
"""Predicted path of a segment, up to a constant [L]."""


LEAST_SIZE = 2048
"""Samples that are compiled for at least; for longer segments, twice as many and so
on, since a program takes longer to compile than to run on twice the samples."""


class DrivenSwimmer(eqx.Module):
    """A fitted swimmer, driven by the commands of segments.

    Attributes:
        numbers: coordinates of the parameters of its drive.
    """

    swimmer: OverdampedSwimmer
    drive: AbstractDrive
    numbers: Coordinates

    @classmethod
    def of(
        cls, swimmer: OverdampedSwimmer, learn: Sequence[FreeNumber] = ()
    ) -> "DrivenSwimmer":
        """A swimmer of which these numbers are open."""
        with jax.enable_x64(new_val=True):
            drive = drive_of(swimmer, learn)
        return cls(swimmer, drive, coordinates_of(drive.parameters, swimmer, {}))

    @property
    def gain(self) -> Float[np.ndarray, "2 2"]:
        """Matrix that makes lengths of displacements."""
        return np.asarray(self.drive.gain)

    def displacements(
        self, piece: Trajectory, numbers: Coordinates | None = None
    ) -> Vectors:
        """Displacements along a segment for a gain of 1, at these coordinates."""
        size = LEAST_SIZE
        while size < len(piece.times):
            size *= 2
        # What follows the last command reaches no sample.
        blocks = Blocks.of(Track("", (piece,), math.inf, (size, 1)))
        numbers = self.numbers if numbers is None else numbers
        with jax.enable_x64(new_val=True):
            along = _displacements(
                self.drive, jnp.asarray(numbers), jax.tree.map(jnp.asarray, blocks)
            )
        return np.asarray(along)[: len(piece.times)]

    def path(self, piece: Trajectory) -> Vectors:
        """Displacements along a segment by gain and drift [L]."""
        along = self.displacements(piece) @ self.gain.T
        elapsed = piece.times - piece.times[0]
        return along + np.outer(elapsed, drift_of(self.swimmer))


@eqx.filter_jit
def _displacements(drive: AbstractDrive, numbers: Array, blocks: Blocks) -> Array:
    return drive.displacements(numbers, blocks)


def integrate_held(velocity: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Way by a velocity that is held from each time to the next."""
    steps = velocity[:-1] * np.diff(times)[:, None]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def path_of(swimmer: OverdampedSwimmer) -> Displacement:
    """Displacements by gain and drift alone."""
    return DrivenSwimmer.of(swimmer).path


def cache_by_segment(displacement: Displacement) -> Displacement:
    """The same displacement, computed once for each segment that lives as long."""
    known: dict[int, Vectors] = {}

    def path(piece: Trajectory) -> Vectors:
        if id(piece) not in known:
            known[id(piece)] = displacement(piece)
        return known[id(piece)]

    return path


class FrameJitter(eqx.Module):
    """Scatter of single frames about the mean path, along and across the heading.

    Attributes:
        driven: variances along and across while rolling [L²].
        still: variance at rest, along any axis [L²].
    """

    driven: Float[np.ndarray, "2"]
    still: float

    @property
    def deviation(self) -> float:
        """Root mean square of both axes: the noise of a single position [L]."""
        return float(np.sqrt(self.driven.mean()))

    @classmethod
    def of(cls, track: Track, displacement: Displacement) -> "FrameJitter":
        """From what a model leaves, about its running mean over a block."""
        along, across, rest = [], [], []
        for piece in track.pieces:
            left = piece.states - displacement(piece)
            scatter = left - _running_mean(piece.times, left, track.width)
            frequency, heading = commands_of(piece)
            on = frequency > 0
            cosine, sine = np.cos(heading), np.sin(heading)
            along.append((scatter[:, 0] * cosine + scatter[:, 1] * sine)[on])
            across.append((scatter[:, 1] * cosine - scatter[:, 0] * sine)[on])
            rest.append(scatter[~on].ravel())
        scatters = [np.concatenate(parts) for parts in (along, across, rest)]
        variances = [float(np.mean(v**2)) if len(v) else 0.0 for v in scatters]
        driven = np.array(variances[:2])
        still = variances[2] if len(scatters[2]) else float(driven.min())
        return cls(driven if driven.any() else np.full(2, still), still)

    def variance(self, piece: Trajectory) -> Vectors:
        """Variance of each coordinate at each sample."""
        frequency, heading = commands_of(piece)
        squares = np.stack([np.cos(heading), np.sin(heading)], axis=1) ** 2
        along, across = self.driven
        rolling = along * squares + across * (1 - squares)
        return np.where(frequency[:, None] > 0, rolling, self.still)


def _running_mean(times: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(values, axis=0)])
    low = np.searchsorted(times, times - width / 2)
    high = np.searchsorted(times, times + width / 2, side="right")
    return (total[high] - total[low]) / (high - low)[:, None]


class Forecast(eqx.Module):
    """A predicted path through a segment [L], its slopes, and its uncertainty.

    Attributes:
        beyond: standard deviation of the displacement that another form of the
            response would add above the frequencies that were fitted [L].
        frame: variance of a single frame about the mean path [L²].
        turned: integral of the response along the heading, x + iy [cycles].
    """

    piece: Trajectory
    path: Vectors
    slopes: Float[np.ndarray, "time 2 unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    beyond: Vectors
    frame: Vectors
    disturbance: Disturbance
    turned: Complex[np.ndarray, " time"]

    def rollout(self, first: int, last: int) -> Float[np.ndarray, "sample 2"]:
        """Positions from the observed one at sample `first` on [L]."""
        path = self.path[first : last + 1]
        return self.piece.states[first] + path - path[0]

    def variance(self, first: int, last: int) -> Float[np.ndarray, "sample 2"]:
        """Variance: disturbance, unknowns, response, jitter at both ends [L²]."""
        samples = slice(first, last + 1)
        # A rollout begins at an observed position: what the parameters moved before it
        # cancels.
        slopes = self.slopes[samples] - self.slopes[first]
        unknown = np.einsum("tap,pq,taq->ta", slopes, self.covariance, slopes)
        response = (self.beyond[samples] - self.beyond[first]) ** 2
        frame = self.frame[samples]
        wandering = self._wandering(samples)[:, None]
        # The first frame errs, too, as the rollout begins there.
        return wandering + unknown + response + frame + frame[:1]

    def _wandering(self, samples: slice) -> Float[np.ndarray, " sample"]:
        """Variance by the disturbance from a start without knowledge of it [L²]."""
        frequency, _ = commands_of(self.piece)
        intervals = np.diff(self.piece.times[samples])
        more = (0, round_up_to(len(intervals), LEAST_SIZE) - len(intervals))
        with jax.enable_x64(new_val=True):
            variances = _wandering_variances(
                jnp.asarray(np.pad(intervals, more, constant_values=1.0)),
                jnp.asarray(np.pad(frequency[samples][:-1], more)),
                jnp.asarray(np.pad(np.diff(self.turned[samples]), more)),
                self.disturbance,
            )
        return np.concatenate([[0.0], np.asarray(variances)[: len(intervals)]])


@eqx.filter_jit
def _wandering_variances(
    intervals: Array, frequency: Array, turned: Array, disturbance: Disturbance
) -> Array:
    """Variance of the way after each interval, velocities and gain unknown at first."""
    strength = disturbance.wandering.strength(frequency)
    steps = transitions(intervals, strength, disturbance, turned)

    def step(state: State, inputs: tuple[Array, Array]) -> tuple[State, Array]:
        state = predict(state, *inputs)
        return state, state[1][0, 0].real

    # The position is where the rollout begins, the velocities are stationary.
    start = begin(jnp.zeros(1, turned.dtype), jnp.zeros(()))
    return jax.lax.scan(step, start, (steps.matrix, steps.noise))[1]


class Predictor(eqx.Module):
    """A fitted swimmer, and all else from the training part that its bands need.

    Attributes:
        wandering: the same swimmer fitted beside a gain that wanders, where the
            evidence prefers that; bands are those of this fit about the path of the
            constant gain.
    """

    fit: EvidenceFit
    jitter: FrameJitter
    fastest: float
    wandering: EvidenceFit | None = None

    @classmethod
    def of(
        cls, track: Track, fit: EvidenceFit, wandering: EvidenceFit | None = None
    ) -> "Predictor":
        """The predictor of a fit, by the track that was fitted."""
        jitter = FrameJitter.of(track, path_of(fit.model))
        fastest = max(float(np.max(commands_of(piece)[0])) for piece in track.pieces)
        return cls(fit, jitter, fastest, wandering)

    def forecast(self, piece: Trajectory) -> Forecast:
        """The forecast of a segment, computed once for all of its rollouts."""
        driven = DrivenSwimmer.of(self.fit.model, drive_numbers(self.fit))
        slopes, covariance = self._slopes(piece, driven)
        known = self.wandering or self.fit
        return Forecast(
            piece=piece,
            path=driven.path(piece),
            slopes=slopes,
            covariance=covariance,
            beyond=self._beyond(piece),
            frame=self.jitter.variance(piece),
            disturbance=disturbance_of(jnp.asarray(fitted_coordinates(known))),
            turned=driven.displacements(piece) @ np.array([1.0, 1.0j]),
        )

    def _slopes(
        self, piece: Trajectory, driven: DrivenSwimmer
    ) -> tuple[np.ndarray, np.ndarray]:
        """Slopes of a displacement by each unknown, and the covariance of these."""
        known, turned = self.wandering or self.fit, driven.displacements(piece)
        learned = {name.partition("[")[0] for name in known.constants}
        numbers, columns = driven.numbers, {}
        for place, parameter in enumerate(driven.drive.parameters):
            if parameter.path in learned:
                # A forward difference is enough: a band needs its slope to per milles.
                step = STEP * (1.0 if parameter.prior is None else parameter.prior[1])
                moved = numbers + step * (np.arange(len(numbers)) == place)
                slope = (driven.displacements(piece, moved) - turned) / step
                slope = slope @ driven.gain.T
                slope = slope / parameter.scale.slope(numbers[place])
                columns[parameter.path] = slope[:, :, None]
        basis = np.asarray(driven.drive.basis)
        basis = basis[np.any(basis, axis=(1, 2))]
        if GAIN in learned and len(basis):
            columns[GAIN] = np.einsum("gab,tb->tag", basis, turned)
        if DRIFT in learned:
            elapsed = piece.times - piece.times[0]
            columns[DRIFT] = np.einsum("ga,t->tag", np.eye(2), elapsed)
        places = np.concatenate([entries(known, path) for path in columns])
        covariance = known.posterior.covariance[np.ix_(places, places)]
        return np.concatenate([*columns.values()], axis=2), covariance

    def _beyond(self, piece: Trajectory) -> Vectors:
        """Displacement by the excess of the frequency over all that was fitted [L].

        None where the swimmer does not roll: nothing is known of its slope at rest.
        """
        gain = gain_of(self.fit.model)
        if gain is None:
            return np.zeros_like(piece.states)
        frequency, heading = commands_of(piece)
        # Beyond the fastest command of the fit the response is extrapolated.
        excess = np.maximum(frequency - self.fastest, 0.0)
        along = integrate_held(command_vector(excess, heading), piece.times)
        return DISCREPANCY * along @ gain.T


STEP = 1e-3
"""Difference of a coordinate by which slopes of a path are taken."""

DISCREPANCY = 0.25
"""Standard deviation of the slope of the response above the fitted frequencies, in
slopes at rest: between none and the whole of it, all are seen. Chosen on five sessions
and half of the other recordings, judged on the rest (docs/identification.md)."""
