r"""What happens at the sides of a grid: a conductance to an outside temperature.

No ghost cells: with $\Delta$ from the centre of the last cell to the wall,
$G = A/(\Delta/k)$ to a wall of given temperature, $A/(1/h + \Delta/k)$ to a fluid, and
0 where nothing passes.
"""

import abc

import equinox as eqx
import jax.numpy as jnp

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.quantities import Celsius, Exchange, Field


class AbstractBoundary(eqx.Module):
    """One side of a grid."""

    @abc.abstractmethod
    def conductance(self, area: Field, resistance: Field) -> Field:
        """Heat flow per degree [W K⁻¹].

        Args:
            area: of the faces [m²].
            resistance: of the half cells before them, `half width / k` [m² K W⁻¹].
        """

    @property
    @abc.abstractmethod
    def outside(self) -> Scalar:
        """Temperature behind the conductance [°C]."""


class Dirichlet(AbstractBoundary):
    """A wall of given temperature."""

    temperature: Scalar = eqx.field(metadata={"range": Celsius})

    def conductance(self, area: Field, resistance: Field) -> Field:
        return area / resistance

    @property
    def outside(self) -> Scalar:
        return self.temperature


class Insulated(AbstractBoundary):
    """No heat passes: insulation, or a plane of symmetry."""

    def conductance(self, area: Field, resistance: Field) -> Field:
        return jnp.zeros_like(area)

    @property
    def outside(self) -> Scalar:
        return 0.0


class Robin(AbstractBoundary):
    r"""Loss to a fluid, $-k\,\partial T/\partial n = h (T - T_\infty)$.

    Attributes:
        exchange: $h$ [W m⁻² K⁻¹], positive.
        ambient: $T_\infty$ [°C].

    Raises:
        InputError: `exchange` is a number that is not positive.
    """

    exchange: Scalar = eqx.field(metadata={"range": Exchange})
    ambient: Scalar = eqx.field(metadata={"range": Celsius})

    def __check_init__(self) -> None:
        if isinstance(self.exchange, float | int) and not self.exchange > 0:
            raise InputError(
                f"Robin.exchange: expected > 0 W/(m² K), got {self.exchange}; use "
                "Insulated() where no heat passes"
            )

    def conductance(self, area: Field, resistance: Field) -> Field:
        # Film and half cell in series; the form stays finite for an infinite exchange.
        return area / (1 / jnp.asarray(self.exchange) + resistance)

    @property
    def outside(self) -> Scalar:
        return self.ambient


class AbstractEnds(eqx.Module):
    """What happens at both ends of one axis."""

    @property
    @abc.abstractmethod
    def joined(self) -> bool:
        """Whether heat that leaves by one end enters by the other."""

    @abc.abstractmethod
    def conductances(
        self, areas: tuple[Field, Field], resistances: tuple[Field, Field]
    ) -> tuple[Field, Field]:
        """Heat flow per degree through the lower and the upper end [W K⁻¹].

        Args:
            areas: of the faces at both ends [m²].
            resistances: of the half cells before them [m² K W⁻¹].
        """

    @abc.abstractmethod
    def outside(self, first: Field, last: Field) -> tuple[Field, Field]:
        """Temperatures [°C] behind both ends, from those of the outermost cells."""


class Sides(AbstractEnds):
    """A boundary at each end.

    Attributes:
        low: at the lower end; the centre of a cylinder or sphere has no area.
    """

    low: AbstractBoundary
    high: AbstractBoundary

    @property
    def joined(self) -> bool:
        return False

    def conductances(
        self, areas: tuple[Field, Field], resistances: tuple[Field, Field]
    ) -> tuple[Field, Field]:
        low, high = zip(areas, resistances, strict=True)
        return self.low.conductance(*low), self.high.conductance(*high)

    def outside(self, first: Field, last: Field) -> tuple[Field, Field]:
        return jnp.asarray(self.low.outside), jnp.asarray(self.high.outside)


class Periodic(AbstractEnds):
    """The ends meet: the tissue repeats itself along this axis of a box."""

    @property
    def joined(self) -> bool:
        return True

    def conductances(
        self, areas: tuple[Field, Field], resistances: tuple[Field, Field]
    ) -> tuple[Field, Field]:
        through = areas[0] / (resistances[0] + resistances[1])
        return through, through

    def outside(self, first: Field, last: Field) -> tuple[Field, Field]:
        return last, first


def around(grid: AbstractGrid, boundary: AbstractBoundary) -> tuple[AbstractEnds, ...]:
    """The same boundary on every side."""
    return tuple(Sides(boundary, boundary) for _ in grid.shape)


def outer(boundary: AbstractBoundary) -> tuple[AbstractEnds, ...]:
    """A boundary at the outer end of a radial grid, symmetry at its inner end."""
    return (Sides(Insulated(), boundary),)
