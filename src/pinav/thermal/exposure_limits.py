"""Limits of the field that a body is exposed to: objects of their own, with names.

Which limit holds is the user's choice. A product of amplitude and frequency leaves out
the duty cycle; what limits in practice is the temperature that eddy currents make.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import Insulated, Sides
from pinav.thermal.grids import RadialGrid
from pinav.thermal.perfusion import AbstractPerfusion
from pinav.thermal.protocols import AbstractProtocol, Piecewise
from pinav.thermal.quantities import Number
from pinav.thermal.rosenbrock import Rosenbrock
from pinav.thermal.schedule import plan_steps
from pinav.thermal.solve import run
from pinav.thermal.sources import EddySource
from pinav.thermal.tissues import Blood, Tissue


class AbstractLimit(eqx.Module):
    """A bound on a protocol.

    Attributes:
        name: what messages call it.
    """

    name: eqx.AbstractVar[str]

    @property
    @abc.abstractmethod
    def bound(self) -> float:
        """What the exposure may not exceed, in `unit`."""

    @property
    @abc.abstractmethod
    def unit(self) -> str:
        """Of bound and exposure."""

    @abc.abstractmethod
    def exposure(self, protocol: AbstractProtocol) -> Float[Array, " part"]:
        """What is bounded, differentiable by the amplitudes.

        One number for each interval where intervals count by themselves: the largest of
        them has a kink, at which an optimiser stops.
        """


class HfLimit(AbstractLimit):
    """A bound on the product of amplitude and frequency.

    Attributes:
        product: largest $Hf$ [A m⁻¹ s⁻¹], positive.
        name: what messages call it.
    """

    product: Number
    name: str = eqx.field(static=True, default="Hf limit")

    def __check_init__(self) -> None:
        if not self.product > 0:
            raise InputError(
                f"HfLimit.product: expected > 0 A/(m s), got {self.product}"
            )

    @property
    def bound(self) -> float:
        return float(self.product)

    @property
    def unit(self) -> str:
        return "A/(m s)"

    def exposure(self, protocol: AbstractProtocol) -> Float[Array, " part"]:
        return peak_amplitudes(protocol) * protocol.frequency


ATKINSON_BREZOVICH = HfLimit(product=4.85e8, name="Atkinson-Brezovich limit")
"""Tolerated for over an hour by a torso of some 30 cm: Atkinson, Brezovich and
Chakraborty, IEEE Trans. Biomed. Eng. 31, 70 (1984)."""

HERGT_DUTZ = HfLimit(product=5e9, name="Hergt-Dutz limit")
"""Proposed for smaller exposed regions: Hergt and Dutz, J. Magn. Magn. Mater. 311, 187
(2007)."""

LIMITS = {"atkinson-brezovich": ATKINSON_BREZOVICH, "hergt-dutz": HERGT_DUTZ}


class EddyTemperatureLimit(AbstractLimit):
    r"""A bound on the temperature that eddy currents make of a body without particles.

    Tissue without conduction, from the arterial temperature: $\rho c\,\theta' =
    Q_{eddy}(t) - c_b w(T)\,\theta$ over the protocol, so that pauses count.

    Attributes:
        highest: temperature that may be reached [°C].
        radius: of the body's current loop [m].
        conductivity: of the body [S m⁻¹].
        perfusion: of the tissue.
        tissue: what is heated.
        blood: that cools it.
        name: what messages call it.
    """

    highest: Number
    radius: Number
    conductivity: Number
    perfusion: AbstractPerfusion
    tissue: Tissue
    blood: Blood = Blood()
    name: str = eqx.field(static=True, default="eddy temperature limit")

    @property
    def bound(self) -> float:
        return float(self.highest)

    @property
    def unit(self) -> str:
        return "°C"

    def exposure(self, protocol: AbstractProtocol) -> Float[Array, " part"]:
        model = Bioheat(
            RadialGrid.slab(0.03, 3),  # uniform, so that three cells are enough
            eqx.tree_at(lambda t: t.metabolic, self.tissue, 0.0),
            self.blood,
            self.perfusion,
            (EddySource(self.radius, self.conductivity),),
            (Sides(Insulated(), Insulated()),),
        )
        solution = run(
            model,
            protocol,
            plan_steps(protocol, LONGEST),
            stepper=Rosenbrock(LONGEST),
            observe=jnp.max,
        )
        # One number: heat of one interval stays for the next, so none counts by itself.
        return jnp.max(solution.hottest, keepdims=True)


LONGEST = 10.0
"""Time step [s] of the tissue that eddy currents heat."""


def peak_amplitudes(protocol: AbstractProtocol) -> Float[Array, " interval"]:
    """Largest amplitude [A m⁻¹] of each interval; of a `Waveform` among 200 times."""
    if isinstance(protocol, Piecewise):
        return jnp.maximum(protocol.starts, protocol.ends)
    edges = jnp.asarray(protocol.edges)

    def peak(interval: Int[Array, ""]) -> Array:
        times = jnp.linspace(edges[interval], edges[interval + 1], 200)
        amplitudes = jax.vmap(lambda t: protocol.amplitude(t, interval))(times)
        return jnp.max(amplitudes)

    return jax.vmap(peak)(jnp.arange(len(protocol.edges) - 1))


def require(protocol: AbstractProtocol, *limits: AbstractLimit) -> None:
    """Refuse a protocol that exceeds a limit.

    Raises:
        InputError: it does; the message names the limit.
    """
    for limit in limits:
        reached = float(jnp.max(limit.exposure(protocol)))
        if reached > limit.bound * (1 + 1e-9):
            raise InputError(
                f"protocol exceeds the {limit.name}: expected <= {limit.bound:.4g} "
                f"{limit.unit}, got {reached:.4g} {limit.unit}; lower the amplitude or "
                "the frequency, or choose another limit"
            )


def limit(name: str) -> AbstractLimit:
    """A limit of the product $Hf$ by its name.

    Raises:
        InputError: the name is unknown.
    """
    if name not in LIMITS:
        raise InputError(
            f"field limit {name!r} is unknown; choose one of: {', '.join(LIMITS)}"
        )
    return LIMITS[name]


def validity_warnings(
    model: Bioheat, protocol: Piecewise, hottest: Scalar | None = None
) -> list[str]:
    """What of a run lies outside the range of its laws, one sentence each.

    Args:
        model: whose sources are asked how far they are strained.
        protocol: the field.
        hottest: highest temperature reached [°C].
    """
    from pinav.thermal.sources import ParticleSource

    warnings = []
    for source in model.sources:
        if isinstance(source, ParticleSource):
            strain = float(source.heating.validity(protocol.largest))
            if strain > 1:
                warnings.append(
                    f"{type(source.heating).__name__} is strained {strain:.3g} times "
                    "beyond its range of validity (1) at the largest amplitude; the "
                    "power is doubtful"
                )
    if hottest is not None and float(hottest) > HOTTEST_VALID:
        warnings.append(
            f"{float(hottest):.1f} °C is reached; perfusion and heating laws hold up "
            f"to about {HOTTEST_VALID:g} °C"
        )
    return warnings


HOTTEST_VALID = 55.0
"""Temperature [°C] above which neither perfusion nor linear response is known."""
