"""`System`: what is known of a swimmer, what is not, and how it is observed."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray

from pinav.arguments import Scalar, check_positive, check_range, dimension
from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import AbstractForce, ZeroForce
from pinav.settings import NOT_NEGATIVE, ThermalSettings
from pinav.systems.priors import FreeNumber
from pinav.systems.starts import AbstractStarts

MODELS = (
    *("kernel-potential", "kernel-force", "kernel-mixture", "kernel-potential-time"),
    *("neural-potential", "neural-force", "ude", "nn-only", "physics-only"),
)
"""Models of the unknown environment."""

AXES = ("x", "y", "z")
"""Names of the coordinates; a velocity has a v before them."""


LENGTHS = ("1", "nm", "um", "mm", "cm", "m", "px", "?")
"""Units of length; "1" is dimensionless, "?" unknown."""

TIMES = ("1", "us", "ms", "s", "min", "h", "frame", "?")
"""Units of time."""

FORCES = ("1", "fN", "pN", "nN", "uN", "mN", "N", "?")
"""Units of force, for systems without inertia."""


def velocity_unit(length: str, time: str) -> str:
    """Unit of a velocity; unknown where either is."""
    if "?" in (length, time):
        return "?"
    return length if time == "1" else f"{length}/{time}"


class Units(eqx.Module):
    """Units of length, time and force in which a system states its numbers.

    A swimmer with inertia has accelerations in place of forces.

    Raises:
        InputError: a unit is none of `LENGTHS`, `TIMES` and `FORCES`.
    """

    length: str = eqx.field(static=True, default="1")
    time: str = eqx.field(static=True, default="1")
    force: str = eqx.field(static=True, default="1")

    def __check_init__(self) -> None:
        for name, known in (("length", LENGTHS), ("time", TIMES), ("force", FORCES)):
            if (unit := getattr(self, name)) not in known:
                raise InputError(
                    f"units.{name}: expected one of {', '.join(known)}; got {unit!r}"
                )

    @property
    def velocity(self) -> str:
        """Unit of velocity."""
        return velocity_unit(self.length, self.time)

    def of_channels(self, channels: tuple[str, ...]) -> dict[str, str]:
        """Unit of each channel, x or vx, and of time `t`."""
        units = {
            name: self.velocity if name.startswith("v") else self.length
            for name in channels
        }
        return {**units, "t": self.time}


class Observation(eqx.Module):
    """Errors of the measurement.

    Attributes:
        noise: standard deviation of the Gaussian noise of every channel.
        exposure: time over which a camera averages [T].

    Raises:
        InputError: either is negative.
    """

    noise: float = 0.0
    exposure: float = 0.0

    def __check_init__(self) -> None:
        check_range(self, NOT_NEGATIVE, "noise", "exposure")


class WanderingVelocity(eqx.Module):
    r"""Ornstein-Uhlenbeck velocity $w$ that carries a real robot, $\dot x = \dots + w$.

    $dw = -w\, dt / \tau + \sigma \sqrt{2 / \tau}\, dW$ with $\sigma$ its standard
    deviation along each axis, $\sigma^2 = \mathrm{still}^2 + \mathrm{driven}^2 \sqrt f$
    at the commanded frequency f. A drift that changes slowly is a second velocity of
    the same kind.

    Attributes:
        still: $\sigma$ without a command [L T⁻¹], not negative.
        driven: its growth with the command [L T⁻¹ Hz^(-1/4)], not negative.
        memory: correlation time $\tau$ [T], positive.
        slow: standard deviation of the slow velocity [L T⁻¹], not negative.
        slow_memory: its correlation time [T], positive.

    Raises:
        InputError: a standard deviation is negative, or a memory is a number <= 0.
    """

    still: Scalar = eqx.field(metadata=dimension("L T-1"))
    driven: Scalar = eqx.field(metadata=dimension("L T-1 Hz^(-1/4)"))
    memory: Scalar = eqx.field(metadata=dimension("T"))
    slow: Scalar = eqx.field(metadata=dimension("L T-1"), default=0.0)
    slow_memory: Scalar = eqx.field(metadata=dimension("T"), default=60.0)

    def __check_init__(self) -> None:
        check_positive(self, "memory", "slow_memory")
        check_range(self, NOT_NEGATIVE, "still", "driven", "slow")

    def strength(self, frequency: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        r"""$\sigma$ at these commanded frequencies [L T⁻¹]."""
        rolling = frequency > 0
        # The derivative of a root at 0 is infinite, also in the branch not taken.
        root = jnp.sqrt(jnp.where(rolling, frequency, 1.0))
        variance = self.still**2 + self.driven**2 * jnp.where(rolling, root, 0.0)
        return jnp.sqrt(variance)


def _as_array(value: ArrayLike | Sequence, ndim: int) -> Array:
    """Starts or times as an array; with no rows where there are none."""
    array = value if isinstance(value, Array) else jnp.asarray(value, float)
    return jnp.zeros((0,) * ndim) if array.size == 0 else array


class System(eqx.Module):
    """A swimmer, its noise and its observation; the environment may be unknown.

    Attributes:
        swimmer: the known physics; its environment is `ZeroForce()`.
        environment: the true environment, where it is known.
        thermal_energy: $k_B T$ [F L] of a swimmer without inertia; none unless given.
        wandering: Ornstein-Uhlenbeck velocity of a real robot; none by default.
        observation: noise and exposure of the measurement.
        starts: initial states, one per trajectory; none by default.
        rule: rule by which the starts were drawn.
        times: observation times [T], the same for every trajectory; none by default.
        decays: the unknown force is stated to decay beyond the data, so that bands end
            there; otherwise it is as large elsewhere as where the data are.
        thermal: description of the unknown in thermal motion.
        learn: numbers of the swimmer that are learned with the environment.

    Raises:
        InputError: the parts do not fit together.
    """

    name: str = eqx.field(static=True)
    swimmer: Swimmer | OverdampedSwimmer
    dim: int = eqx.field(static=True)
    environment: AbstractForce | None = None
    thermal_energy: Scalar | None = None
    wandering: WanderingVelocity | None = None
    observation: Observation = Observation()
    starts: Float[Array, "trajectory state"] = eqx.field(
        converter=lambda value: _as_array(value, 2), default=()
    )
    rule: AbstractStarts | None = None
    times: Float[Array, " time"] = eqx.field(
        converter=lambda value: _as_array(value, 1), default=()
    )
    base_units: Units = Units()
    model: str = eqx.field(static=True, default="kernel-potential")
    decays: bool = eqx.field(static=True, default=False)
    thermal: ThermalSettings = eqx.field(static=True, default=ThermalSettings())
    learn: tuple[FreeNumber, ...] = ()

    def __check_init__(self) -> None:
        if self.dim not in (1, 2, 3):
            raise InputError(f"system.dimension: expected 1, 2 or 3, got {self.dim}")
        if not isinstance(self.swimmer.environment, ZeroForce):
            raise InputError(
                "system.swimmer: expected an environment of ZeroForce(); take "
                "swimmer.without_environment() and give the true one as environment"
            )
        energy = self.thermal_energy
        if energy is not None and self.order == 2:
            raise InputError(
                "system.thermal_energy: expected a swimmer without inertia (order 1); "
                "thermal noise of order 2 is not implemented, drop it"
            )
        if self.wandering is not None and self.order == 2:
            raise InputError(
                "system.wandering: expected a swimmer without inertia (order 1), got "
                "order 2; drop it"
            )
        check_range(self, NOT_NEGATIVE, "thermal_energy")
        if len(self.starts) and self.starts.shape[1] != len(self.channels):
            raise InputError(
                f"system.starts: expected {len(self.channels)} numbers a start "
                f"({', '.join(self.channels)}), got {self.starts.shape[1]}"
            )
        for number in self.learn:
            number.pick(self.swimmer)

    @property
    def order(self) -> int:
        """Order of the dynamics: 2 with inertia, 1 without."""
        return 2 if isinstance(self.swimmer, Swimmer) else 1

    @property
    def position_channels(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return AXES[: self.dim]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the components of the state."""
        velocities = tuple(f"v{axis}" for axis in self.position_channels)
        return self.position_channels + (velocities if self.order == 2 else ())

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel and of time `t`; "1" means dimensionless."""
        return self.base_units.of_channels(self.channels)

    @property
    def noise(self) -> float:
        """Standard deviation of the observation noise of every channel."""
        return self.observation.noise

    @property
    def true_swimmer(self) -> Swimmer | OverdampedSwimmer:
        """The swimmer in its true environment, without thermal noise.

        Raises:
            InputError: the true environment is not stated.
        """
        if self.environment is None:
            raise InputError(
                f"system {self.name!r}: its true environment is not stated; state one "
                "in the table [truth], or by system.with_truth(force)"
            )
        return self.swimmer.with_environment(self.environment)

    @property
    def truth(self) -> Swimmer | OverdampedSwimmer | BrownianSwimmer:
        """The swimmer in its true environment, with thermal noise where there is any.

        Raises:
            InputError: the true environment is not stated.
        """
        return self.with_noise_of(self.true_swimmer)

    def with_noise_of(
        self, swimmer: Swimmer | OverdampedSwimmer
    ) -> Swimmer | OverdampedSwimmer | BrownianSwimmer:
        """A swimmer with the thermal noise of this system."""
        if self.thermal_energy is None or isinstance(swimmer, Swimmer):
            return swimmer
        return BrownianSwimmer(swimmer, self.thermal_energy)

    @property
    def diffusion(self) -> float | None:
        """Mean diffusion coefficient at the origin [L² T⁻¹]; none without noise."""
        noisy = self.with_noise_of(self.swimmer)
        if not isinstance(noisy, BrownianSwimmer):
            return None
        return float(np.trace(noisy.diffusion(jnp.zeros(self.dim))) / self.dim)

    def check_simulated(self) -> None:
        """Raise `InputError` where something that a simulation needs is not stated."""
        _ = self.true_swimmer
        for table, value in (("starts", self.starts), ("times", self.times)):
            if len(value) == 0:
                raise InputError(
                    f"system {self.name!r}: expected [{table}] for a simulation; "
                    "state that table, or pass it to System"
                )

    def with_truth(self, environment: AbstractForce) -> "System":
        """The system in another true environment."""
        return dataclasses.replace(self, environment=environment)

    @property
    def starts_follow_rule(self) -> bool:
        """The starts are those that the rule draws by its own seed and number."""
        if self.rule is None:
            return False
        return np.array_equal(self.rule.draw(self.order), self.starts)

    def with_starts(
        self, key: PRNGKeyArray | None = None, count: int | None = None
    ) -> "System":
        """The system with starts drawn by its rule, by default with its key and number.

        Raises:
            InputError: another number is wanted of starts that no rule draws.
        """
        if self.rule is not None:
            starts = self.rule.draw(self.order, key, count)
            return dataclasses.replace(self, starts=starts)
        stated = len(self.starts)
        if count not in (None, stated):
            raise InputError(
                f"system {self.name!r} has {stated} fixed start{'s' * (stated != 1)}, "
                f"so --count {count} cannot be; state a rule that draws starts"
            )
        return self
