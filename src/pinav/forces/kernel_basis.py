r"""Gaussian kernels in coordinates of their own, and forces and tensors made of them.

A field may depend on a height alone, on an angle, or vary faster near a wall than far
from it. The kernels then lie on a regular grid of other coordinates u(x), in which
their width and spacing is one: they have no unit.

`KernelProfile` is a force along some axes that depends on others, or on the same;
`KernelTensor` a positive tensor with the coordinate axes as principal ones.
"""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, Vector, check_positive
from pinav.errors import InputError
from pinav.forces.force import AbstractLearnedForce
from pinav.forces.kernels import KernelForce, kernel_values
from pinav.forces.priors import AbstractPrior, Centers, MixturePrior, StationaryPrior
from pinav.forces.tensors import AbstractTensorField


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
        corners = itertools.product(*grids)
        centers = np.array([np.concatenate(parts) for parts in corners])
        basis = cls(axes, spacings, jnp.asarray(centers))
        return basis if len(axes) == 1 else basis._near(positions, margin)

    def _near(
        self, positions: Float[np.ndarray, "sample dim"], margin: int
    ) -> "KernelBasis":
        """The kernels that are within a margin, in spacings, of a position."""
        from scipy.spatial import KDTree

        with jax.enable_x64(new_val=True):
            places = np.asarray(jax.vmap(self.coordinates)(jnp.asarray(positions)))
        is_near = KDTree(places).query(np.asarray(self.centers))[0] < margin
        return KernelBasis(self.axes, self.spacings, self.centers[is_near])

    @property
    def num_parts(self) -> int:
        """Parts of a force on these kernels: two where a coordinate is warped.

        A potential that changes as much from one to two layers above a wall as from
        ten to twenty pulls far harder near the wall: kernels of one amplitude would
        flatten it there, and a potential alone a weight, which is the same everywhere.
        """
        return 2 if any(axis.warp is not None for axis in self.axes) else 1

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
    for axis in axes:
        if not 0 <= axis.index < positions.shape[1]:
            raise InputError(
                f"KernelAxis.index: expected 0 to {positions.shape[1] - 1}, one for "
                f"each coordinate, got {axis.index}"
            )
    extents = [np.ptp(_coordinate(a, positions[:, a.index])) for a in axes]
    pairs = list(zip(axes, extents, strict=True))
    is_plain = [axis.warp is None and axis.period is None for axis in axes]
    longest = max(itertools.compress(extents, is_plain), default=0.0)
    lengths = [
        axis.period or (extent if axis.warp else longest) for axis, extent in pairs
    ]
    spacings = tuple(float(length) / across for length in lengths)
    if not all(spacing > 0 for spacing in spacings):
        raise InputError(
            "KernelBasis.around: expected two or more different positions along its "
            "axes"
        )
    return spacings


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
    if axis.period is not None:
        angles = 2 * np.pi * np.arange(across) / across
        return across / (2 * np.pi) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    places = _coordinate(axis, values) / spacing
    count = int(np.ceil(np.ptp(places))) + 2 * margin + 1
    middle = (places.min() + places.max()) / 2
    return (middle + np.arange(count) - (count - 1) / 2)[:, None]


class KernelProfile(AbstractLearnedForce):
    r"""Force $F_i(x) = \sum_j w_{ji} \phi_j(x)$ along some axes, zero along the others.

    On a ring `along` is (0,) and the basis periodic; above a wall `along` is (2,) and
    the basis that of the height alone. Where a coordinate u(x) is warped there is a
    second part, $s_i(x_i) \sum_j w'_{ji} \phi_j(x)$, with the slope s of u relative to
    that at its origin: a potential in u. The evidence chooses the shares of both.

    Attributes:
        weights: $w_{ji}$, and $w'_{ji}$ below, what trains [F].
        basis: $\phi_j$; fixed.
        along: the components of the force that are learned.

    Raises:
        InputError: shapes disagree, or a component is not there.
    """

    weights: Float[Array, "kernel component"]
    basis: KernelBasis
    along: tuple[int, ...] = eqx.field(static=True)
    space: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        if not self.along or not all(0 <= i < self.space for i in self.along):
            raise InputError(
                "KernelProfile.along: expected one or more components from 0 to "
                f"{self.space - 1}, got {self.along}"
            )
        rows = self.basis.num_parts * len(self.basis.centers)
        if self.weights.shape[0] != rows:
            raise InputError(
                f"KernelProfile.weights: expected {rows} rows, one for each kernel and "
                f"part, got {self.weights.shape[0]}"
            )

    @classmethod
    def with_zero_weights(
        cls, basis: KernelBasis, along: tuple[int, ...], space: int
    ) -> "KernelProfile":
        """No force yet."""
        shape = basis.num_parts * len(basis.centers), len(along)
        return cls(jnp.zeros(shape), basis, along, space)

    @property
    def parameters(self) -> PyTree:
        return self.weights

    @property
    def dim(self) -> int:
        return self.space

    @property
    def periods(self) -> dict[int, float]:
        axes = self.basis.axes
        return {axis.index: axis.period for axis in axes if axis.period is not None}

    def prior(self) -> AbstractPrior:
        part = StationaryPrior(self.basis.centers, 1.0, len(self.along))
        return part if self.basis.num_parts == 1 else MixturePrior(part, part)

    def kernels_on(self, centers: Centers, width: float) -> KernelForce:
        """A free force: other places have no coordinates of their own."""
        return KernelForce.with_zero_weights(centers, width)

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        values = self.basis(x)
        if self.basis.num_parts == 1:
            along = values @ self.weights
        else:
            even, in_potential = jnp.split(self.weights, 2)
            slopes = {axis.index: axis.slope(x[axis.index]) for axis in self.basis.axes}
            one = jnp.ones((), x.dtype)
            scale = jnp.stack([slopes.get(i, one) for i in self.along])
            along = values @ even + scale * (values @ in_potential)
        return jnp.zeros_like(x).at[np.array(self.along)].set(along)


class KernelTensor(AbstractTensorField):
    r"""Tensor $\exp(m_g + \sum_j w_{gj} \phi_j(x))$ along the axes of each group.

    Axes of one group share a process: two groups are what a plane wall asks for,
    (0, 1) parallel to it and (2,) normal to it.

    Attributes:
        levels: $m_g$, logarithms of the tensor's unit.
        weights: $w_{gj}$.
        basis: $\phi_j$.

    Raises:
        InputError: an axis belongs to no group, or to two.
    """

    levels: Float[Array, " group"]
    weights: Float[Array, "group kernel"]
    basis: KernelBasis
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_groups("KernelTensor.groups", self.groups)

    def logarithms(self, x: Vector) -> Float[Array, " group"]:
        """Logarithm of the tensor along the axes of each group."""
        return self.levels + self.weights @ self.basis(x)

    def diagonal(self, x: Vector) -> Vector:
        """The tensor along each axis at a position [L]."""
        return jnp.exp(self.logarithms(x))[self.group_of_axis]

    @property
    def group_of_axis(self) -> np.ndarray:
        """The group to which each axis belongs."""
        pairs = [(axis, g) for g, axes in enumerate(self.groups) for axis in axes]
        return np.array([group for _, group in sorted(pairs)])

    def scale_by(self, factor: float) -> "KernelTensor":
        """The tensor times a positive number."""
        levels = self.levels + jnp.log(jnp.asarray(factor, self.levels.dtype))
        return KernelTensor(levels, self.weights, self.basis, self.groups)

    def __call__(self, x: Vector, vector: Vector) -> Vector:
        return self.diagonal(x) * vector

    def factor(self, x: Vector, vector: Vector) -> Vector:
        return jnp.sqrt(self.diagonal(x)) * vector


def check_groups(name: str, groups: tuple[tuple[int, ...], ...]) -> None:
    """Refuse groups that do not hold every axis once."""
    axes = sorted(axis for group in groups for axis in group)
    if not axes or axes != list(range(len(axes))):
        raise InputError(
            f"{name}: expected every axis from 0 on in one group, such as "
            f"((0, 1), (2,)), got {groups}"
        )
