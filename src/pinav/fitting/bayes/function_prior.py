r"""A Gaussian process as the prior of a network: over its forces, not its weights.

Weights of a network mean nothing by themselves, so that a prior of one variance for all
of them says little of the force and makes bands far too wide. Here the forces at many
places have the prior of kernels, $f \sim N(0, B B^\top + V)$, with $B$ the independent
directions of the process and $V = \mathrm{diag}(v)$ what the network is off from any
of its fields. About weights $\theta_0$ the network is linear,
$V^{-1/2} f = V^{-1/2} f_0 + U g$ with $V^{-1/2} J = U S W^\top$ and
$\delta\theta = W S^{-1} g$, which makes the prior one of $g$, with the precision and
the linear term

$$P = U^\top C^{-1} U, \quad c = U^\top C^{-1} V^{-1/2} f_0, \quad
  C = I + V^{-1/2} B B^\top V^{-1/2}.$$

Directions of the weights that change no force are left where they are.

References:
    Khan, Immer, Abedi and Korzepa, NeurIPS 2019, networks as processes in their
    tangent space; Cinquin, Pfoertner, Fortuin, Hennig and Bamler, FSP-Laplace, NeurIPS
    2024, a Laplace posterior under a prior of functions.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.fitting.bayes.distillation import DistillationTargets, forces
from pinav.fitting.engine.local_model import (
    ParametricModel,
    ravel_model,
    selected_entries,
)
from pinav.fitting.evidence.evidence import Hyperparameters, root
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import AbstractWeights, Inference, WeightPosterior
from pinav.fitting.matching.damped_steps import low_rank
from pinav.forces import AbstractLearnedForce
from pinav.forces.priors import AbstractPrior, Matrix, Shape

RANK = 256
"""Tangent directions kept."""

NEIGHBOURS = 16
"""Places over which the misfit of a network is averaged."""

LEAST_MISFIT = 1e-5
"""Least misfit that is reckoned with, relative to the forces of the prior."""


class Process(eqx.Module):
    """The prior of a kernel environment, by the forces of its directions.

    Terms beside the kernels are linear in their weights, but not in their geometry. Of
    that they are linear about where it is, with its wide prior; the data narrow it.

    Attributes:
        kernels: what the process is made of; weights matter only beside a geometry.
        directions: $B$; `directions @ directions.T` is the covariance of the forces.
        shapes: changes of the forces by one standard deviation of the prior's shape.
    """

    kernels: AbstractLearnedForce
    directions: Float[np.ndarray, "force direction"]
    shapes: Float[np.ndarray, "force shape"]
    chosen: Hyperparameters

    @classmethod
    def of(
        cls,
        kernels: AbstractLearnedForce,
        prior: AbstractPrior,
        chosen: Hyperparameters,
        places: DistillationTargets,
        shapes: Float[np.ndarray, "weight shape"],
    ) -> "Process":
        """The process of these kernels at given places.

        Args:
            kernels: an environment that is linear in its weights, fitted where it has a
                geometry.
            shapes: changes of the weights by a standard deviation of the shape.
        """
        free, theta = ravel_model(kernels, lambda force: force.trainable)
        slopes = np.asarray(_slopes(free, theta, places))
        count = len(theta)
        is_shaping = selected_entries(free, count, lambda force: force.geometry)
        deviations = np.ones(count)
        for index, scale in enumerate(kernels.geometry_scales):
            leaf = selected_entries(free, count, lambda f, i=index: f.geometry[i])
            deviations[leaf] = scale
        bends = (slopes * deviations)[:, is_shaping]
        straight = slopes[:, ~is_shaping]
        columns = chosen.amplitude * root(prior.covariance(chosen.shape))
        directions = np.column_stack([straight @ columns, bends])
        return cls(kernels, directions, straight @ shapes, chosen)

    def nearest(
        self, values: Float[np.ndarray, " force"]
    ) -> Float[np.ndarray, " force"]:
        """The field of the process that explains most of `values`.

        What it does not explain counts as independent; its variance has the highest
        likelihood.
        """
        basis, scale, _ = np.linalg.svd(self.directions, full_matrices=False)
        along, variances = basis.T @ values, scale**2
        rest, others = values @ values - along @ along, len(values) - len(along)

        def loss(log_variance: float) -> float:
            variance = np.exp(log_variance)
            total = variances + variance
            squares = along @ (along / total) + max(rest, 0.0) / variance
            return squares + np.log(total).sum() + others * log_variance

        from scipy.optimize import minimize_scalar

        largest = np.log(np.sum(variances) / len(values))
        bounds = (largest + 2 * np.log(LEAST_MISFIT), largest + 2.0)
        optimum = minimize_scalar(loss, bounds=bounds, method="bounded")
        kept = variances / (variances + np.exp(optimum.x))
        return basis @ (kept * along)


class TangentWeights(AbstractWeights):
    """Weights of a network whose forces have the prior of a process.

    Attributes:
        point: weights about which it is linear.
        places: where its forces are compared.
        misfit: standard deviation of each force about the process.
    """

    free: ParametricModel
    point: Float[np.ndarray, " weight"]
    places: DistillationTargets
    process: Process
    misfit: Float[np.ndarray, " force"]

    @classmethod
    def of(
        cls,
        network: AbstractLearnedForce,
        places: DistillationTargets,
        process: Process,
        wanted: Float[np.ndarray, " force"],
    ) -> "TangentWeights":
        """About a network that comes near a field of the process.

        What it is off counts as independent from place to place. But it is as smooth
        as the tangent directions of the network, of which there are fewer than places;
        its variance is raised by that ratio.

        Args:
            wanted: the field's forces there.
        """
        from scipy.spatial import KDTree

        free, point = ravel_model(network, lambda force: force.parameters)
        values = np.asarray(forces(network, places.times, places.positions))
        off = values - wanted.reshape(values.shape)
        positions = np.asarray(places.positions)
        count = min(NEIGHBOURS, len(positions))
        near = KDTree(positions).query(positions, k=count)[1].reshape(-1, count)
        smooth = len(wanted) / min(RANK, len(point), len(wanted))
        variance = smooth * np.mean(off**2, axis=1)[near].mean(axis=1)
        least = LEAST_MISFIT**2 * np.sum(process.directions**2) / len(wanted)
        misfit = np.sqrt(np.repeat(variance + least, off.shape[1]))
        return cls(free, np.asarray(point), places, process, misfit)

    @property
    def start(self) -> Shape:
        return self.process.chosen.shape

    def about(self, weights: Float[np.ndarray, " weight"]) -> "AbstractWeights":
        return eqx.tree_at(lambda own: own.point, self, weights)

    def energy(self, weights: Float[np.ndarray, " weight"]) -> float:
        network = self.free(jnp.asarray(weights))
        values = forces(network, self.places.times, self.places.positions)
        scaled = np.asarray(values).ravel() / self.misfit
        return float(scaled @ self._unlikely(scaled))

    def ridge(self, chosen: Hyperparameters) -> float:
        return 0.0

    def posterior(
        self, quadratic: Quadratic, chosen: Hyperparameters
    ) -> WeightPosterior:
        inference = self.infer(quadratic, chosen.shape, chosen.noise)
        return inference.mean, inference.covariance

    def infer(
        self, quadratic: Quadratic, shape: Shape, noise: float | None
    ) -> Inference:
        tangent, chosen = self._tangent(), self.process.chosen
        steps = tangent.steps
        hessian = steps.T @ quadratic.hessian @ steps / chosen.noise**2
        gradient = steps.T @ quadratic.gradient / chosen.noise**2
        factor = scipy.linalg.cho_factor(hessian + tangent.precision)
        change = -scipy.linalg.cho_solve(factor, gradient + tangent.linear)
        covariance = scipy.linalg.cho_solve(factor, np.eye(len(change)))
        off = change + np.linalg.solve(tangent.precision, tangent.linear)
        squares = quadratic.squares / chosen.noise**2
        squares += float(off @ tangent.precision @ off)  # from the mean of the prior
        squares += 2 * gradient @ change + change @ hessian @ change
        log_evidence = -0.5 * (
            quadratic.num_free * np.log(2 * np.pi * chosen.noise**2)
            + squares
            + 2 * np.log(np.diag(factor[0])).sum()
            - np.linalg.slogdet(tangent.precision).logabsdet
            + quadratic.log_determinant
        )
        corrected = eqx.tree_at(lambda c: c.log_evidence, chosen, float(log_evidence))
        mean = self.point + steps @ change
        return Inference(corrected, mean, steps @ covariance @ steps.T)

    def shape_covariance(
        self, quadratic: Quadratic, chosen: Hyperparameters, noise: float | None
    ) -> Matrix:
        tangent = self._tangent()
        changes = tangent.steps @ (
            tangent.forces.T @ (self.process.shapes / self.misfit[:, None])
        )
        return changes @ changes.T

    def _unlikely(
        self, scaled: Float[np.ndarray, "force ..."]
    ) -> Float[np.ndarray, "force ..."]:
        r"""$C^{-1}$ times scaled forces."""
        reach = self.process.directions / self.misfit[:, None]
        inner = np.eye(reach.shape[1]) + reach.T @ reach
        return scaled - reach @ np.linalg.solve(inner, reach.T @ scaled)

    def _tangent(self) -> "_Tangent":
        theta = jnp.asarray(self.point)
        slopes = _slopes(self.free, theta, self.places)
        left, scale, right = low_rank(slopes / self.misfit[:, None], RANK)
        left, scale, right = (np.asarray(part) for part in (left, scale, right))
        kept = scale > LEAST_SLOPE * scale[0]
        left, steps = left[:, kept], right[:, kept] / scale[kept]
        network = self.free(theta)
        values = np.asarray(forces(network, self.places.times, self.places.positions))
        unlikely = self._unlikely(np.column_stack([left, values.ravel() / self.misfit]))
        both = left.T @ unlikely
        return _Tangent(left, steps, (both[:, :-1] + both[:, :-1].T) / 2, both[:, -1])


LEAST_SLOPE = 1e-4
"""Tangent directions weaker than this, relative to the strongest, are left alone: the
network is not linear over the long way that its weights would have to go."""


class _Tangent(eqx.Module):
    """A network about a point, and its prior there."""

    forces: Float[np.ndarray, "force tangent"]
    steps: Float[np.ndarray, "weight tangent"]
    precision: Float[np.ndarray, "tangent tangent"]
    linear: Float[np.ndarray, " tangent"]


@eqx.filter_jit
def _slopes(
    free: ParametricModel,
    theta: Float[Array, " parameter"],
    places: DistillationTargets,
) -> Float[Array, "force parameter"]:
    def force(theta: Float[Array, " parameter"], t: Scalar, x: Vector) -> Vector:
        return free(theta)(t, x, jnp.zeros_like(x))

    slopes = jax.vmap(jax.jacrev(force), (None, 0, 0))
    jacobian = slopes(theta, places.times, places.positions)
    return jacobian.reshape(-1, theta.shape[0])
