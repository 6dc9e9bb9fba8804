"""Laws that the profiles of a fit may follow, with numbers that are fitted."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.forces.formulas import NUMERIC, symbolic, symbols
from pinav.forces.profiles import FITTED, AbstractProfile


class FittedLaw(eqx.Module):
    r"""A law of a term: a profile with numbers of its own, which are fitted.

    A profile of kernels knows nothing where no swimmer went. Many fields follow a
    formula of a size and a form, which the data on one flank of a hill tell of the
    other flank. Beside the formula the kernels of the profile stay: they carry what it
    cannot.

    Attributes:
        name: in `FITTED`.
        numbers: of each constant the number without bounds, as its profile states.
    """

    name: str = eqx.field(static=True)
    numbers: tuple[Scalar, ...]

    @property
    def family(self) -> AbstractProfile:
        """Its profile."""
        return FITTED[self.name]

    @property
    def latex(self) -> str:
        """Its formula for unit height, as SymPy prints it."""
        import sympy

        z, place = sympy.symbols("z z_0", real=True)
        shapes = symbols(self.family.shapes)
        z = z - place if self.family.is_placed else z
        return sympy.latex(self.family.value(shapes, z, symbolic()))

    @property
    def scales(self) -> tuple[float, ...]:
        """Prior standard deviation of each number."""
        size = float(self.size)
        reaches = (number.reach for number in self.family.numbers)
        return tuple(1.0 if reach is None else reach * size for reach in reaches)

    @property
    def size(self) -> Scalar:
        """Distance over which it falls [L]."""
        numbers = zip(self.family.numbers, self.numbers, strict=True)
        return jnp.exp(next(value for kind, value in numbers if kind.reach is None))

    def constants(self, offset: Scalar = 0.0) -> dict[str, Scalar]:
        """The constants as tables name them, the place shifted by an offset [L]."""
        first, *rest = self._values
        first = first + offset if self.family.is_placed else first
        names = (number.name for number in self.family.numbers)
        return dict(zip(names, (first, *rest), strict=True))

    @property
    def dimensions(self) -> tuple[str, ...]:
        """The dimension of each constant."""
        place = ("L",) if self.family.is_placed else ()
        return (*place, *(shape.unit for shape in self.family.shapes))

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
        numbers = zip(self.family.numbers, self.numbers, strict=True)
        return tuple(kind.constant(number) for kind, number in numbers)
