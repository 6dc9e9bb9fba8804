"""Laws that the profiles of a fit may follow, with numbers that are fitted."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.forces.formulas import NUMERIC
from pinav.forces.profiles import FITTED, AbstractProfile


class FittedLaw(eqx.Module):
    r"""A law of a term: a profile with numbers of its own, which are fitted.

    A profile of kernels knows nothing where no swimmer went. Many fields follow a
    formula of a size and a form, which the data on one flank of a hill tell of the
    other flank. Beside the formula the kernels of the profile stay: they carry what it
    cannot.

    Attributes:
        name: in `FITTED`.
        numbers: of each constant a number without bounds: places and the half width of
            a channel [L] as they are, of a size or a steepness the logarithm, of a tail
            $\log (1 + 2\kappa)$, so that $\kappa > -1/2$ and forces are smooth.
    """

    name: str = eqx.field(static=True)
    numbers: tuple[Scalar, ...]

    @property
    def family(self) -> AbstractProfile:
        """Its profile."""
        return FITTED[self.name]

    @property
    def latex(self) -> str:
        """Its formula for unit height."""
        return self.family.formula

    @property
    def scales(self) -> tuple[float, ...]:
        """Prior standard deviation of each number: one of logarithms and forms."""
        far = self.family.reach * float(self.size)
        return tuple(far if n in PLACES else 1.0 for n in self.family.numbers)

    @property
    def size(self) -> Scalar:
        """Distance over which it falls [L]."""
        names = self.family.numbers
        index = names.index("period" if "period" in names else "size")
        return jnp.exp(self.numbers[index])

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        """The numbers as tables name them, places shifted by an offset [L]."""
        names, values = self.family.numbers, list(self._values)
        if self.family.is_placed:
            values[0] = values[0] + offset
        if names[-1] == "period":
            values[-1] = 2 * jnp.pi * values[-1]
        return dict(zip(names, values, strict=True))

    def potential(self, z: Scalar) -> Float[Array, ""]:
        """The potential at a place along the coordinate, relative to its height."""
        place, shapes = 0.0, self._values
        if self.family.is_placed:
            place, *shapes = shapes
        return self.family.value(shapes, z - place, NUMERIC)

    def force(self, z: Scalar) -> Float[Array, ""]:
        """The force along the coordinate, for unit height [L⁻¹]."""
        return -jax.grad(self.potential)(z)

    @property
    def _values(self) -> tuple[Scalar, ...]:
        maps = {"tail": tail} | dict.fromkeys(PLACES, lambda number: number)
        pairs = zip(self.family.numbers, self.numbers, strict=True)
        return tuple(maps.get(name, jnp.exp)(number) for name, number in pairs)


PLACES = ("place", "middle", "half width", "radius")
"""Constants whose numbers are lengths as they are."""


def tail(form: Scalar) -> Scalar:
    r"""$\kappa$ of a form."""
    return 0.5 * jnp.expm1(form)
