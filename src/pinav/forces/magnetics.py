r"""Forces of a static magnetic field that is known as a table, as of coils or magnets.

The field may come from any function of places, such as `getB` of a magpylib source, or
from a measured map.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pinav.arguments import Scalar, Vector, point
from pinav.errors import InputError
from pinav.forces.force import AbstractForce


def _as_values(values: ArrayLike) -> Float[Array, "..."]:
    array = values if isinstance(values, jax.Array) else jnp.asarray(values, float)
    if array.ndim not in (3, 4) or array.shape[-1] != 3 or min(array.shape[:-1]) < 4:
        raise InputError(
            "MagneticFieldTable.values: expected B with three components at 4 or more "
            f"points along each of two or three axes, got shape {array.shape}"
        )
    return array


class MagneticFieldTable(eqx.Module):
    r"""A magnetic field on an equally spaced grid, interpolated by cubic convolution.

    The field and its gradient are continuous. The error of the gradient falls as the
    square of the spacing. A table of two axes is the plane in which a swimmer moves;
    its field has three components all the same. Beyond the last cell but one the field
    continues as a constant, so that no force acts there.

    Attributes:
        lower: first point of the grid [L].
        spacing: between neighbours along each axis [L].
        values: B at the points [T]; the components come last.

    Raises:
        InputError: the values are no such table, or the vectors do not fit to it.

    References:
        Keys, IEEE Trans. Acoust. Speech Signal Process. 29, 1153 (1981), with a = -1/2.
    """

    lower: Vector = eqx.field(converter=point("MagneticFieldTable.lower"))
    spacing: Vector = eqx.field(converter=point("MagneticFieldTable.spacing"))
    values: Float[Array, "..."] = eqx.field(converter=_as_values)

    def __check_init__(self) -> None:
        axes = self.values.ndim - 1
        if self.lower.shape != (axes,) or self.spacing.shape != (axes,):
            raise InputError(
                f"MagneticFieldTable: the values have {axes} axes, but lower and "
                f"spacing have {self.lower.size} and {self.spacing.size} components"
            )

    @classmethod
    def sample(
        cls,
        field: Callable[[Float[np.ndarray, "point 3"]], ArrayLike],
        lower: ArrayLike | Sequence[float],
        upper: ArrayLike | Sequence[float],
        counts: Sequence[int],
        *,
        metre: float = 1.0,
        height: float = 0.0,
    ) -> "MagneticFieldTable":
        """The table of a field that is a function of places.

        For a source or a collection of magpylib, `field` is its `getB`:
        `MagneticFieldTable.sample(magnet.getB, lower, upper, counts, metre=1e6)` where
        lengths are in micrometres.

        Args:
            field: B [T] at places in metres, one a row.
            lower: first corner of the region [L], two or three coordinates.
            upper: the opposite corner [L].
            counts: points along each axis, 4 or more.
            metre: one metre in units of length.
            height: z of a planar table [L].

        Raises:
            InputError: the region is empty, a count is below 4, or the field is not
                finite there, as inside a source.
        """
        low, high, number = np.asarray(lower), np.asarray(upper), np.asarray(counts)
        if low.shape != high.shape or not (high > low).all() or number.min() < 4:
            raise InputError(
                "MagneticFieldTable.sample: expected lower < upper and 4 or more "
                f"points along each axis, got {lower}, {upper} and {counts}"
            )
        along = [np.linspace(*ends) for ends in zip(low, high, number, strict=True)]
        grid = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
        places = np.full((*grid.shape[:-1], 3), float(height))
        places[..., : grid.shape[-1]] = grid
        values = np.asarray(field(places.reshape(-1, 3) / metre), np.float64)
        if values.shape != (places.size // 3, 3) or not np.isfinite(values).all():
            raise InputError(
                "MagneticFieldTable.sample: expected three finite components of B at "
                f"each of {places.size // 3} places, got shape {values.shape} or "
                "values that are not finite; keep the region out of the sources"
            )
        spacing = (high - low) / (number - 1)
        return cls(low, spacing, values.reshape(places.shape))

    def __call__(self, x: Vector) -> Float[Array, "3"]:
        """Magnetic field [T] at a position [L]."""
        values = self.values.astype(x.dtype)
        most = jnp.asarray(values.shape[:-1], x.dtype)
        cells = (x - self.lower.astype(x.dtype)) / self.spacing.astype(x.dtype)
        place = jnp.clip(cells, 1.0, most - 2.0)
        cell = jnp.minimum(jnp.floor(place), most - 3.0)
        corner = cell.astype(int) - 1
        shape = (*(4 for _ in corner), 3)
        start = [*corner, jnp.zeros_like(corner[0])]
        block = jax.lax.dynamic_slice(values, start, shape)
        for weights in cubic_weights(place - cell):
            block = jnp.tensordot(weights, block, 1)
        return block

    def strength(self, x: Vector) -> Scalar:
        """Magnitude of the field [T] at a position [L]."""
        square = jnp.sum(self(x) ** 2)
        # The root has no derivative at 0; without a field there is no pull either.
        return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def cubic_weights(s: Float[Array, " axis"]) -> Float[Array, "axis 4"]:
    """Weights of four neighbours for a place between the inner two, along each axis."""
    return 0.5 * jnp.stack(
        [
            s * (-1 + s * (2 - s)),
            2 + s * s * (-5 + 3 * s),
            s * (1 + s * (4 - 3 * s)),
            s * s * (s - 1),
        ],
        axis=-1,
    )


class DipolePull(AbstractForce):
    r"""Pull $m\,\nabla |B|$ on a permanent dipole that aligns with the field.

    Attributes:
        table: the field $B(x)$.
        moment: $m$, so that $m\,\nabla |B|$ is a force per mass [L² T⁻² per tesla].
    """

    table: MagneticFieldTable
    moment: Scalar

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.moment * jax.grad(self.table.strength)(x)


class InductionPull(AbstractForce):
    r"""Pull $s\,\nabla |B|^2 / 2$ on a body that the field magnetises below saturation.

    For a sphere of volume $V$ and susceptibility $\chi \ll 1$ in a fluid,
    $s = V \chi / \mu_0$ per mass.

    Attributes:
        table: the field $B(x)$.
        susceptibility: $s$ [L² T⁻² per tesla squared].

    References:
        Jackson, Classical Electrodynamics, 3rd ed., section 5.7.
    """

    table: MagneticFieldTable
    susceptibility: Scalar

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        def energy(x: Vector) -> Scalar:
            return 0.5 * jnp.sum(self.table(x) ** 2)

        return self.susceptibility * jax.grad(energy)(x)
