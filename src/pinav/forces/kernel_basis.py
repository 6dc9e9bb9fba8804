r"""Gaussian kernels in coordinates of their own: some axes alone, periodic or warped.

A field may depend on a height alone, on an angle, or vary faster near a wall than far
from it. The kernels then lie on a regular grid of other coordinates u(x), in which
their width and spacing is one: they have no unit.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Vector, check_positive
from pinav.errors import InputError
from pinav.forces.kernels import kernel_values


class Warp(eqx.Module):
    r"""Coordinate $\operatorname{asinh}((x - x_0)/s)$: fine near a place.

    Attributes:
        origin: $x_0$ [L], about which the coordinate is finest.
        scale: $s$ [L], the distance from there up to which it is linear; positive.

    Raises:
        InputError: `scale` is a number <= 0.
    """

    origin: float
    scale: float

    def __check_init__(self) -> None:
        check_positive(self, "scale")


class KernelAxis(eqx.Module):
    r"""One coordinate on which a field depends.

    A periodic coordinate becomes a point on a circle, so that distances, kernels and
    their prior are periodic too.

    Attributes:
        index: which component of the position it is.
        period: after which the field repeats; None where it does not.
        warp: where the kernels are finer; None where they are alike everywhere.

    Raises:
        InputError: `period` is a number <= 0, or there is a warp too.
    """

    index: int = eqx.field(static=True, default=0)
    period: float | None = None
    warp: Warp | None = None

    def __check_init__(self) -> None:
        if self.period is not None:
            check_positive(self, "period")
            if self.warp is not None:
                raise InputError(
                    "KernelAxis: expected a period or a warp, got both; a periodic "
                    "coordinate has no place where it begins"
                )

    def coordinate(self, x: Float[Array, "*place"]) -> Float[Array, "*place"]:
        """The coordinate [L], or without unit where it is warped."""
        if self.warp is None:
            return x
        return jnp.arcsinh((x - self.warp.origin) / self.warp.scale)

    def slope(self, x: Float[Array, ""]) -> Float[Array, ""]:
        """Slope of the coordinate, relative to that at the origin of a warp."""
        if self.warp is None:
            return jnp.ones_like(x)
        return 1 / jnp.hypot(1.0, (x - self.warp.origin) / self.warp.scale)

    def embed(self, x: Float[Array, ""], spacing: float) -> Float[Array, " embedded"]:
        """The coordinate in spacings of the kernels: one number, or two on a circle."""
        if self.period is None:
            return (self.coordinate(x) / spacing)[None]
        angle = 2 * jnp.pi * x / self.period
        radius = self.period / (2 * jnp.pi * spacing)
        return radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


class KernelBasis(eqx.Module):
    r"""Basis functions $\exp(-|u(x) - c_j|^2 / 2)$.

    Attributes:
        axes: the coordinates; none for a field that is the same everywhere.
        spacings: of the kernels along each of them, in its unit.
        centers: $c_j$, in spacings.
    """

    axes: tuple[KernelAxis, ...]
    spacings: tuple[float, ...]
    centers: Float[Array, "kernel embedded"]

    @classmethod
    def constant(cls) -> "KernelBasis":
        """No kernels: for a field that is the same everywhere."""
        return cls((), (), jnp.zeros((0, 0)))

    @classmethod
    def around(
        cls,
        axes: tuple[KernelAxis, ...],
        positions: Float[np.ndarray, "sample dim"],
        *,
        across: int = 24,
        margin: int = 4,
    ) -> "KernelBasis":
        """Kernels on a regular grid around observed positions.

        Args:
            axes: on which the field depends.
            positions: observed [L].
            across: kernels around the period, or intervals across the longest extent
                of the coordinates; a warped coordinate has an extent of its own.
            margin: intervals beyond the data that hold kernels.

        Raises:
            InputError: `across` or `margin` is too small, an axis is not there, or
                positions are all the same along the axes.
        """
        if across < 3 or margin < 1:
            raise InputError(
                "KernelBasis.around: expected across >= 3 and margin >= 1, got "
                f"{across} and {margin}"
            )
        spacings = _spacings(axes, positions, across)
        grids = [
            _grid(axis, spacing, positions[:, axis.index], across, margin)
            for axis, spacing in zip(axes, spacings, strict=True)
        ]
        centers = grids[0]
        for grid in grids[1:]:
            first = np.repeat(centers, len(grid), axis=0)
            centers = np.hstack([first, np.tile(grid, (len(centers), 1))])
        if len(axes) > 1:
            everywhere = cls(axes, spacings, jnp.asarray(centers))
            centers = _near(everywhere, positions, margin)
        return cls(axes, spacings, jnp.asarray(centers))

    @property
    def is_warped(self) -> bool:
        """Whether a coordinate is warped."""
        return any(axis.warp is not None for axis in self.axes)

    def coordinates(self, x: Vector) -> Float[Array, " embedded"]:
        """The coordinates $u(x)$ of a position [L], in spacings."""
        if not self.axes:
            return jnp.zeros((0,), x.dtype)
        parts = [
            axis.embed(x[axis.index], spacing)
            for axis, spacing in zip(self.axes, self.spacings, strict=True)
        ]
        return jnp.concatenate(parts)

    def __call__(self, x: Vector) -> Float[Array, " kernel"]:
        """Value of each kernel at a position [L]."""
        return kernel_values(self.coordinates(x), self.centers, 1.0)


def _spacings(
    axes: tuple[KernelAxis, ...],
    positions: Float[np.ndarray, "sample dim"],
    across: int,
) -> tuple[float, ...]:
    """Spacing of the kernels along each axis, in its unit."""
    for axis in axes:
        if not 0 <= axis.index < positions.shape[1]:
            raise InputError(
                f"KernelAxis.index: expected 0 to {positions.shape[1] - 1}, one for "
                f"each coordinate, got {axis.index}"
            )
    extents = [np.ptp(_coordinate(a, positions[:, a.index])) for a in axes]
    plain = [
        extent
        for axis, extent in zip(axes, extents, strict=True)
        if axis.warp is None and axis.period is None
    ]
    spacings = []
    for axis, extent in zip(axes, extents, strict=True):
        if axis.period is not None:
            spacings.append(float(axis.period) / across)
        else:
            spacings.append(float(extent if axis.warp else max(plain)) / across)
    if not all(spacing > 0 for spacing in spacings):
        raise InputError(
            "KernelBasis.around: expected two or more different positions along its "
            "axes"
        )
    return tuple(spacings)


def _coordinate(
    axis: KernelAxis, values: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, " sample"]:
    with jax.enable_x64(new_val=True):
        return np.asarray(axis.coordinate(jnp.asarray(values)))


def _grid(
    axis: KernelAxis,
    spacing: float,
    values: Float[np.ndarray, " sample"],
    across: int,
    margin: int,
) -> Float[np.ndarray, "place embedded"]:
    """Places of kernels along one axis, in spacings."""
    if axis.period is not None:
        angles = 2 * np.pi * np.arange(across) / across
        return across / (2 * np.pi) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    places = _coordinate(axis, values) / spacing
    count = int(np.ceil(np.ptp(places))) + 2 * margin + 1
    middle = (places.min() + places.max()) / 2
    return (middle + np.arange(count) - (count - 1) / 2)[:, None]


def _near(
    basis: KernelBasis,
    positions: Float[np.ndarray, "sample dim"],
    margin: int,
) -> Float[np.ndarray, "_ embedded"]:
    """The centres of a basis within a margin of any sample."""
    from scipy.spatial import KDTree

    with jax.enable_x64(new_val=True):
        places = np.asarray(jax.vmap(basis.coordinates)(jnp.asarray(positions)))
    centers = np.asarray(basis.centers)
    return centers[KDTree(places).query(centers)[0] < margin]
