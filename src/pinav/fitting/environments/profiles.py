"""Forces and mobilities of kernels in coordinates of their own, as files keep them."""

import jax.numpy as jnp
import msgspec
import numpy as np

from pinav.errors import InputError
from pinav.forces import (
    AbstractTensorField,
    KernelAxis,
    KernelBasis,
    KernelProfile,
    KernelTensor,
    Warp,
)


class AxisSummary(msgspec.Struct, frozen=True, omit_defaults=True):
    """One coordinate of a basis.

    Attributes:
        index: which component of the position.
        period: after which a field repeats [L].
        warp: origin and scale of a warp [L].
    """

    index: int
    period: float | None = None
    warp: tuple[float, float] | None = None

    @classmethod
    def of(cls, axis: KernelAxis) -> "AxisSummary":
        """The summary of an axis."""
        warp = axis.warp
        pair = None if warp is None else (float(warp.origin), float(warp.scale))
        return cls(axis.index, axis.period, pair)

    def axis(self) -> KernelAxis:
        """The axis."""
        warp = None if self.warp is None else Warp(*self.warp)
        return KernelAxis(self.index, self.period, warp)


class BasisSummary(msgspec.Struct, frozen=True):
    """A basis of kernels.

    Attributes:
        axes: its coordinates.
        spacings: of the kernels along each.
        centers: of the kernels, in spacings.
    """

    axes: tuple[AxisSummary, ...]
    spacings: tuple[float, ...]
    centers: list[list[float]]

    @classmethod
    def of(cls, basis: KernelBasis) -> "BasisSummary":
        """The summary of a basis."""
        axes = tuple(map(AxisSummary.of, basis.axes))
        return cls(axes, basis.spacings, np.asarray(basis.centers).tolist())

    def basis(self) -> KernelBasis:
        """The basis."""
        if not self.axes:
            return KernelBasis.constant()
        axes = tuple(axis.axis() for axis in self.axes)
        return KernelBasis(axes, self.spacings, jnp.asarray(self.centers))


EDITION = 2
"""Of the force that weights mean: until 1 the slope of a warp was no part of it."""


class ProfileSummary(msgspec.Struct, frozen=True):
    """A force along some axes.

    Attributes:
        basis: of its kernels.
        along: the components that are learned.
        edition: what its weights mean, see `EDITION`.
    """

    basis: BasisSummary
    along: tuple[int, ...]
    edition: int = 1

    @classmethod
    def of(cls, profile: KernelProfile) -> "ProfileSummary":
        """The summary of a profile."""
        return cls(BasisSummary.of(profile.basis), profile.along, EDITION)

    def profile(self, dim: int) -> KernelProfile:
        """No force yet, in a space of that dimension.

        Raises:
            InputError: an earlier version wrote it, along a warped coordinate.
        """
        basis = self.basis.basis()
        if basis.is_warped and self.edition < EDITION:
            raise InputError(
                "the force of this run was fitted by an earlier version, in which "
                "weights along a warped coordinate meant another force; fit the data "
                "again"
            )
        return KernelProfile.with_zero_weights(basis, self.along, dim)


class MobilitySummary(msgspec.Struct, frozen=True):
    """A learned mobility.

    Attributes:
        basis: of its kernels.
        groups: axes that share a process.
    """

    basis: BasisSummary
    groups: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, mobility: AbstractTensorField) -> "MobilitySummary | None":
        """The summary of a mobility that was learned; None where it is known."""
        if not isinstance(mobility, KernelTensor):
            return None
        return cls(BasisSummary.of(mobility.basis), mobility.groups)

    def mobility(self) -> KernelTensor:
        """A mobility of one."""
        basis = self.basis.basis()
        shape = len(self.groups), len(basis.centers)
        return KernelTensor(
            jnp.zeros(len(self.groups)), jnp.zeros(shape), basis, self.groups
        )
