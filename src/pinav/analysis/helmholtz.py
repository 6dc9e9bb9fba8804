r"""Helmholtz split of a planar force: a gradient part and a rotational part.

$F \approx -\nabla U + \nabla^\perp \psi$ with $\nabla^\perp = (\partial_y,
-\partial_x)$ and a potential $U$ and a stream function $\psi$ made of Gaussians on a
grid. Their weights are those of least squares on the region near the data, with a
small ridge: what lies elsewhere, and the edge of the map, have no say.

A field that is both a gradient and rotational there (harmonic: a constant force, a
saddle) is ambiguous on any bounded region. The ridge shares it equally. How much that
matters is told by two orthogonal projections: on the gradients alone, so that all
harmonic fields count as gradients (least rotational fraction: what no potential
explains), and on the rotational fields alone (greatest).

References:
    Bhatia, Norgard, Pascucci and Bremer, IEEE TVCG 19, 1386 (2013), a survey; Fuselier
    and Wright, IMA J. Numer. Anal. 37, 774 (2017), radial basis functions.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray
from numpy.linalg import norm

from pinav.errors import InputError
from pinav.evaluation import FieldMap
from pinav.fitting import ParametricModel, Posterior
from pinav.forces import (
    KernelForce,
    KernelPotential,
    KernelStream,
    forces_at,
    kernel_centers,
)

ACROSS, WIDTH, MARGIN = 18, 1.5, 2.0
"""Gaussians along the map, no closer than two grid points; their width, and how far
they reach beyond the region, in spacings."""

RIDGE = 1e-9
"""Penalty of the weights, relative to the largest eigenvalue of the normal matrix."""


class HelmholtzSplit(eqx.Module):
    r"""A force as the sum of a gradient, a rotational part and a small misfit.

    Attributes:
        gradient: $-\nabla U$ on the grid of the map [L T⁻²].
        rotational: $\nabla^\perp\psi$ there [L T⁻²].
        potential: $U$ [L² T⁻²]; its least value on the region is zero.
        stream: $\psi$ [L² T⁻²].
        rotational_fraction: $|F_r|^2 / (|F_g|^2 + |F_r|^2)$, sums over the region.
        least_fraction: rotational fraction where harmonic fields are all gradients.
        greatest_fraction: rotational fraction where they are all rotational.
        misfit: relative L2 norm of what neither part explains, over the region.
    """

    DERIVED: ClassVar = ("gradient_fraction",)

    gradient: Float[np.ndarray, "rows columns 2"]
    rotational: Float[np.ndarray, "rows columns 2"]
    potential: Float[np.ndarray, "rows columns"]
    stream: Float[np.ndarray, "rows columns"]
    region: Bool[np.ndarray, "rows columns"]
    rotational_fraction: float
    least_fraction: float
    greatest_fraction: float
    misfit: float

    @property
    def gradient_fraction(self) -> float:
        """One less the rotational fraction."""
        return 1.0 - self.rotational_fraction


def helmholtz_split(field: FieldMap) -> HelmholtzSplit:
    """Split a force into its gradient and its rotational part, near the data.

    Raises:
        InputError: no force is known on the region, or it is zero there.
    """
    region = _region(field, field.force)
    basis = _Basis.of(field, region)
    force = field.force[region]
    parts = _ridge(np.concatenate(basis.near, axis=1), force.ravel())
    gradient, rotational = basis.sums(basis.everywhere, parts)
    potential, stream = basis.sums((basis.values, basis.values), parts)
    least, greatest = basis.bounds(force)
    return HelmholtzSplit(
        gradient=gradient,
        rotational=rotational,
        potential=potential - potential[region].min(),
        stream=stream,
        region=region,
        rotational_fraction=_fraction(gradient[region], rotational[region]),
        least_fraction=least,
        greatest_fraction=greatest,
        misfit=float(norm(force - (gradient + rotational)[region]) / norm(force)),
    )


def rotational_fractions(
    field: FieldMap, forces: Float[np.ndarray, "sample rows columns 2"]
) -> Float[np.ndarray, " sample"]:
    """Rotational fraction of each of several forces, such as draws of a posterior.

    Args:
        forces: one force a row [L T⁻²].

    Raises:
        InputError: no force is known on the region, or one is zero there.
    """
    region = _region(field, forces)
    basis = _Basis.of(field, region)
    columns = forces[:, region].reshape(len(forces), -1).T
    weights = _ridge(np.concatenate(basis.near, axis=1), columns)
    parts = [basis.sums(basis.everywhere, column) for column in weights.T]
    return np.array([_fraction(one[region], two[region]) for one, two in parts])


def sample_forces(
    posterior: Posterior, field: FieldMap, count: int, *, key: PRNGKeyArray
) -> Float[np.ndarray, "sample rows columns 2"]:
    """Forces on the grid of a map, of models drawn from a posterior, at time zero."""
    with jax.enable_x64(new_val=True):
        draws = posterior.draws(count, key=key)
        forces = _forces(posterior.free, draws, field.points)
    return np.asarray(forces).reshape(count, *field.force.shape)


@eqx.filter_jit
def _forces(
    free: ParametricModel,
    draws: Float[Array, "sample parameter"],
    points: Float[ArrayLike, "point 2"],
) -> Float[Array, "sample point 2"]:
    def one(theta: Float[Array, " parameter"]) -> Float[Array, "point 2"]:
        times = jnp.zeros(jnp.shape(points)[:1])
        return forces_at(free(theta).environment, times, points)

    return jax.lax.map(one, draws)


def _region(
    field: FieldMap, forces: Float[np.ndarray, "*sample rows columns 2"]
) -> Bool[np.ndarray, "rows columns"]:
    reach = field.regions.near
    finite = np.isfinite(forces).all(axis=-1)
    region = (field.distance <= reach) & finite.reshape(-1, *field.distance.shape).all(
        axis=0
    )
    if region.sum() < 3:
        raise InputError(
            f"helmholtz_split field: no finite force within {reach:g} of a sample; "
            "draw the map around the data"
        )
    if not forces[..., region, :].any(axis=(-2, -1)).all():
        raise InputError(
            "helmholtz_split field: the force is zero near the data; there is "
            "nothing to split"
        )
    return region


Forces = Float[np.ndarray, "rows columns 2 kernel"]
"""Force of each kernel of weight one at each point."""


class _Basis(eqx.Module):
    """Gaussians on a grid: the forces that they make, and the normal matrix."""

    values: Float[np.ndarray, "rows columns kernel"]
    everywhere: tuple[Forces, Forces]
    near: tuple[Float[np.ndarray, "row kernel"], Float[np.ndarray, "row kernel"]]

    @classmethod
    def of(cls, field: FieldMap, region: Bool[np.ndarray, "rows columns"]) -> "_Basis":
        points = np.stack(np.meshgrid(field.x, field.y), axis=-1)
        extent = max(np.ptp(field.x), np.ptp(field.y))
        step = extent / (max(region.shape) - 1)
        spacing = max(extent / ACROSS, 2.0 * step)
        centers = kernel_centers(
            points[region], spacing=spacing, margin=MARGIN * spacing
        )
        width = WIDTH * spacing
        offsets = points[:, :, None] - centers
        values = KernelForce.kernel_forces(offsets, width)[..., 0]
        gradients, rotations = (
            np.moveaxis(kind.kernel_forces(offsets, width), -1, -2)
            for kind in (KernelPotential, KernelStream)
        )
        near = gradients[region], rotations[region]
        rows, others = (part.reshape(-1, len(centers)) for part in near)
        return cls(values, (gradients, rotations), (rows, others))

    def sums(
        self,
        kernels: tuple[np.ndarray, np.ndarray],
        weights: Float[np.ndarray, " weight"],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Kernels of both parts, each times its half of the weights."""
        first, second = np.split(weights, 2)
        return kernels[0] @ first, kernels[1] @ second

    def bounds(self, force: Float[np.ndarray, "near 2"]) -> tuple[float, float]:
        """Rotational fraction left by all gradients, and by no rotation."""
        total = norm(force) ** 2
        missed = [
            norm(force.ravel() - rows @ _ridge(rows, force.ravel())) ** 2
            for rows in self.near
        ]
        return float(missed[0] / total), float(1.0 - missed[1] / total)


def _ridge(
    rows: Float[np.ndarray, "row kernel"], force: Float[np.ndarray, "row ..."]
) -> Float[np.ndarray, "kernel ..."]:
    normal = rows.T @ rows
    largest = scipy.linalg.eigvalsh(normal, subset_by_index=[len(normal) - 1] * 2)[0]
    normal[np.diag_indices_from(normal)] += RIDGE * largest
    factor = scipy.linalg.cho_factor(normal, lower=True, overwrite_a=True)
    return scipy.linalg.cho_solve(factor, rows.T @ force)


def _fraction(
    gradient: Float[np.ndarray, "near 2"], rotational: Float[np.ndarray, "near 2"]
) -> float:
    squares = norm(gradient) ** 2, norm(rotational) ** 2
    return float(squares[1] / sum(squares))
