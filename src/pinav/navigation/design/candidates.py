r"""Candidates for the next recording: starts and programmes within the limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, PRNGKeyArray

from pinav.actuation import AbstractProgramme, LinearProgramme
from pinav.arguments import Scalar, Vector, check_positive
from pinav.errors import InputError
from pinav.forces import AbstractForce
from pinav.navigation.task.steering import AbstractActuator, CommandLimits
from pinav.navigation.task.task import Rectangle


class CommandedThrust(AbstractForce):
    """The thrust that an actuator makes of a programme of commands."""

    programme: AbstractProgramme
    actuator: AbstractActuator

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.actuator(jnp.stack(self.programme(t))).astype(x.dtype)


class CandidateTrajectories(eqx.Module):
    """Trajectories that could be recorded, as a batch.

    Attributes:
        frequency: commanded at each knot [cycles T⁻¹].
        heading: commanded at each knot [rad].
    """

    starts: Float[Array, "*candidate state"]
    frequency: Float[Array, "*candidate knot"]
    heading: Float[Array, "*candidate knot"]

    def __getitem__(
        self, index: int | slice | Int[ArrayLike, " chosen"]
    ) -> "CandidateTrajectories":
        """One candidate, or some of them."""
        return jax.tree.map(lambda leaf: leaf[index], self)


class Experiment(eqx.Module):
    r"""The recording of trajectories, and its limits.

    Commands are given at knots and go linearly from one to the next, so that the
    heading never jumps. Candidates are random: the first heading is uniform, later ones
    follow a random walk; frequencies are uniform up to their limit.

    Attributes:
        region: region in which swimmers are released.
        duration: of a trajectory [T], positive.
        interval: between two samples [T], positive.
        knot: between two commands [T], positive.
        noise: standard deviation of what is observed of each component of the state;
            infinite where nothing is.
        turning: standard deviation of the change of heading in unit time
            [rad T^-1/2], positive.

    Raises:
        InputError: a time or `turning` is not positive, or `noise` is not.
    """

    actuator: AbstractActuator
    limits: CommandLimits
    region: Rectangle
    noise: Float[np.ndarray, " state"] = eqx.field(
        converter=lambda value: np.asarray(value, float)
    )
    duration: float = eqx.field(static=True)
    interval: float = eqx.field(static=True, default=0.1)
    knot: float = eqx.field(static=True, default=1.0)
    turning: float = eqx.field(static=True, default=0.6)

    def __check_init__(self) -> None:
        check_positive(self, "duration", "interval", "knot", "turning")
        if isinstance(self.noise, np.ndarray) and not np.all(self.noise > 0):
            raise InputError(
                f"Experiment.noise: expected numbers > 0, got {self.noise.tolist()}; "
                "give infinity for what is not observed"
            )

    @property
    def times(self) -> Float[Array, " time"]:
        """Times of observation from the start of a trajectory [T]."""
        count = round(self.duration / self.interval)
        return jnp.linspace(0.0, self.duration, count + 1)

    @property
    def knots(self) -> Float[Array, " knot"]:
        """Times of the commands from the start [T]."""
        count = max(round(self.duration / self.knot), 1)
        return jnp.linspace(0.0, self.duration, count + 1)

    def thrust(self, candidate: CandidateTrajectories) -> CommandedThrust:
        """Propulsion of a single candidate."""
        series = candidate.frequency, candidate.heading
        return CommandedThrust(LinearProgramme(self.knots, *series), self.actuator)

    @eqx.filter_jit
    def draw(self, count: int, *, key: PRNGKeyArray) -> CandidateTrajectories:
        """Random candidates: released at rest, uniformly in the region."""
        place_key, first_key, turn_key, frequency_key = jax.random.split(key, 4)
        lower, upper = self.region.lower, self.region.upper
        fraction = jax.random.uniform(place_key, (count, 2))
        places = lower[None] + fraction * (upper - lower)[None]
        rest = jnp.zeros((count, len(self.noise) - 2))
        first = jax.random.uniform(first_key, (count, 1), maxval=2 * np.pi)
        steps = len(self.knots) - 1
        turns = jax.random.normal(turn_key, (count, steps)) * self._turn
        walk = jnp.cumsum(self._clip_turns(turns), axis=1)
        return CandidateTrajectories(
            starts=jnp.concatenate([places, rest], axis=1),
            frequency=jax.random.uniform(
                frequency_key, (count, steps + 1), maxval=self.limits.max_frequency
            ),
            heading=jnp.concatenate([first, first + walk], axis=1),
        )

    @eqx.filter_jit
    def vary(
        self,
        candidate: CandidateTrajectories,
        count: int,
        *,
        key: PRNGKeyArray,
        spread: float = 0.3,
    ) -> CandidateTrajectories:
        """Variations of a trajectory, within the same limits, from the same start.

        Args:
            candidate: a single one.
            count: how many.
            key: random key.
            spread: of the changes, relative to those between random candidates.
        """
        first_key, turn_key, frequency_key = jax.random.split(key, 3)
        turns = jnp.diff(candidate.heading)
        changes = jax.random.normal(turn_key, (count, len(turns))) * self._turn
        first = jax.random.normal(first_key, (count, 1)) * np.pi * spread
        walk = jnp.cumsum(self._clip_turns(turns[None] + spread * changes), axis=1)
        heading = candidate.heading[0] + first
        scatter = jax.random.normal(frequency_key, (count, len(turns) + 1))
        most = self.limits.max_frequency
        frequency = candidate.frequency[None] + spread * most * scatter
        return CandidateTrajectories(
            starts=jnp.broadcast_to(candidate.starts, (count, *candidate.starts.shape)),
            frequency=jnp.clip(frequency, 0.0, most),
            heading=jnp.concatenate([heading, heading + walk], axis=1),
        )

    @property
    def _turn(self) -> float:
        """Standard deviation of the change of heading between two knots [rad]."""
        return self.turning * self.knot**0.5

    def _clip_turns(
        self, turns: Float[Array, "candidate step"]
    ) -> Float[Array, "candidate step"]:
        """Changes of heading that the coils can follow, less than half a turn."""
        most = min(self.limits.max_turning_rate * self.knot, 0.99 * np.pi)
        return jnp.clip(turns, -most, most)
