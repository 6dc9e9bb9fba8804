"""Commands of the operator: magnetic fields, frequencies, headings, their effect.

Tracked robots log the frequency of the rotating field and the heading it rolls to, not
the field itself: `AbstractProgramme`. What a robot makes of the frequency is an
`AbstractResponse`; what a held command does to a swimmer is an `AbstractActuator`.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector, check_positive, dimension
from pinav.errors import InputError


class AbstractField(eqx.Module):
    """A uniform magnetic field that varies in time."""

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> Float[Array, "3"]:
        """Field [B] at time `t` [T]."""


class RotatingField(AbstractField):
    r"""Field $B(t) = B_0 [\cos\omega t, \sin\omega t, 0]$ rotating in the plane.

    Attributes:
        amplitude: $B_0$ [B].
        frequency: angular frequency $\omega$ [rad T⁻¹].

    References:
        PI-NAV paper, section 2.2.
    """

    amplitude: Scalar = eqx.field(metadata=dimension("B"))
    frequency: Scalar = eqx.field(metadata=dimension("rad T-1"))

    def __call__(self, t: Scalar) -> Float[Array, "3"]:
        phase = self.frequency * jnp.asarray(t)
        direction = jnp.stack([jnp.cos(phase), jnp.sin(phase), jnp.zeros_like(phase)])
        return self.amplitude * direction


class AbstractResponse(eqx.Module):
    """Speed that a rolling robot makes of the commanded frequency.

    The response is an effective frequency: speed per gain. It is about the commanded
    one at low frequencies, so that gains of different responses can be compared.
    """

    @abc.abstractmethod
    def __call__(self, frequency: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Effective frequency [Hz] at commanded ones [Hz]; both at least 0."""


class LinearResponse(AbstractResponse):
    """Speed in proportion to the frequency."""

    def __call__(self, frequency: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        return frequency


class SaturatingResponse(AbstractResponse):
    r"""Smooth saturation $f / \sqrt{1 + (f / f_c)^2}$: the speed levels off.

    Attributes:
        corner: corner frequency $f_c$ [Hz], positive.

    Raises:
        InputError: `corner` is a number <= 0.
    """

    corner: Scalar = eqx.field(metadata=dimension("Hz"))

    def __check_init__(self) -> None:
        check_positive(self, "corner")

    def __call__(self, frequency: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        return frequency / jnp.sqrt(1 + (frequency / self.corner) ** 2)


class SlippingResponse(AbstractResponse):
    r"""Partial saturation: a part of the gain is lost above the corner, not all.

    $$s(f) = \rho f + (1 - \rho) \frac{f}{\sqrt{1 + (f / f_c)^2}}.$$

    A roller grips at low frequencies and slips at higher ones, where it still gains
    speed at the rate $\rho$. It contains the linear response ($\rho = 1$) and full
    saturation ($\rho = 0$).

    Attributes:
        corner: corner frequency $f_c$ [Hz], positive.
        residual: $\rho$, the part of the gain that remains far above the corner [1].

    Raises:
        InputError: `corner` is a number <= 0, or `residual` one outside (0, 1).
    """

    corner: Scalar = eqx.field(metadata=dimension("Hz"))
    residual: Scalar = eqx.field(metadata=dimension("1"))

    def __check_init__(self) -> None:
        check_positive(self, "corner")
        if isinstance(self.residual, float | int) and not 0 < self.residual < 1:
            raise InputError(
                "SlippingResponse.residual: expected between 0 and 1, got "
                f"{self.residual}; for the ends take SaturatingResponse or "
                "LinearResponse"
            )

    def __call__(self, frequency: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        saturated = SaturatingResponse(self.corner)(frequency)
        return self.residual * frequency + (1 - self.residual) * saturated


class StepOutResponse(AbstractResponse):
    r"""Step-out: a robot follows the field up to $f_c$, and falls behind above it.

    The mean rotation of an overdamped dipole is $f$ below the step-out frequency and
    $f - \sqrt{f^2 - f_c^2}$ above it. The corner is rounded, over a tenth of $f_c$.
    Without the field strength $f_c$ is an effective parameter.

    Attributes:
        corner: step-out frequency $f_c$ [Hz], positive.

    Raises:
        InputError: `corner` is a number <= 0.

    References:
        Adler, Proc. IRE 34, 351 (1946).
    """

    corner: Scalar = eqx.field(metadata=dimension("Hz"))

    def __check_init__(self) -> None:
        check_positive(self, "corner")

    def __call__(self, frequency: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        above = (frequency / self.corner) ** 2 - 1
        rounded = (above + jnp.sqrt(above**2 + ROUNDING**2)) / 2
        start = (jnp.sqrt(1 + ROUNDING**2) - 1) / 2  # no slip at rest
        return frequency - self.corner * (jnp.sqrt(rounded) - jnp.sqrt(start))


ROUNDING = 0.1
"""Relative width of the rounded corner of a step-out."""


Command = Float[Array, " dim"]
"""Frequency [cycles T⁻¹] and heading [rad]; in space also the elevation [rad]."""


def direction(angles: Float[Array, " angle"]) -> Vector:
    r"""Unit vector $n(\theta)$ of a heading, or of heading and elevation [rad].

    In space $n = (\cos\theta\cos\epsilon, \sin\theta\cos\epsilon, \sin\epsilon)$.
    """
    planar = jnp.stack([jnp.cos(angles[0]), jnp.sin(angles[0])])
    for elevation in angles[1:]:
        planar = jnp.append(planar * jnp.cos(elevation), jnp.sin(elevation))
    return planar


class AbstractActuator(eqx.Module):
    """Effect of a command on the swimmer."""

    @abc.abstractmethod
    def __call__(self, command: Command) -> Vector:
        """Thrust [L T⁻²] of a command: a velocity [L T⁻¹] where mobility is 1."""


class RollingActuator(AbstractActuator):
    r"""Velocity $G\, s(f)\, n(\theta)$ of a robot that rolls, as in a recording's fit.

    Attributes:
        gain: $G$ [L per cycle].
        response: $s(f)$, the effective frequency.
    """

    gain: Float[Array, "dim dim"] = eqx.field(metadata=dimension("L"))
    response: AbstractResponse

    def __call__(self, command: Command) -> Vector:
        return self.gain @ (self.response(command[0]) * direction(command[1:]))


class AbstractProgramme(eqx.Module):
    """Frequency and heading that the operator commands over time.

    Before its first time a programme has its first values, after its last its last.

    Attributes:
        times: when each command was given, or reached [s], increasing.
        frequency: [Hz].
        heading: angle to the x axis, y up [rad].
    """

    times: eqx.AbstractVar[Float[Array, " time"]]
    frequency: eqx.AbstractVar[Float[Array, " time"]]
    heading: eqx.AbstractVar[Float[Array, " time"]]

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Frequency [Hz] and heading [rad] at time `t` [s]."""


class HeldProgramme(AbstractProgramme):
    """Commands that hold until the next one: what coils do between camera frames."""

    times: Float[Array, " time"]
    frequency: Float[Array, " time"]
    heading: Float[Array, " time"]

    def __call__(self, t: Scalar) -> tuple[Float[Array, ""], Float[Array, ""]]:
        last = self.times.shape[0] - 1
        index = jnp.searchsorted(self.times, jnp.asarray(t), side="right") - 1
        index = jnp.clip(index, 0, last)
        return self.frequency[index], self.heading[index]

    def commands(self, response: AbstractResponse) -> Float[Array, "time 2"]:
        r"""$s(f)\, n(\theta)$ at the programme's own times [Hz]."""
        direction = jnp.stack([jnp.cos(self.heading), jnp.sin(self.heading)], axis=1)
        return response(self.frequency)[:, None] * direction

    def lagged_integral(
        self, response: AbstractResponse, ts: Float[Array, " query"], lag: Scalar
    ) -> Float[Array, "query 2"]:
        r"""The integral of a command followed with a lag T, $T \dot c' = c - c'$.

        Exact at the programme's times, linear in between; a short lag is none.

        Args:
            response: what becomes of the frequency.
            ts: times [s].
            lag: T [s], positive.
        """
        commands = self.commands(response)
        behind = follow(self.times, commands, lag)[:-1]
        intervals = jnp.diff(self.times)[:, None]
        decay = jnp.exp(-intervals / lag)
        missed = (behind - commands[:-1]) * lag * (1 - decay)
        steps = commands[:-1] * intervals + missed
        total = jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps, axis=0)])
        inside = [jnp.interp(ts, self.times, column) for column in total.T]
        # Beyond the programme's times the first and the last command go on.
        before = jnp.minimum(ts - self.times[0], 0.0)[:, None] * commands[:1]
        after = jnp.maximum(ts - self.times[-1], 0.0)[:, None] * commands[-1:]
        return jnp.stack(inside, axis=1) + before + after


class LinearProgramme(AbstractProgramme):
    """Commands that change linearly from one to the next; headings the short way."""

    times: Float[Array, " time"]
    frequency: Float[Array, " time"]
    heading: Float[Array, " time"]

    def __call__(self, t: Scalar) -> tuple[Float[Array, ""], Float[Array, ""]]:
        turned = jnp.unwrap(self.heading)
        t = jnp.asarray(t, self.times.dtype)
        return (
            jnp.interp(t, self.times, self.frequency),
            jnp.interp(t, self.times, turned),
        )


def follow(
    times: Float[Array, " time"], commands: Float[Array, "time 2"], lag: Scalar
) -> Float[Array, "time 2"]:
    r"""State of a first-order follower, $T \dot c' = c - c'$, at each command's time.

    Each step is linear, $c' \to k c' + g$. All stretches of `STRETCH` steps are
    composed side by side, and then joined: a program that is compiled in a third of the
    time of an associative scan.

    Args:
        times: when each command was given [s].
        commands: c, which hold until the next one; the follower begins at the first.
        lag: T [s], positive.
    """
    kept = jnp.exp(-jnp.diff(times) / lag)[:, None]
    kept = jnp.concatenate([jnp.zeros((1, 1)), kept])
    gained = jnp.concatenate([commands[:1], (1 - kept[1:]) * commands[:-1]])
    count = len(times)
    more = ((0, -count % STRETCH), (0, 0))
    kept, gained = (
        jnp.swapaxes(jnp.pad(steps, more).reshape(-1, STRETCH, steps.shape[1]), 0, 1)
        for steps in (kept, gained)
    )

    def compose(
        before: tuple[Array, Array], step: tuple[Array, Array]
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        both = before[0] * step[0], step[0] * before[1] + step[1]
        return both, both

    def join(state: Array, stretch: tuple[Array, Array]) -> tuple[Array, Array]:
        return stretch[0] * state + stretch[1], state

    nothing = jnp.ones_like(kept[0]), jnp.zeros_like(gained[0])
    _, (kept, gained) = jax.lax.scan(compose, nothing, (kept, gained))
    _, begins = jax.lax.scan(join, jnp.zeros_like(gained[0, 0]), (kept[-1], gained[-1]))
    states = jnp.swapaxes(kept * begins[None] + gained, 0, 1)
    return states.reshape(-1, commands.shape[1])[:count]


STRETCH = 64
"""Steps of a follower that are composed one after the other."""
