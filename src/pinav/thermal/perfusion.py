r"""Perfusion laws: mass perfusion $w(T)$ [kg m⁻³ s⁻¹], of blood per tissue and time.

Four conventions are in use, and mixing them up is the commonest mistake; numbers from
outside come with a unit, through `mass_perfusion`. In the equation stands
$W = c_b w$ [W m⁻³ K⁻¹].
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.quantities import Field, Number
from pinav.thermal.tissues import Blood, Property, Tissue, least_known

PLAUSIBLE = (1e-3, 150.0)
"""Mass perfusions [kg m⁻³ s⁻¹] that living tissue can have; the kidney has 70."""


def mass_perfusion(value: Scalar, *, unit: str, blood: Blood, tissue: Tissue) -> Scalar:
    r"""A perfusion in kg m⁻³ s⁻¹, from any of the usual conventions.

    Args:
        unit: of blood per tissue and time: by volumes `1/s`, its mass per volume
            `kg/m3/s`, its volume per mass `ml/min/kg` as in the IT'IS database (heat
            transfer rate), or the clinical `ml/min/100g`.
        blood: its density turns volumes into masses.
        tissue: its density turns masses of tissue into volumes.

    Raises:
        InputError: the unit is unknown, or the result is nothing living tissue has,
            which is what a wrong unit looks like.
    """
    mass = value * perfusion_factor(unit, blood=blood, tissue=tissue)
    # Checked after the conversion: a wrong unit is off by a factor of 10 or more.
    size = least_known(mass)
    if size is not None and size != 0 and not PLAUSIBLE[0] <= size <= PLAUSIBLE[1]:
        raise InputError(
            f"perfusion {value:g} {unit}: expected within {PLAUSIBLE[0]:g} and "
            f"{PLAUSIBLE[1]:g} kg/(m³ s), or zero, got {size:.3g}; check the unit"
        )
    return mass


def perfusion_factor(unit: str, *, blood: Blood, tissue: Tissue) -> Property:
    """What a perfusion in a unit is multiplied by to be in kg m⁻³ s⁻¹."""
    per_kilogram = 1e-6 / 60 * tissue.density * blood.density
    factors = {
        "1/s": blood.density,
        "kg/m3/s": 1.0,
        "ml/min/kg": per_kilogram,
        "ml/min/100g": 10 * per_kilogram,
    }
    if unit not in factors:
        raise InputError(
            f"perfusion unit {unit!r} is unknown; choose one of: {', '.join(factors)}"
        )
    return factors[unit]


class AbstractPerfusion(eqx.Module):
    """Mass perfusion as a function of the local temperature."""

    @abc.abstractmethod
    def __call__(self, temperature: Field) -> Field:
        """Mass perfusion $w$ [kg m⁻³ s⁻¹] at temperatures [°C], one for each cell."""


class ConstantPerfusion(AbstractPerfusion):
    """The same at all temperatures.

    Attributes:
        value: $w$ [kg m⁻³ s⁻¹], a number or one for each cell.

    Raises:
        InputError: it is negative.
    """

    value: Property

    def __check_init__(self) -> None:
        least = least_known(self.value)
        if least is not None and least < 0:
            raise InputError(
                f"ConstantPerfusion: expected >= 0 kg/(m³ s), got {least:g}"
            )

    def __call__(self, temperature: Field) -> Field:
        return jnp.broadcast_to(jnp.asarray(self.value, float), temperature.shape)


class RisingPerfusion(AbstractPerfusion):
    r"""Perfusion that rises with temperature up to a plateau.

    $w = a + b \exp(-(T - T_m)^2/s)$ for $T \le T_m$, and $a + b$ above.

    Attributes:
        rest: $a$ [kg m⁻³ s⁻¹].
        gain: $b$ [kg m⁻³ s⁻¹].
        plateau: $T_m$ [°C].
        spread: $s$ [K²].

    References:
        Lang, Erdmann and Seebass, IEEE Trans. Biomed. Eng. 46, 1129 (1999).
    """

    rest: Scalar
    gain: Scalar
    plateau: Scalar = 45.0
    spread: Scalar = 12.0

    def __call__(self, temperature: Field) -> Field:
        below = jnp.minimum(temperature - self.plateau, 0.0)
        return self.rest + self.gain * jnp.exp(-(below**2) / self.spread)


BLEND = 0.1
"""Temperatures [K] over which a jump of a law is smoothed."""


class TabulatedPerfusion(AbstractPerfusion):
    """A law of one's own: linear between temperatures, constant beyond them.

    Attributes:
        temperatures: increasing [°C], `BLEND` apart or more.
        values: $w$ at them [kg m⁻³ s⁻¹].

    Raises:
        InputError: the temperatures do not increase, or the law jumps.
    """

    temperatures: tuple[float, ...] = eqx.field(static=True)
    values: Float[Array, " temperature"]

    def __check_init__(self) -> None:
        count = len(self.temperatures)
        if len(self.values) != count or count < 2:
            raise InputError(
                "values: expected one for each of two temperatures or more, got "
                f"{len(self.values)} for {count}"
            )
        if np.diff(self.temperatures).min() < BLEND * (1 - 1e-9):
            raise InputError(
                f"temperatures: expected increasing, {BLEND:g} K apart or more, got "
                f"{list(self.temperatures)}; a law that jumps has no derivative there: "
                f"let it rise over {BLEND:g} K"
            )

    def __call__(self, temperature: Field) -> Field:
        return jnp.interp(temperature, jnp.asarray(self.temperatures), self.values)


class CollapsingPerfusion(AbstractPerfusion):
    r"""Perfusion of a tumour that breaks down as it is heated.

    $w = w_0 - (T - T_1)^{4.8}/s$ between $T_1$ and $T_2$; $w_0$ below, the constant
    $w_2$ above. With the printed constants it would jump by 5e-4 at $T_2$, which no
    derivative sees: it goes linearly to $w_2$ over a tenth of a kelvin. Power balance
    without conduction then has two stable temperatures for some powers, so that the
    result depends on the past.

    Attributes:
        rest: $w_0$ [kg m⁻³ s⁻¹].
        collapsed: $w_2$ [kg m⁻³ s⁻¹].
        onset: $T_1$ [°C].
        end: $T_2$ [°C].
        scale: $s$ [K⁴·⁸ m³ s kg⁻¹].

    References:
        Lang, Erdmann and Seebass, IEEE Trans. Biomed. Eng. 46, 1129 (1999).
    """

    rest: Scalar = 0.833
    collapsed: Scalar = 0.416
    onset: Scalar = 37.0
    end: Scalar = 42.0
    scale: Scalar = 5438.0

    def __call__(self, temperature: Field) -> Field:
        above = jnp.clip(temperature - self.onset, 0.0, self.end - self.onset)
        # the power of zero has no derivative by itself: kept out, then put back
        positive = above > 0
        # by exp and log, which run on whole vectors: ten times faster than pow
        loss = jnp.exp(4.8 * jnp.log(jnp.where(positive, above, 1.0))) / self.scale
        falling = self.rest - jnp.where(positive, loss, 0.0)
        passed = jnp.clip((temperature - self.end) / BLEND, 0.0, 1.0)
        return falling + passed * (self.collapsed - falling)


LANG = {
    "muscle": RisingPerfusion(0.45, 3.55),
    "fat": RisingPerfusion(0.36, 0.36),
    "tumour": CollapsingPerfusion(),
}
"""The laws of Lang, Erdmann and Seebass (1999)."""


def lang(tissue: str) -> AbstractPerfusion:
    """The temperature-dependent perfusion of a tissue."""
    if tissue not in LANG:
        raise InputError(
            f"no perfusion law for {tissue!r}; choose one of: {', '.join(LANG)}"
        )
    return LANG[tissue]


class RegionalPerfusion(AbstractPerfusion):
    """A law for each of any number of tissues, averaged by volume.

    `on_masks` makes one that evaluates each law only where its tissue is.

    Attributes:
        fractions: volume fraction of each tissue in each cell; fixed.
        boxes: for each tissue first cell and end along each axis of a part of the grid
            outside which its fraction is zero; the whole grid unless given.
    """

    fractions: tuple[Field, ...]
    laws: tuple[AbstractPerfusion, ...]
    boxes: tuple[tuple[tuple[int, int], ...], ...] = eqx.field(static=True, default=())

    @classmethod
    def on_masks(
        cls, fractions: tuple[Field, ...], laws: tuple[AbstractPerfusion, ...]
    ) -> "RegionalPerfusion":
        """The same with the smallest boxes; the whole grid for fractions being traced.

        Args:
            fractions: of each tissue.
            laws: of each tissue, with no values for each cell.
        """
        if any(isinstance(fraction, Tracer) for fraction in fractions):
            return cls(fractions, laws)
        masks = [np.asarray(fraction) != 0 for fraction in fractions]
        places = [np.nonzero(mask if mask.any() else ~mask) for mask in masks]
        boxes = [
            tuple((int(axis.min()), int(axis.max()) + 1) for axis in place)
            for place in places
        ]
        return cls(fractions, laws, tuple(boxes))

    def __call__(self, temperature: Field) -> Field:
        total = jnp.zeros_like(temperature)
        whole = tuple((0, count) for count in temperature.shape)
        boxes = self.boxes or (whole,) * len(self.laws)
        for fraction, law, box in zip(self.fractions, self.laws, boxes, strict=True):
            cut, first = tuple(slice(*ends) for ends in box), [low for low, _ in box]
            part = total[cut] + fraction[cut] * law(temperature[cut])
            total = jax.lax.dynamic_update_slice(total, part, first)
        return total


MIDDLE, UNIT = 41.0, 4.0
"""Temperature [°C] that a network sees as 0, and change [K] that it sees as 1."""


class AbstractLearnedPerfusion(AbstractPerfusion):
    r"""A perfusion to be learned, $\log w = \log w_0 + g(T)$, flat outside a range.

    $w_0$ has a flat prior, the weights of $g$ independent normal ones. Perfusion enters
    the equation as $w (T - T_a)$: near the arterial temperature no data tell it, and
    outside the range that the tissue visited none can.

    Attributes:
        log_level: $\log w_0$, with $w_0$ in kg m⁻³ s⁻¹.
        range: temperatures [°C] between which it varies; it is constant outside.
    """

    log_level: eqx.AbstractVar[Scalar]
    range: eqx.AbstractVar[tuple[float, float]]

    @property
    @abc.abstractmethod
    def weights(self) -> PyTree:
        """The leaves with a Gaussian prior."""

    @abc.abstractmethod
    def variation(self, temperature: Field) -> Field:
        """$g$ at temperatures within the range."""

    def __call__(self, temperature: Field) -> Field:
        inside = jnp.clip(temperature, *self.range)
        return jnp.exp(self.log_level + self.variation(inside))


class NeuralPerfusion(AbstractLearnedPerfusion):
    """Perfusion by a small network of temperature; make one by `neural_perfusion`."""

    network: eqx.nn.MLP
    log_level: Scalar
    range: tuple[float, float] = eqx.field(static=True)

    @property
    def weights(self) -> PyTree:
        return self.network

    def variation(self, temperature: Field) -> Field:
        scaled = (temperature.reshape(-1, 1) - MIDDLE) / UNIT
        return jax.vmap(self.network)(scaled).reshape(temperature.shape)


class KernelPerfusion(AbstractLearnedPerfusion):
    r"""Perfusion by kernels of the temperature; make one by `kernel_perfusion`.

    $g(T) = \sum_j v_j\,(k(T, c)\,L^{-\top})_j$ with
    $k(T, c) = \exp(-(T-c)^2/2\ell^2)$ and $L L^\top = k(c, c)$: for independent $v_j$
    of one variance a Gaussian process of length scale $\ell$.
    """

    values: Float[Array, " kernel"]
    centers: Float[Array, " kernel"]
    root: Float[Array, "kernel kernel"]
    length_scale: Scalar
    log_level: Scalar
    range: tuple[float, float] = eqx.field(static=True)

    @property
    def weights(self) -> PyTree:
        return self.values

    def variation(self, temperature: Field) -> Field:
        # Whitened weights: their prior is the identity, whatever the length scale.
        factors = jax.scipy.linalg.solve_triangular(self.root.T, self.values)
        flat = temperature.reshape(-1)
        offsets = (flat[:, None] - self.centers[None]) / self.length_scale
        return (jnp.exp(-0.5 * offsets**2) @ factors).reshape(temperature.shape)


def neural_perfusion(
    level: Number,
    temperatures: tuple[float, float],
    *,
    key: PRNGKeyArray,
    width: int = 16,
) -> NeuralPerfusion:
    """An untrained network of one hidden layer.

    Args:
        level: perfusion to start from [kg m⁻³ s⁻¹], positive.
        temperatures: range between which it varies [°C].

    Raises:
        InputError: the level is not positive, or the range not increasing.
    """
    _check(level, temperatures)
    network = eqx.nn.MLP(1, 1, width, 1, activation=jnp.tanh, key=key)
    return NeuralPerfusion(
        network=network, log_level=jnp.log(jnp.asarray(level)), range=temperatures
    )


def kernel_perfusion(
    level: Number, temperatures: tuple[float, float], *, length_scale: Number = 3.0
) -> KernelPerfusion:
    """Kernels every half length scale, without weight yet.

    Args:
        level: perfusion to start from [kg m⁻³ s⁻¹], positive.
        temperatures: range between which it varies [°C].
        length_scale: over which perfusion changes [K].

    Raises:
        InputError: the level or the length scale is not positive, or the range not
            increasing.
    """
    _check(level, temperatures)
    if not length_scale > 0:
        raise InputError(
            f"kernel_perfusion length_scale: expected > 0 K, got {length_scale}"
        )
    low, high = temperatures
    count = max(3, round(2 * (high - low) / length_scale) + 1)
    centers = np.linspace(low, high, count)
    squares = ((centers[:, None] - centers[None]) / length_scale) ** 2
    # Kernels every half length scale are nearly dependent: a ridge makes the root real.
    root = np.linalg.cholesky(np.exp(-0.5 * squares) + 1e-8 * np.eye(count))
    return KernelPerfusion(
        values=jnp.zeros(count),
        centers=jnp.asarray(centers),
        root=jnp.asarray(root),
        length_scale=length_scale,
        log_level=jnp.log(jnp.asarray(level)),
        range=temperatures,
    )


def _check(level: Any, temperatures: Any) -> None:
    if not 0 < level < np.inf:
        raise InputError(f"perfusion level: expected > 0 kg/(m³ s), got {level}")
    if not temperatures[0] < temperatures[1]:
        raise InputError(
            f"perfusion range: expected increasing temperatures, got {temperatures}"
        )
