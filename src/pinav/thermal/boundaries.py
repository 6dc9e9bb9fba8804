r"""What happens at the sides of a grid: heat flows by a conductance, or is given.

No ghost cells: with $\Delta$ from the centre of the last cell to the wall,
$G = A/(\Delta/k)$ to a wall of given temperature, $A/(1/h + \Delta/k)$ to a fluid, and
0 where nothing passes. A new boundary is a class here, and its name in `BOUNDARIES`.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.quantities import Celsius, Exchange, Field


class Passage(NamedTuple):
    r"""Heat through the faces of a side into the cells, $q - G (T - T_\infty)$.

    Attributes:
        conductance: $G$ of each face [W K⁻¹].
        outside: $T_\infty$ behind it [°C].
        inflow: $q$ through each face, whatever the temperature [W].
    """

    conductance: Field
    outside: Scalar = 0.0
    inflow: Field | Scalar = 0.0


class AbstractBoundary(eqx.Module):
    """One side of a grid."""

    @abc.abstractmethod
    def passage(self, area: Field, resistance: Field) -> Passage:
        """Heat that passes.

        Args:
            area: of the faces [m²].
            resistance: of the half cells before them, `half width / k` [m² K W⁻¹].
        """


class Dirichlet(AbstractBoundary):
    """A wall of given temperature."""

    temperature: Scalar = eqx.field(metadata={"range": Celsius})

    def passage(self, area: Field, resistance: Field) -> Passage:
        return Passage(area / resistance, self.temperature)


class Insulated(AbstractBoundary):
    """No heat passes: insulation, or a plane of symmetry."""

    def passage(self, area: Field, resistance: Field) -> Passage:
        return Passage(jnp.zeros_like(area))


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

    def passage(self, area: Field, resistance: Field) -> Passage:
        # Film and half cell in series; the form stays finite for an infinite exchange.
        film = 1 / jnp.asarray(self.exchange)
        return Passage(area / (film + resistance), self.ambient)


BOUNDARIES = (Dirichlet, Robin, Insulated)
"""Those that a case may state, by the names of their fields."""


class AbstractEnds(eqx.Module):
    """What happens at both ends of one axis."""

    @property
    @abc.abstractmethod
    def joined(self) -> bool:
        """Whether heat that leaves by one end enters by the other."""

    @abc.abstractmethod
    def passages(
        self, areas: tuple[Field, Field], resistances: tuple[Field, Field]
    ) -> tuple[Passage, Passage]:
        """Heat through the lower and the upper end.

        Args:
            areas: of the faces at both ends [m²].
            resistances: of the half cells before them [m² K W⁻¹].
        """


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

    def passages(
        self, areas: tuple[Field, Field], resistances: tuple[Field, Field]
    ) -> tuple[Passage, Passage]:
        low, high = zip(areas, resistances, strict=True)
        return self.low.passage(*low), self.high.passage(*high)


class Periodic(AbstractEnds):
    """The ends meet: the tissue repeats itself along this axis of a box."""

    @property
    def joined(self) -> bool:
        return True

    def passages(
        self, areas: tuple[Field, Field], resistances: tuple[Field, Field]
    ) -> tuple[Passage, Passage]:
        through = Passage(areas[0] / (resistances[0] + resistances[1]))
        return through, through


def around(grid: AbstractGrid, boundary: AbstractBoundary) -> tuple[AbstractEnds, ...]:
    """The same boundary on every side."""
    return tuple(Sides(boundary, boundary) for _ in grid.shape)


def outer(boundary: AbstractBoundary) -> tuple[AbstractEnds, ...]:
    """A boundary at the outer end of a radial grid, symmetry at its inner end."""
    return (Sides(Insulated(), boundary),)
