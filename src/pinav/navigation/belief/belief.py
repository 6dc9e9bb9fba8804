"""Belief on a swimmer and its surroundings, and its change by a frame."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.navigation.belief.kernel_filter import KernelFilter, WeightPosterior
from pinav.navigation.belief.kernels import (
    FreeKernels,
    KernelGrid,
    Points,
    PotentialKernels,
)
from pinav.navigation.belief.motion import AbstractMotion, Square, Vector, substeps

KINDS: tuple[type[PotentialKernels | FreeKernels], ...] = (
    PotentialKernels,
    FreeKernels,
)
"""Kinds of force that are compared."""

SCALES = (18.0, 12.0, 8.0, 5.0)
"""The arena's longer side over the length scales that are compared."""

STRENGTH = 0.7
"""Standard deviation of each component of the force, of the greatest thrust."""

MARGIN = 1.0
"""Nats by which the evidence of another filter must be better to lead."""

SETTLE_EVERY = 8
"""Frames after which the factors of a filter are subtracted."""

MEMORY = 32_000_000
"""Memory of a bank above which its least probable filter is given up [byte]."""

NEGLIGIBLE = 0.05
"""Probability, over the greatest, of a filter that predictions do without."""

CLOCK = 1e-9
"""Times that are nearer than this are one [T]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """The content of a frame.

    Attributes:
        time: when it was taken [T].
        position: [L]; None where the tracker has lost the swimmer.
        sd: standard deviation of each coordinate [L].
        thrust: mean known acceleration since the last frame [L T⁻²], or velocity
            [L T⁻¹] where there is no inertia. Commands act late: it is what was in
            force, not what was commanded.
    """

    time: float
    position: Vector | None
    sd: float
    thrust: Vector


@dataclasses.dataclass(frozen=True, eq=False)
class StateEstimate:
    """Mean and covariance of the state: position and, with inertia, velocity."""

    mean: Float[np.ndarray, " state"]
    covariance: Square


@dataclasses.dataclass(frozen=True, eq=False)
class Belief:
    """State and force, in a bank of filters that the evidence compares.

    It is a value: a frame gives a new one. The filters differ in the kind of force and
    in its length scale; what is believed of state and force is their mixture. The
    leader is the most probable one, but for a nat.

    Attributes:
        longest: longest step of a prediction [T].
    """

    time: float
    filters: tuple[KernelFilter, ...]
    leader: int
    count: int
    longest: float

    @classmethod
    def start(
        cls,
        frame: Frame,
        *,
        lower: Vector,
        upper: Vector,
        motion: AbstractMotion,
        thrust: float,
        speed_sd: float = 0.1,
        longest: float = 0.1,
        scales: Sequence[float] = SCALES,
        kinds: Sequence[type[PotentialKernels | FreeKernels]] = KINDS,
    ) -> "Belief":
        """The belief after the first frame: a position, and nothing of the force.

        Args:
            frame: the first one; its thrust does not matter.
            lower: corner of the arena [L].
            upper: the other corner [L].
            thrust: greatest thrust, which sets the strength of the prior.
            speed_sd: standard deviation of each component of the first velocity.
            longest: longest step of a prediction [T].
            scales: longer side of the arena over the length scales.

        Raises:
            InputError: the first frame has no position, or there is no filter.
        """
        if frame.position is None:
            raise InputError("Belief.start: expected a frame with a position, got none")
        if not scales or not kinds:
            raise InputError("Belief.start: expected a scale and a kind, got none")
        state, spread = motion.start(frame.position, frame.sd, speed_sd)
        extent = float(np.max(upper - lower))
        bank: list[KernelFilter] = []
        for kind in kinds:
            for scale in scales:
                kernels = kind(KernelGrid.over(lower, upper, extent / scale))
                prior_sd = STRENGTH * thrust / kernels.gain
                weights = WeightPosterior.before_data(
                    kernels.size, len(state), prior_sd
                )
                bank.append(KernelFilter(kernels, motion, state, spread, weights))
        return cls(float(frame.time), tuple(bank), 0, 1, longest)

    def after(self, frame: Frame) -> "Belief":
        """The belief after another frame; a lost one only moves the state on.

        Raises:
            InputError: the frame is not later than the last one.
        """
        elapsed = frame.time - self.time
        if not elapsed > CLOCK:
            raise InputError(
                f"Belief.after: expected a frame later than {self.time:.6g}, got "
                f"{frame.time:.6g}"
            )
        steps, h = substeps(elapsed, self.longest)
        bank = []
        for place, one in enumerate(self.filters):
            for _ in range(steps):
                one = one.predict(frame.thrust, h)
            if frame.position is not None:
                one = one.update(frame.position, frame.sd)
            # One filter a frame, so that no frame takes much longer than another.
            if (self.count + place) % SETTLE_EVERY == 0:
                one = one.settle()
            bank.append(one)
        bank, leader = _within_memory(bank, self.leader)
        leader = _leader([one.log_evidence for one in bank], leader)
        return dataclasses.replace(
            self,
            time=float(frame.time),
            filters=tuple(bank),
            leader=leader,
            count=self.count + 1,
        )

    def restart(self, frame: Frame, *, speed_sd: float = 0.1) -> "Belief":
        """The map is kept and the state begins anew, as at a second visit.

        Args:
            frame: the first one of the new state; it may be of any time.
            speed_sd: standard deviation of each component of its velocity.

        Raises:
            InputError: the frame has no position.
        """
        if frame.position is None:
            raise InputError("Belief.restart: expected a frame with a position")
        first = self.filters[0].motion.start(frame.position, frame.sd, speed_sd)
        bank = tuple(one.restart(*first) for one in self.filters)
        return dataclasses.replace(self, time=float(frame.time), filters=bank)

    @property
    def best(self) -> KernelFilter:
        """The filter that leads."""
        return self.filters[self.leader]

    @property
    def log_evidence(self) -> Float[np.ndarray, " filter"]:
        """Logarithm of the density of all positions so far, by each filter."""
        return np.array([one.log_evidence for one in self.filters])

    @functools.cached_property
    def likely(self) -> tuple[list[KernelFilter], Float[np.ndarray, " likely"]]:
        """The filters that count, and their probabilities.

        They are equally probable before the first frame.
        """
        evidence = self.log_evidence
        odds = np.exp(evidence - evidence.max())
        kept = np.flatnonzero(odds >= NEGLIGIBLE)
        return [self.filters[k] for k in kept], odds[kept] / odds[kept].sum()

    @functools.cached_property
    def state(self) -> StateEstimate:
        """Position and, with inertia, velocity at the time of the last frame."""
        return _mix_states(*self.likely)

    @property
    def length_scale(self) -> float:
        """Length scale of the leader's force [L]."""
        return float(np.sqrt(2) * self.best.kernels.grid.width)

    def force(
        self, positions: Points
    ) -> tuple[Float[np.ndarray, "point dim"], Float[np.ndarray, "point dim"]]:
        """Mean and standard deviation of each component of the force at positions [L].

        Without inertia the force is a velocity.
        """
        filters, probabilities = self.likely
        parts = [one.force(np.asarray(positions, float)) for one in filters]
        means, sds = (np.stack(values) for values in zip(*parts, strict=True))
        mean = np.tensordot(probabilities, means, 1)
        variance = np.tensordot(probabilities, sds**2 + (means - mean) ** 2, 1)
        return mean, np.sqrt(variance)

    def force_on(
        self, axes: Sequence[Float[np.ndarray, " _"]]
    ) -> Float[np.ndarray, "... dim"]:
        """Mean force at the points of a lattice, by its coordinates along each axis."""
        filters, probabilities = self.likely
        maps = [one.kernels.on_axes(axes, one.all_weights()) for one in filters]
        return np.tensordot(probabilities, np.stack(maps), 1)

    def samples(
        self, axes: Sequence[Float[np.ndarray, " _"]], count: int, *, seed: int
    ) -> Float[np.ndarray, "{count} ... dim"]:
        """Draws of the force at the points of a lattice, in no order."""
        draws = self._draw_weights(count, seed)
        parts = [one.kernels.on_axes(axes, weights) for one, weights in draws]
        return np.concatenate(parts)

    def samples_at(
        self, positions: Points, count: int, *, seed: int
    ) -> Float[np.ndarray, "{count} point dim"]:
        """Draws of the force at positions [L], in no order."""
        draws = self._draw_weights(count, seed)
        parts = [
            np.einsum("pdw,kw->kpd", one.kernels.basis(positions), weights)
            for one, weights in draws
        ]
        return np.concatenate(parts)

    def _draw_weights(
        self, count: int, seed: int
    ) -> Iterator[tuple[KernelFilter, Float[np.ndarray, "draw weight"]]]:
        """Draws of the weights, of each filter as many as its probability asks for."""
        filters, probabilities = self.likely
        start = np.random.default_rng([seed, 1]).uniform()
        ends = np.floor(np.cumsum(probabilities) * count + start).astype(int)
        ends[-1] = count
        for one, number in zip(filters, np.diff(ends, prepend=0), strict=True):
            if number:
                yield one, one.sample_weights(int(number), seed)

    def ahead(
        self, thrusts: Points, durations: Float[np.ndarray, " thrust"]
    ) -> list[StateEstimate]:
        """The state after each of some thrusts, as long as no frame comes.

        Args:
            thrusts: as in `Frame`, one after the other; each is one step.
            durations: of each [T].
        """
        (filters, probabilities), states = self.likely, []
        for thrust, duration in zip(thrusts, durations, strict=True):
            filters = [one.predict(thrust, float(duration)) for one in filters]
            states.append(_mix_states(filters, probabilities))
        return states

    @property
    def nbytes(self) -> int:
        """Memory of the bank [byte]."""
        return sum(one.nbytes for one in self.filters)


def _mix_states(
    filters: Sequence[KernelFilter], probabilities: Float[np.ndarray, " filter"]
) -> StateEstimate:
    """Mean and covariance of the state, by filters of some probabilities."""
    means = np.stack([one.state for one in filters])
    mean = probabilities @ means
    apart = means - mean
    covariance = (probabilities * apart.T) @ apart
    for one, probability in zip(filters, probabilities, strict=True):
        covariance += probability * one.spread
    return StateEstimate(mean, covariance)


def _within_memory(
    bank: list[KernelFilter], leader: int
) -> tuple[list[KernelFilter], int]:
    """The bank without its least probable filters, and the place of the leader."""
    first, rest = bank[leader], list(bank)
    while len(rest) > 1 and sum(one.nbytes for one in rest) > MEMORY:
        others = [one for one in rest if one is not first]
        rest.remove(min(others, key=lambda one: one.log_evidence))
    return rest, rest.index(first)


def _leader(evidence: Sequence[float], leader: int) -> int:
    """The filter that leads now: the one that did, unless another is better by far."""
    best = int(np.argmax(evidence))
    return best if evidence[best] > evidence[leader] + MARGIN else leader
