r"""Magnetic nanoparticles in an alternating field: power per mass of particles.

The peak amplitude $H$ [A m⁻¹] and the frequency $f$ [Hz] of the field make the specific
loss power (SLP) [W kg⁻¹], per mass of the particles' solid. A measured value per mass
of iron belongs to a concentration of iron.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, check_positive
from pinav.errors import InputError
from pinav.thermal.quantities import Field

VACUUM_PERMEABILITY = 4e-7 * np.pi
"""$\\mu_0$ [T m A⁻¹]."""

BOLTZMANN = 1.380649e-23
"""$k_B$ [J K⁻¹]."""


class AbstractHeating(eqx.Module):
    """How particles turn a field into heat."""

    @abc.abstractmethod
    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        """Power per mass of particles [W kg⁻¹]."""

    @abc.abstractmethod
    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        """How far the law is strained at `amplitude`: above 1 it does not hold."""


class LinearResponse(AbstractHeating):
    r"""Rosensweig's linear response of single-domain particles of one size.

    $P = \pi\mu_0\chi'' f H^2$, $\chi'' = \chi_0\,\omega\tau/(1+(\omega\tau)^2)$,
    $\tau^{-1} = \tau_N^{-1} + \tau_B^{-1}$, with the chord susceptibility
    $\chi_0 = \chi_i\,\tfrac{3}{\xi}(\coth\xi - 1/\xi)$. Linear response needs
    $\xi = \mu_0 M_d H V/(k_B T) < 1$; `validity` returns it. At a fixed product $Hf$
    the power falls with $f$ wherever $\chi_0$ is taken as constant: an optimiser that
    runs to the largest amplitude found that artefact.

    Attributes:
        diameter: of the magnetic core [m].
        anisotropy: $K$ [J m⁻³].
        magnetisation: $M_d$ of the domains [A m⁻¹].
        attempt_time: $\tau_0$ [s].
        viscosity: of the carrier [Pa s]; infinite where particles are bound to tissue.
        coating: thickness $\delta$ of the shell [m].

    Raises:
        InputError: a number is not positive.

    References:
        Rosensweig, J. Magn. Magn. Mater. 252, 370 (2002); Carrey, Mehdaoui and
        Respaud, J. Appl. Phys. 109, 083921 (2011), for the range of validity.
    """

    diameter: Scalar
    anisotropy: Scalar = 23e3
    magnetisation: Scalar = 446e3
    attempt_time: Scalar = 1e-9
    viscosity: Scalar = 1e-3
    coating: Scalar = 2e-9
    density: Scalar = 5180.0
    temperature: Scalar = 310.15

    def __check_init__(self) -> None:
        check_positive(self, "diameter", "anisotropy", "magnetisation", "density")
        if isinstance(self.diameter, float) and self.diameter > 1e-6:
            raise InputError(
                f"LinearResponse.diameter: expected metres, such as 14e-9, got "
                f"{self.diameter}"
            )

    @property
    def _energy(self) -> Any:
        return BOLTZMANN * self.temperature

    @property
    def _volume(self) -> Any:
        return np.pi / 6 * self.diameter**3

    @property
    def neel_time(self) -> Scalar:
        r"""$\tau_N = \frac{\sqrt\pi}{2}\tau_0\,e^\Gamma/\sqrt\Gamma$ [s]."""
        barrier = jnp.asarray(self.anisotropy * self._volume / self._energy)
        prefactor = 0.5 * np.sqrt(np.pi) * self.attempt_time
        return prefactor * jnp.exp(barrier) / jnp.sqrt(barrier)

    @property
    def brown_time(self) -> Scalar:
        r"""$\tau_B = 3\eta V_H/(k_B T)$ [s]."""
        hydrodynamic = np.pi / 6 * (self.diameter + 2 * self.coating) ** 3
        return 3 * self.viscosity * hydrodynamic / self._energy

    @property
    def relaxation_time(self) -> Scalar:
        r"""$\tau = 1/(1/\tau_N + 1/\tau_B)$ [s]."""
        return 1 / (1 / self.neel_time + 1 / self.brown_time)

    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        moment = VACUUM_PERMEABILITY * self.magnetisation * self._volume
        return jnp.asarray(moment * amplitude / self._energy)

    def susceptibility(self, amplitude: Scalar) -> Float[Array, ""]:
        r"""$\chi_0$ of the solid at this amplitude, one at volume fraction 1."""
        initial = VACUUM_PERMEABILITY * self.magnetisation**2 * self._volume
        return initial / (3 * self._energy) * langevin_ratio(self.validity(amplitude))

    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        phase = 2 * np.pi * frequency * self.relaxation_time
        loss = self.susceptibility(amplitude) * phase / (1 + phase**2)
        power = np.pi * VACUUM_PERMEABILITY * loss * frequency * amplitude**2
        return jnp.asarray(power / self.density)


def langevin_ratio(field: Field) -> Field:
    r"""$\frac{3}{\xi}(\coth\xi - 1/\xi)$, one at zero."""
    small = jnp.abs(field) < 1e-2
    safe = jnp.where(small, 1.0, field)
    series = 1 - field**2 / 15 + 2 * field**4 / 315
    return jnp.where(small, series, 3 / safe * (1 / jnp.tanh(safe) - 1 / safe))


class LogNormalSizes(AbstractHeating):
    r"""A distribution of sizes: number log-normal, $d = d_m e^{sz}$, $z \sim N(0, 1)$.

    The power per mass is $E[d^3\,\mathrm{SLP}(d)]/E[d^3]$, by the trapezoidal rule
    about where the mass is: the SLP rises 240-fold between 10 and 16 nm and falls
    again, too sharply for the nodes of Gauss and Hermite. `validity` is that of the
    size that carries the median mass.

    Attributes:
        median: particles of the median size $d_m$.
        spread: $s$, standard deviation of $\ln d$.
        num_nodes: of the rule, over sixteen standard deviations.

    Raises:
        InputError: `spread` is a number <= 0.
    """

    median: LinearResponse
    spread: Scalar
    num_nodes: int = eqx.field(static=True, default=401)

    def __check_init__(self) -> None:
        if isinstance(self.spread, float | int) and not self.spread > 0:
            raise InputError(
                f"LogNormalSizes.spread: expected > 0, got {self.spread}; use "
                "LinearResponse for one size"
            )

    def _with_diameter(self, diameter: Any) -> Any:
        return eqx.tree_at(lambda p: p.diameter, self.median, diameter)

    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        heavy = self.median.diameter * jnp.exp(3 * jnp.asarray(self.spread) ** 2)
        return self._with_diameter(heavy).validity(amplitude)

    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        nodes = np.linspace(-8.0, 8.0, self.num_nodes)
        weights = np.exp(-0.5 * nodes**2)
        # d³ N(z) is a normal density about 3s: the mass average has no other factor
        shifted = jnp.asarray(nodes) + 3 * jnp.asarray(self.spread)
        diameters = self.median.diameter * jnp.exp(self.spread * shifted)
        each = jax.vmap(lambda d: self._with_diameter(d).slp(amplitude, frequency))
        return jnp.asarray(weights / weights.sum()) @ each(diameters)


class TabulatedHeating(AbstractHeating):
    r"""Measured SLP on a grid of amplitudes and frequencies, bilinear between them.

    Below the smallest amplitude the SLP falls with $H^2$, outside the frequencies it is
    that of the nearest one. `validity` is the amplitude over the largest measured one.

    Attributes:
        amplitudes: increasing [A m⁻¹], positive.
        frequencies: increasing [Hz].
        values: SLP [W kg⁻¹].

    Raises:
        InputError: the axes do not increase, or the table has not their shape.
    """

    amplitudes: Float[Array, " amplitude"] = eqx.field(converter=jnp.asarray)
    frequencies: Float[Array, " frequency"] = eqx.field(converter=jnp.asarray)
    values: Float[Array, "amplitude frequency"] = eqx.field(converter=jnp.asarray)

    def __check_init__(self) -> None:
        for name in ("amplitudes", "frequencies"):
            axis = np.asarray(getattr(self, name))
            if not (np.all(axis > 0) and np.all(np.diff(axis) > 0)):
                raise InputError(
                    f"TabulatedHeating.{name}: expected increasing numbers > 0, got "
                    f"{axis.tolist()}"
                )

    def slp(self, amplitude: Scalar, frequency: Scalar) -> Float[Array, ""]:
        strength = jnp.asarray(amplitude, float)
        rows = jax.vmap(lambda row: jnp.interp(frequency, self.frequencies, row))
        column = rows(self.values)
        low = jnp.minimum(strength / self.amplitudes[0], 1.0) ** 2
        return low * jnp.interp(strength, self.amplitudes, column)

    def validity(self, amplitude: Scalar) -> Float[Array, ""]:
        return jnp.asarray(amplitude / self.amplitudes[-1])
