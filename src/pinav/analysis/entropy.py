r"""Entropy production of a steady state, from a learned force and visited places.

With the drift $u = D f$ (less $\nabla\cdot D$) and the density p the current velocity
is $\nu = D (f - \nabla \ln p)$, and entropy is produced at the rate
$\sigma = \langle \nu \cdot D^{-1} \nu \rangle$. In a steady state $p\,\nu$ has no
divergence: it is orthogonal to every gradient in the mean over p. So $\nu$ is what is
left of $D f$ when the nearest gradient is taken away,

$$\sigma = \min_\varphi \langle (f - \nabla\varphi) \cdot D\, (f - \nabla\varphi)
  \rangle,$$

a mean over the samples, without a density and without increments. A gradient that is
fitted to the samples takes too much away, so that the one of each stretch of time is
fitted to all others: $\langle f \cdot D (f - \nabla\varphi)\rangle$ is linear in it.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Vector
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.fitting import Estimate, Posterior
from pinav.forces import KernelProfile, as_learned_force, tensor_matrix
from pinav.forces.kernels import kernel_values

SMALLEST = 1e-6
"""Singular values of the gradients, relative to the largest, that count as zero."""

FOLDS, RIDGE = 5, 1e-3
"""Stretches of time for each of which a potential is fitted to the others; its ridge,
relative to the mean of the normal matrix."""

BLOCKS = 20
"""Stretches of the samples whose scatter is that of the mean over places."""


class EntropyProduction(eqx.Module):
    r"""The part of thermal motion that is out of equilibrium.

    Attributes:
        rate: $\sigma$ [k_B T⁻¹], with the doubt of force, diffusion and places.
        noise: what the doubt of the force alone would give; taken off the rate.
        positions: the samples over which the mean was taken [L].
        current: velocity $\nu$ there [L T⁻¹], of the best force.
    """

    rate: Estimate
    noise: float
    positions: Float[np.ndarray, "sample dim"]
    current: Float[np.ndarray, "sample dim"]

    @property
    def speed(self) -> float:
        """Root mean square of the current velocity [L T⁻¹]."""
        return float(np.sqrt(np.mean(np.sum(self.current**2, axis=-1))))

    @property
    def is_significant(self) -> bool:
        """True if no equilibrium explains the force, at two standard deviations."""
        return self.rate.value > 2 * self.rate.sd


def entropy_production(
    posterior: Posterior,
    positions: Float[np.ndarray, "sample dim"],
    diffusion: Float[np.ndarray, "sample dim"],
    relative_sd: float = 0.0,
) -> EntropyProduction:
    r"""Entropy production of a fit of thermal motion.

    The estimate is quadratic in the force, so that its doubt alone makes some; that is
    taken off, and the rate of a system in equilibrium scatters about zero.

    Args:
        posterior: of an `OverdampedSwimmer` whose force is one of kernels; its drift at
            time zero counts as that of all times.
        positions: samples of the steady state, in the order of time [L].
        diffusion: along each axis there [L² T⁻¹].
        relative_sd: standard deviation of the diffusion, relative to it.

    Raises:
        InputError: the force has no kernels, or there are fewer samples than kernels.

    References:
        Seifert, Rep. Prog. Phys. 75, 126001 (2012); Frishman and Ronceray, Phys. Rev. X
        10, 021009 (2020), for an estimate from increments.
    """
    drifts, mobilities, gradients = _fields(posterior.model, positions)
    count, dim, kernels = gradients.shape
    if count * dim < 2 * kernels:
        raise InputError(
            f"entropy production: expected {2 * kernels // dim} or more samples for "
            f"{kernels} kernels, got {count}; fit more data"
        )
    columns = mobilities @ posterior.force_jacobians(positions)
    roots = np.sqrt(diffusion)[..., None]
    # Rows are those of the square root of D applied to forces: the metric of the mean.
    scaled = roots * gradients
    forces = drifts / roots[..., 0]
    slopes = (columns / roots).reshape(count * dim, -1)
    left, values, _ = np.linalg.svd(scaled.reshape(-1, kernels), full_matrices=False)
    basis = left[:, values > SMALLEST * values[0]]
    # What is left when the nearest gradient is taken away.
    rest, slopes = (
        field - basis @ (basis.T @ field) for field in (forces.reshape(-1, 1), slopes)
    )
    spread = slopes.T @ slopes @ posterior.covariance / count
    gradient = 2 * slopes.T @ rest[:, 0] / count
    shares = _held_out_shares(scaled, forces)
    noise = float(np.trace(spread))
    rate = float(shares.mean()) - noise
    # Samples are correlated: the variance of their mean is that of blocks.
    means = np.array([block.mean() for block in np.array_split(shares, BLOCKS)])
    variance = (
        gradient @ posterior.covariance @ gradient
        + 2 * np.sum(spread * spread.T)
        + means.var(ddof=1) / BLOCKS
        + (relative_sd * rate) ** 2
    )
    return EntropyProduction(
        rate=Estimate(rate, float(np.sqrt(variance))),
        noise=noise,
        positions=positions,
        current=roots[..., 0] * rest.reshape(count, dim),
    )


def _held_out_shares(
    gradients: Float[np.ndarray, "sample dim kernel"],
    forces: Float[np.ndarray, "sample dim"],
) -> Float[np.ndarray, " sample"]:
    """Entropy production of each sample, its potential fitted to other times."""
    shares = []
    stretches = np.array_split(np.arange(len(forces)), FOLDS)
    # Normal equations are sums over the samples: those of a stretch come off the whole.
    parts = [
        (np.einsum("ndk,ndl->kl", part, part), np.einsum("ndk,nd->k", part, force))
        for part, force in ((gradients[k], forces[k]) for k in stretches)
    ]
    whole = [sum(part[i] for part in parts) for i in (0, 1)]
    for stretch, part in zip(stretches, parts, strict=True):
        matrix, right = whole[0] - part[0], whole[1] - part[1]
        matrix += RIDGE * np.trace(matrix) / len(matrix) * np.eye(len(matrix))
        potential = np.linalg.solve(matrix, right)
        rest = forces[stretch] - gradients[stretch] @ potential
        shares.append((forces[stretch] * rest).sum(axis=1))
    return np.concatenate(shares)


def _fields(
    model: OverdampedSwimmer, positions: Float[np.ndarray, "sample dim"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    basis = _scalar_kernels(model)

    def at(x: Vector) -> tuple[Array, Array, Array]:
        mobility = tensor_matrix(model.mobility, x)
        return model(0.0, x), mobility, jax.jacfwd(basis)(x).T

    with jax.enable_x64(new_val=True):
        points = jnp.asarray(positions, jnp.float64)
        drifts, mobilities, gradients = eqx.filter_jit(jax.vmap(at))(points)
    return np.asarray(drifts), np.asarray(mobilities), np.asarray(gradients)


def _scalar_kernels(model: OverdampedSwimmer) -> Callable[[Vector], Array]:
    """Scalar functions on the kernels of a force, whose gradients span potentials."""
    learned = as_learned_force(model.environment)
    if isinstance(learned, KernelProfile):
        return learned.basis
    places = None if learned is None else learned.kernels
    if places is None:
        raise InputError(
            "entropy production: expected a force of kernels, got "
            f"{type(model.environment).__name__}; fit a kernel model"
        )
    centers, width = places.centers, places.width
    return lambda x: kernel_values(x, centers, width)
