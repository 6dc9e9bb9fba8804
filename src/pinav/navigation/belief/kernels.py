r"""Kernels that stand for an unknown force, in any dimension.

The force is $F(x) = B(x) w$ with Gaussians $\varphi_j(x) = e^{-|x - c_j|^2 / 2 b^2}$ on
a grid of spacing b, which stands for a Gaussian process of the length scale
$\ell = \sqrt 2\, b$. Weights are independent at first, $w \sim N(0, a^2)$.
"""

import abc
import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

REACH = 4.0
"""Widths b beyond which a kernel is not felt: there it is 3e-4 of its height."""

Points = Float[np.ndarray, "point dim"]
"""Positions [L]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Local:
    """The kernels about a position.

    Attributes:
        weights: indices of their weights.
        basis: B, the force of a unit of each weight there.
        slope: dB/dx, by component of the force, of the position, and weight.
    """

    weights: Int[np.ndarray, " near"]
    basis: Float[np.ndarray, "dim near"]
    slope: Float[np.ndarray, "dim dim near"]


@dataclasses.dataclass(frozen=True, eq=False)
class KernelGrid:
    """Centres of kernels over a box and three of their widths beyond.

    Attributes:
        lower: first centre [L].
        width: b, spacing of the centres and width of the kernels [L].
    """

    lower: Float[np.ndarray, " dim"]
    width: float
    shape: tuple[int, ...]

    @classmethod
    def over(
        cls,
        lower: Float[np.ndarray, " dim"],
        upper: Float[np.ndarray, " dim"],
        length_scale: float,
    ) -> "KernelGrid":
        """The grid for forces of a length scale in a box [L]."""
        width = length_scale / math.sqrt(2)
        cells = np.ceil((upper - lower) / width - 1e-9).astype(int)
        first = (lower + upper) / 2 - width * (cells / 2 + 3)
        return cls(first, width, tuple(int(n) + 7 for n in cells))

    @property
    def size(self) -> int:
        """Number of centres."""
        return math.prod(self.shape)

    @functools.cached_property
    def axes(self) -> list[Float[np.ndarray, " centre"]]:
        """Coordinates of the centres along each axis [L]."""
        return [
            first + self.width * np.arange(n)
            for first, n in zip(self.lower, self.shape, strict=True)
        ]

    @functools.cached_property
    def centres(self) -> Float[np.ndarray, "centre dim"]:
        """All centres [L], the last axis fastest."""
        return np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(
            self.size, len(self.shape)
        )

    @functools.cached_property
    def strides(self) -> Int[np.ndarray, " dim"]:
        """Distance of neighbours along each axis in the list of all centres."""
        count = len(self.shape)
        return np.array([math.prod(self.shape[k + 1 :]) for k in range(count)])

    @functools.cached_property
    def neighbours(self) -> tuple[Int[np.ndarray, "dim cell"], Int[np.ndarray, " _"]]:
        """Cells around one, as steps along the axes and in the list of all centres."""
        span = range(-int(REACH), int(REACH) + 1)
        steps = np.array(list(itertools.product(span, repeat=len(self.shape)))).T
        nearest = np.maximum(np.abs(steps) - 0.5, 0)
        steps = steps[:, np.sum(nearest**2, axis=0) < REACH**2]
        return steps, self.strides @ steps

    def near(
        self, x: Float[np.ndarray, " dim"]
    ) -> tuple[Int[np.ndarray, " near"], Float[np.ndarray, "dim near"]]:
        """Centres within reach of a position, and its offset from each, in widths."""
        place = (x - self.lower) / self.width
        nearest = np.rint(place)
        steps, jumps = self.neighbours
        offsets = (place - nearest)[:, None] - steps
        inside = (offsets * offsets).sum(axis=0) <= REACH**2
        for k, count in enumerate(self.shape):
            first = int(nearest[k])
            if first < REACH or first >= count - REACH:  # near the edge of the grid
                inside &= (steps[k] >= -first) & (steps[k] < count - first)
        return jumps[inside] + int(nearest @ self.strides), offsets[:, inside]


@dataclasses.dataclass(frozen=True, eq=False)
class AbstractKernels(abc.ABC):
    """A kind of force, as kernels on a grid."""

    grid: KernelGrid

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """Number of weights."""

    @abc.abstractmethod
    def at(self, x: Float[np.ndarray, " dim"]) -> Local:
        """The kernels about a position [L]."""

    @abc.abstractmethod
    def basis(self, points: Points) -> Float[np.ndarray, "point dim weight"]:
        """Force of a unit of every weight at many positions [L]."""

    @abc.abstractmethod
    def on_axes(
        self,
        axes: Sequence[Float[np.ndarray, " _"]],
        weights: Float[np.ndarray, "... weight"],
    ) -> Float[np.ndarray, "... dim"]:
        """Force at the points of a lattice, axis by axis."""


@dataclasses.dataclass(frozen=True, eq=False)
class PotentialKernels(AbstractKernels):
    r"""$F = -\nabla \sum_j w_j b\, \varphi_j$: no work is done on a closed way."""

    @property
    def size(self) -> int:
        return self.grid.size

    @property
    def gain(self) -> float:
        """Standard deviation of each component for weights of the deviation one."""
        steps = np.arange(-8.0, 9.0)
        plain = np.sum(np.exp(-(steps**2)))
        sloped = np.sum(steps**2 * np.exp(-(steps**2)))
        return math.sqrt(sloped * plain ** (len(self.grid.shape) - 1))

    def at(self, x: Float[np.ndarray, " dim"]) -> Local:
        index, offset = self.grid.near(x)
        height = np.exp(-0.5 * (offset * offset).sum(axis=0))
        basis = offset * height
        slope = -offset[:, None] * basis[None]
        for k in range(len(offset)):
            slope[k, k] += height
        return Local(index, basis, slope / self.grid.width)

    def basis(self, points: Points) -> Float[np.ndarray, "point dim weight"]:
        offset = _offsets(points, self.grid)
        return offset * np.exp(-0.5 * np.sum(offset**2, axis=1, keepdims=True))

    def on_axes(
        self,
        axes: Sequence[Float[np.ndarray, " _"]],
        weights: Float[np.ndarray, "... weight"],
    ) -> Float[np.ndarray, "... dim"]:
        plain, sloped = _profiles(axes, self.grid)
        heights = weights.reshape(*weights.shape[:-1], *self.grid.shape)
        parts = []
        for k in range(len(axes)):
            profiles = [sloped[i] if i == k else plain[i] for i in range(len(axes))]
            parts.append(_along_axes(profiles, heights))
        return np.stack(parts, axis=-1)


@dataclasses.dataclass(frozen=True, eq=False)
class FreeKernels(AbstractKernels):
    r"""$F_k = \sum_j w_{kj} \varphi_j$: components of their own, as currents have."""

    @property
    def size(self) -> int:
        return self.grid.size * len(self.grid.shape)

    @property
    def gain(self) -> float:
        """Standard deviation of each component for weights of the deviation one."""
        steps = np.arange(-8.0, 9.0)
        return math.sqrt(np.sum(np.exp(-(steps**2))) ** len(self.grid.shape))

    def at(self, x: Float[np.ndarray, " dim"]) -> Local:
        index, offset = self.grid.near(x)
        dim, count = offset.shape
        height = np.exp(-0.5 * (offset * offset).sum(axis=0))
        fall = -offset * height / self.grid.width
        basis = np.zeros((dim, dim, count))
        slope = np.zeros((dim, dim, dim, count))
        for k in range(dim):
            basis[k, k], slope[k, :, k] = height, fall
        weights = np.concatenate([index + k * self.grid.size for k in range(dim)])
        return Local(weights, basis.reshape(dim, -1), slope.reshape(dim, dim, -1))

    def basis(self, points: Points) -> Float[np.ndarray, "point dim weight"]:
        offset = _offsets(points, self.grid)
        height = np.exp(-0.5 * np.sum(offset**2, axis=1))
        return np.stack([np.kron(row, height) for row in np.eye(offset.shape[1])], 1)

    def on_axes(
        self,
        axes: Sequence[Float[np.ndarray, " _"]],
        weights: Float[np.ndarray, "... weight"],
    ) -> Float[np.ndarray, "... dim"]:
        plain, _ = _profiles(axes, self.grid)
        heights = weights.reshape(*weights.shape[:-1], len(axes), *self.grid.shape)
        forces = _along_axes(plain, heights)
        return np.moveaxis(forces, -1 - len(axes), -1)


def _offsets(points: Points, grid: KernelGrid) -> Float[np.ndarray, "point dim centre"]:
    """Offsets of positions from all centres, in widths."""
    return (points[:, :, None] - grid.centres.T[None]) / grid.width


def _profiles(
    axes: Sequence[Float[np.ndarray, " _"]], grid: KernelGrid
) -> tuple[list[Float[np.ndarray, "_ _"]], list[Float[np.ndarray, "_ _"]]]:
    """Kernels along each axis, and with the offset as a factor."""
    offsets = [
        (along[:, None] - centres[None]) / grid.width
        for along, centres in zip(axes, grid.axes, strict=True)
    ]
    plain = [np.exp(-0.5 * offset**2) for offset in offsets]
    return plain, [o * p for o, p in zip(offsets, plain, strict=True)]


def _along_axes(
    profiles: Sequence[Float[np.ndarray, "_ _"]], heights: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    """Sums over the kernels, one of the last axes after the other."""
    first = heights.ndim - len(profiles)
    for k, profile in enumerate(profiles):
        heights = np.moveaxis(
            np.tensordot(profile, heights, (1, first + k)), 0, first + k
        )
    return heights
