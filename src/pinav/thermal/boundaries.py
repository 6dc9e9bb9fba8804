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
from pinav.thermal.quantities import Field


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
    """A wall of given temperature.

    Attributes:
        temperature: of the wall [°C].
    """

    temperature: Scalar

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

    exchange: Scalar
    ambient: Scalar

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


class Sides(eqx.Module):
    """Both ends of one axis.

    Attributes:
        low: at the lower end; the centre of a cylinder or sphere has no area.
        high: at the upper end.
    """

    low: AbstractBoundary
    high: AbstractBoundary


def around(grid: AbstractGrid, boundary: AbstractBoundary) -> tuple[Sides, ...]:
    """The same boundary on every side."""
    return tuple(Sides(boundary, boundary) for _ in grid.shape)


def outer(boundary: AbstractBoundary) -> tuple[Sides, ...]:
    """A boundary at the outer end of a radial grid, symmetry at its inner end."""
    return (Sides(Insulated(), boundary),)
