r"""Formulas that the potential of a profile may follow, with numbers of their own.

A profile of kernels knows nothing where no swimmer went. Many fields follow a formula
of a size and a form, which the data on one flank of a hill tell of the other flank.
Beside the formula the kernels of the profile stay: they carry what it cannot.
"""

import abc
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar

SIZE, FORM = 1.0, 1.0
"""Deviations of the priors of the logarithm of a size, and of a form."""


class AbstractProfileLaw(eqx.Module):
    """A potential of one coordinate, of unit height.

    Attributes:
        log_size: logarithm of the distance over which it falls, in [L].
    """

    log_size: eqx.AbstractVar[Scalar]

    @property
    @abc.abstractmethod
    def kind(self) -> str:
        """The word for it in tables."""

    @property
    @abc.abstractmethod
    def latex(self) -> str:
        """Its formula for unit height."""

    @property
    @abc.abstractmethod
    def numbers(self) -> PyTree:
        """The numbers that shape it, each with a wide prior."""

    @property
    @abc.abstractmethod
    def scales(self) -> tuple[float, ...]:
        """Of each number: how far it may be from where a fit begins."""

    @abc.abstractmethod
    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        """The numbers as tables name them.

        Args:
            offset: of the coordinate, which places are told with [L].
        """

    @property
    def size(self) -> Scalar:
        """Distance over which it falls [L]."""
        return jnp.exp(self.log_size)

    @abc.abstractmethod
    def potential(self, z: Scalar) -> Float[Array, ""]:
        """The potential at a place along the coordinate, relative to its height."""

    def force(self, z: Scalar) -> Float[Array, ""]:
        """The force along the coordinate, for unit height [L⁻¹]."""
        return -jax.grad(self.potential)(z)


@final
class HillLaw(AbstractProfileLaw):
    r"""A hill of any tail, $U = (1 + \kappa z^2 / 2 s^2)^{-1/\kappa}$.

    Tails fall as a power where $\kappa$ is positive (a Lorentzian at one, a screened
    charge at two); at zero the hill is Gaussian, and below it ends at a finite
    distance.

    Attributes:
        log_size: $\log s$, $s$ in [L].
        form: $\log (1 + 2\kappa)$, so that $\kappa > -1/2$ and forces are smooth.

    References:
        Tsallis, J. Stat. Phys. 52, 479 (1988), whose exponential this is.
    """

    log_size: Scalar
    form: Scalar

    @property
    def kind(self) -> str:
        return "hill"

    @property
    def latex(self) -> str:
        return r"(1 + \kappa z^2 / 2 s^2)^{-1/\kappa}"

    @property
    def numbers(self) -> PyTree:
        return self.log_size, self.form

    @property
    def scales(self) -> tuple[float, ...]:
        return SIZE, FORM

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        return {"size": self.size, "tail": tail(self.form)}

    def potential(self, z: Scalar) -> Float[Array, ""]:
        return falling(0.5 * (z / self.size) ** 2, tail(self.form))


@final
class PlateauLaw(AbstractProfileLaw):
    r"""A hill with a flat top, $U = \exp(-(z^2 / 2 s^2)^m)$, or a pointed one.

    Attributes:
        log_size: $\log s$, $s$ in [L].
        log_steepness: $\log m$; at zero the hill is Gaussian.
    """

    log_size: Scalar
    log_steepness: Scalar

    @property
    def kind(self) -> str:
        return "plateau"

    @property
    def latex(self) -> str:
        return r"e^{-(z^2 / 2 s^2)^m}"

    @property
    def numbers(self) -> PyTree:
        return self.log_size, self.log_steepness

    @property
    def scales(self) -> tuple[float, ...]:
        return SIZE, FORM

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        return {"size": self.size, "steepness": jnp.exp(self.log_steepness)}

    def potential(self, z: Scalar) -> Float[Array, ""]:
        logarithm = 2 * jnp.log(jnp.abs(z) / self.size) - jnp.log(2.0)
        return jnp.exp(-jnp.exp(jnp.exp(self.log_steepness) * logarithm))


@final
class RingLaw(AbstractProfileLaw):
    r"""A ring about a point, or a layer along a line: a hill of any tail at $\rho$.

    Attributes:
        radius: $\rho$ [L].
        log_size: $\log s$, $s$ in [L].
        form: as that of a `HillLaw`.
    """

    radius: Scalar
    log_size: Scalar
    form: Scalar

    @property
    def kind(self) -> str:
        return "ring"

    @property
    def latex(self) -> str:
        return r"(1 + \kappa (z - \rho)^2 / 2 s^2)^{-1/\kappa}"

    @property
    def numbers(self) -> PyTree:
        return self.radius, self.log_size, self.form

    @property
    def scales(self) -> tuple[float, ...]:
        return float(self.size), SIZE, FORM

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        radius = self.radius + offset
        return {"radius": radius, "size": self.size, "tail": tail(self.form)}

    def potential(self, z: Scalar) -> Float[Array, ""]:
        offset = (z - self.radius) / self.size
        return falling(0.5 * offset**2, tail(self.form))


@final
class StepLaw(AbstractProfileLaw):
    r"""A rounded step, $U = 1 / (1 + e^{-(z - b) / w})$: a wall, or a disc turned over.

    Attributes:
        place: $b$ [L].
        log_size: $\log w$, $w$ in [L].
    """

    place: Scalar
    log_size: Scalar

    @property
    def kind(self) -> str:
        return "step"

    @property
    def latex(self) -> str:
        return r"1 / (1 + e^{-(z - b) / w})"

    @property
    def numbers(self) -> PyTree:
        return self.place, self.log_size

    @property
    def scales(self) -> tuple[float, ...]:
        return 2 * float(self.size), SIZE

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        return {"place": self.place + offset, "size": self.size}

    def potential(self, z: Scalar) -> Float[Array, ""]:
        return jax.nn.sigmoid((z - self.place) / self.size)


@final
class ChannelLaw(AbstractProfileLaw):
    r"""Two rounded steps that face each other, $b \pm a$, of one width and height.

    Attributes:
        middle: $b$ [L].
        half: $a$ [L].
        log_size: $\log w$, $w$ in [L].
    """

    middle: Scalar
    half: Scalar
    log_size: Scalar

    @property
    def kind(self) -> str:
        return "channel"

    @property
    def latex(self) -> str:
        return r"1 / (1 + e^{(a + b - z) / w}) + 1 / (1 + e^{(a - b + z) / w})"

    @property
    def numbers(self) -> PyTree:
        return self.middle, self.half, self.log_size

    @property
    def scales(self) -> tuple[float, ...]:
        return 2 * float(self.size), 2 * float(self.size), SIZE

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        middle = self.middle + offset
        return {"middle": middle, "half width": self.half, "size": self.size}

    def potential(self, z: Scalar) -> Float[Array, ""]:
        away = z - self.middle
        beyond = jnp.stack([away, -away]) - self.half
        return jnp.sum(jax.nn.sigmoid(beyond / self.size))


@final
class WaveLaw(AbstractProfileLaw):
    r"""A wave along a line, $U = \cos((z - b) / s)$: stripes.

    Attributes:
        place: $b$ of a crest [L].
        log_size: $\log s$, the period being $2\pi s$, in [L].
    """

    place: Scalar
    log_size: Scalar

    @property
    def kind(self) -> str:
        return "wave"

    @property
    def latex(self) -> str:
        return r"\cos((z - b) / s)"

    @property
    def numbers(self) -> PyTree:
        return self.place, self.log_size

    @property
    def scales(self) -> tuple[float, ...]:
        return 2 * float(self.size), SIZE

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        return {"place": self.place + offset, "period": 2 * jnp.pi * self.size}

    def potential(self, z: Scalar) -> Float[Array, ""]:
        return jnp.cos((z - self.place) / self.size)


LAWS: dict[str, type[AbstractProfileLaw]] = {
    law.__name__: law
    for law in (HillLaw, PlateauLaw, RingLaw, StepLaw, ChannelLaw, WaveLaw)
}
"""Laws by the names of their classes."""


def tail(form: Scalar) -> Scalar:
    r"""$\kappa$ of a form."""
    return 0.5 * jnp.expm1(form)


def falling(square: Scalar, tail: Scalar) -> Float[Array, ""]:
    r"""$(1 + \kappa q)^{-1/\kappa}$, which is $e^{-q}$ at $\kappa = 0$.

    Args:
        square: $q$, not negative.
        tail: $\kappa$.
    """
    is_near = jnp.abs(tail) < NEAR_GAUSSIAN
    curved = jnp.where(is_near, 1.0, tail)  # no division by zero in either branch
    bent = curved * square
    is_within = bent > -1
    power = jnp.log1p(jnp.where(is_within, bent, 0.0)) / curved
    series = square * (1 - tail * square * (0.5 - tail * square / 3))
    value = jnp.exp(-jnp.where(is_near, series, power))
    return jnp.where(is_near | is_within, value, 0.0)


NEAR_GAUSSIAN = 1e-4
r"""$|\kappa|$ below which the logarithm is a series: its slope loses digits there."""
