"""Effects of a camera and its tracking, as values applied in sequence.

Each leaves its input untouched and notes itself in the provenance.
"""

import abc
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from pinav.arguments import check_positive, check_range
from pinav.errors import InputError
from pinav.settings import NOT_NEGATIVE, Range
from pinav.trajectories.trajectories import Trajectories
from pinav.trajectories.trajectory import Trajectory

Channels = tuple[str, ...]
Random = np.random.Generator


class AbstractDegradation(eqx.Module):
    """One step from the truth to what is observed."""

    @abc.abstractmethod
    def __call__(
        self, trajectory: Trajectory, channels: Channels, random: Random
    ) -> Trajectory:
        """The trajectory after this step.

        Raises:
            InputError: the step cannot be applied to this trajectory.
        """


class GaussianNoise(AbstractDegradation):
    r"""Localisation error: independent normal noise in all states or `channels`.

    Attributes:
        deviation: standard deviation in the units of the channels.

    Raises:
        InputError: `deviation` is negative.
    """

    deviation: float = eqx.field(static=True)
    channels: tuple[str, ...] | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        check_range(self, NOT_NEGATIVE, "deviation")

    def __call__(
        self, trajectory: Trajectory, channels: Channels, random: Random
    ) -> Trajectory:
        noisy = _channel_mask(self, self.channels or channels, channels)
        noise = self.deviation * random.standard_normal(trajectory.states.shape)
        noise = np.where(trajectory.observed & noisy[None], noise, 0.0)
        return eqx.tree_at(lambda t: t.states, trajectory, trajectory.states + noise)


class FrameLoss(AbstractDegradation):
    """Frames without any observation, with a `probability` from 0 to below 1.

    The first and the last frame stay, so that a trajectory keeps its start and length.

    Raises:
        InputError: `probability` is outside of that.
    """

    probability: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_range(self, Range(least=0, below=1), "probability")

    def __call__(
        self, trajectory: Trajectory, channels: Channels, random: Random
    ) -> Trajectory:
        lost = random.random(len(trajectory.times)) < self.probability
        lost[[0, -1]] = False
        return _hide(trajectory, lost[:, None])


class Unobserved(AbstractDegradation):
    """Channels that are not measured, such as the velocities.

    Attributes:
        keep_first: leave the first sample as it is, where a rollout starts.
    """

    channels: tuple[str, ...] = eqx.field(static=True)
    keep_first: bool = eqx.field(static=True, default=False)

    def __call__(
        self, trajectory: Trajectory, channels: Channels, random: Random
    ) -> Trajectory:
        hidden = np.tile(
            _channel_mask(self, self.channels, channels), (len(trajectory.times), 1)
        )
        hidden[0] &= not self.keep_first
        return _hide(trajectory, hidden)


class MotionBlur(AbstractDegradation):
    r"""Average over the exposure, $\frac1\tau\int_{t-\tau/2}^{t+\tau/2} y(s)\,ds$.

    Between samples the states count as linear in time; at either end the exposure is
    cut to what was observed. It comes before noise and losses.

    Attributes:
        exposure: $\tau$ [T], positive.

    Raises:
        InputError: `exposure` is not positive.
    """

    exposure: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_positive(self, "exposure")

    def __call__(
        self, trajectory: Trajectory, channels: Channels, random: Random
    ) -> Trajectory:
        if not trajectory.observed.all():
            raise InputError(
                "MotionBlur: expected complete samples; apply it before FrameLoss and "
                "Unobserved"
            )
        from scipy.interpolate import make_interp_spline

        times = trajectory.times
        opened = np.maximum(times - self.exposure / 2, times[0])
        closed = np.minimum(times + self.exposure / 2, times[-1])
        path = make_interp_spline(times, trajectory.states, k=1).antiderivative()
        states = (path(closed) - path(opened)) / (closed - opened)[:, None]
        return eqx.tree_at(lambda t: t.states, trajectory, states)


class Subsample(AbstractDegradation):
    """A slower camera: one sample in `every` is kept, from the first on.

    Raises:
        InputError: `every` is not positive, or would leave a single sample.
    """

    every: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_range(self, Range(least=1), "every")

    def __call__(
        self, trajectory: Trajectory, channels: Channels, random: Random
    ) -> Trajectory:
        if len(trajectory.times) <= self.every:
            raise InputError(
                f"Subsample: {len(trajectory.times)} samples leave a single one; "
                f"expected every < {len(trajectory.times)}, got {self.every}"
            )
        return jax.tree.map(lambda array: array[:: self.every], trajectory)


def degrade(
    trajectories: Trajectories,
    steps: Sequence[AbstractDegradation],
    *,
    key: PRNGKeyArray,
) -> Trajectories:
    """Apply steps in sequence to copies of all trajectories.

    Args:
        steps: such as `[MotionBlur(0.03), GaussianNoise(0.05), FrameLoss(0.1)]`.
        key: random key; each trajectory has its own numbers, independent of the others.

    Raises:
        InputError: a step cannot be applied; the message says why.
    """
    words = jax.random.key_data(key).ravel().tolist()
    pieces = list(trajectories)
    for index, piece in enumerate(pieces):
        random = np.random.default_rng([*words, index])
        for step in steps:
            piece = step(piece, trajectories.channels, random)
        pieces[index] = piece
    before = trajectories.provenance.get("degradation", [])
    notes = [
        {"step": type(step).__name__}
        | {name: value for name, value in vars(step).items() if value is not None}
        for step in steps
    ]
    provenance = trajectories.provenance | {
        "degradation": [*before, *notes],
        "degradation key": words,
    }
    channels, units = trajectories.channels, trajectories.units
    return Trajectories.from_pieces(pieces, channels, units, provenance)


def _hide(trajectory: Trajectory, hidden: np.ndarray) -> Trajectory:
    observed = trajectory.observed & ~hidden
    states = np.where(observed, trajectory.states, 0.0)
    parts = (states, observed)
    return eqx.tree_at(lambda t: (t.states, t.observed), trajectory, parts)


def _channel_mask(
    step: AbstractDegradation, names: Sequence[str], channels: tuple[str, ...]
) -> np.ndarray:
    for name in names:
        if name not in channels:
            raise InputError(
                f"{type(step).__name__}.channels: {name!r} is no channel; expected "
                f"some of {', '.join(channels)}"
            )
    return np.array([channel in names for channel in channels])
