r"""Expected information of a trajectory on the force along a way.

A candidate is worth what it leaves unknown: the standard deviation of the force along
the way that is expected after it, by whatever knows the force. From a fit's Laplace
posterior, with covariance $C$ of the parameters, a trajectory that would be observed
with noise $\sigma$ makes $C' = (C^{-1} + J^\top J / \sigma^2)^{-1}$ expected, where $J$
are the derivatives of its samples by the parameters, its start eliminated; what counts
is the mean of the variances on the diagonal of $G C' G^\top$, with the derivatives $G$
of the force along the way.

A fit of few trajectories can be sure of more than it may be: its kernels end not far
from the data, and its evidence may have found that forces fade away from there. Before
one asks where to go next, such certainty is put aside: to the fitted force is added a
Gaussian process, with a potential of mean zero, which fills the arena with forces of a
given strength and is then conditioned on the data.

References:
    MacKay, Neural Computation 4, 590 (1992); Chaloner and Verdinelli, Statistical
    Science 10, 273 (1995).
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from pinav.arguments import Planar, check_positive
from pinav.dynamics import FixedStep, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import Observations, Posterior, ravel_model
from pinav.fitting.engine.local_model import ParametricModel
from pinav.fitting.engine.multiple_shooting import eliminate, linearise, sensitivities
from pinav.forces import KernelPotential, SumForce
from pinav.navigation.design.candidates import (
    CandidateTrajectories,
    CommandedThrust,
    Experiment,
)
from pinav.navigation.task.task import Rectangle
from pinav.trajectories import Trajectories


class PosteriorInformation(eqx.Module):
    """Expected information by the posterior of a fit.

    Attributes:
        free: swimmer as a function of its parameters; commands replace its propulsion.
        root: matrix whose product with its transpose is their covariance.
        way: points along which the force matters [L].
        arena: what they should not leave, as far as the model knows.
    """

    free: ParametricModel
    theta: Float[Array, " parameter"]
    root: Float[Array, "parameter rank"]
    way: Float[Array, "point 2"]
    experiment: Experiment
    arena: Rectangle

    @classmethod
    def of(
        cls,
        posterior: Posterior,
        way: ArrayLike,
        experiment: Experiment,
        arena: Rectangle,
    ) -> "PosteriorInformation":
        """The information on the force along a way, one point a row [L].

        Raises:
            InputError: `way` is no list of points in the plane.
        """
        points = np.asarray(way, float)
        if points.ndim != 2 or points.shape[1] != 2 or not len(points):
            raise InputError(
                "route: expected points in the plane, one a row, got shape "
                f"{points.shape}"
            )
        with jax.enable_x64(new_val=True):
            return cls(
                posterior.free,
                jnp.asarray(posterior.mean),
                jnp.asarray(_root(posterior.covariance)),
                jnp.asarray(points),
                experiment,
                arena,
            )

    @property
    def sd_now(self) -> float:
        """Standard deviation of the force along the way before any candidate."""
        with jax.enable_x64(new_val=True):
            return float(jnp.sqrt(jnp.mean(jnp.sum(_forces(self) ** 2, axis=1))))

    def __call__(self, candidate: CandidateTrajectories) -> float:
        with jax.enable_x64(new_val=True):
            variance, stays = _after(self, candidate)
        return math.sqrt(variance) if stays else math.inf

    def rollout(
        self, candidate: CandidateTrajectories
    ) -> tuple[Float[Array, "time state"], Float[Array, "row rank"]]:
        """States of a candidate, and what it tells: rows in whitened parameters."""
        driven = _with_thrust(self.free, self.experiment.thrust(candidate))
        times, solver = self.experiment.times, FixedStep()
        states, _ = solver.solve(driven(self.theta), candidate.starts, times)
        jacobian = sensitivities(driven, self.theta, states, times, solver)
        rows = jacobian.columns[..., :-1] / self.experiment.noise[None, :, None]
        count = self.theta.shape[0]
        rest, _, _ = eliminate(rows.reshape(-1, rows.shape[2]), count, states.shape[1])
        return states, rest @ self.root


@eqx.filter_jit
def _forces(information: PosteriorInformation) -> Float[Array, "force rank"]:
    """Derivatives of the forces along the way by the whitened parameters."""

    def force(theta: Float[Array, " parameter"], x: Planar) -> Planar:
        return information.free(theta).environment(0.0, x, jnp.zeros_like(x))

    slopes = jax.vmap(jax.jacrev(force), (None, 0))(information.theta, information.way)
    return slopes.reshape(-1, information.theta.shape[0]) @ information.root


@eqx.filter_jit
def _after(
    information: PosteriorInformation, candidate: CandidateTrajectories
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Mean variance of the forces after a candidate; True where it stays inside."""
    states, rows = information.rollout(candidate)
    # The Cholesky factor of the precision of the whitened parameters.
    factor = jnp.linalg.cholesky(jnp.eye(rows.shape[1]) + rows.T @ rows)
    forces = _forces(information)
    left = jax.scipy.linalg.solve_triangular(factor, forces.T, lower=True)
    distances = jax.vmap(information.arena.distance)(states[:, :2])
    stays = jnp.all(distances <= 0) & jnp.all(jnp.isfinite(rows))
    return jnp.mean(jnp.sum(left**2, axis=0)), stays


def _with_thrust(free: ParametricModel, thrust: CommandedThrust) -> ParametricModel:
    """The model as a function of its parameters, its propulsion replaced.

    A learned constant of the old propulsion is then a parameter without effect.
    """

    def propulsion(tree: PyTree) -> PyTree:
        return tree.propulsion

    nothing = jax.tree.map(lambda _: None, thrust)
    static = eqx.tree_at(propulsion, free.static, thrust, is_leaf=lambda x: x is None)

    def unravel(theta: Float[Array, " parameter"]) -> PyTree:
        leaves = free.unravel(theta)
        return eqx.tree_at(propulsion, leaves, nothing, is_leaf=lambda x: x is None)

    return ParametricModel(static, unravel)


def _root(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n rank"]:
    """A matrix whose product with its transpose is the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * max(values[-1], 0.0)
    return vectors[:, kept] * np.sqrt(values[kept])


LENGTHS = 10
"""Length scales along the longer side of an arena, unless one is given."""


class PriorField(eqx.Module):
    """The prior of forces where nobody was.

    Attributes:
        arena: where.
        strength: standard deviation of each component [L T⁻²], positive; forces that
            matter to a swimmer are about as strong as its thrust.
        length: length scale of their potential [L]; a tenth of the arena's longer side
            unless given.

    Raises:
        InputError: `strength` or `length` is not positive.
    """

    arena: Rectangle
    strength: float
    length: float | None = None

    def __check_init__(self) -> None:
        check_positive(self, "strength", "length")

    def kernels(self) -> KernelPotential:
        r"""Kernels whose independent weights make such a process, all zero.

        Weights on a grid of spacing b under kernels of width b make a process of the
        length scale $\sqrt2\, b$.
        """
        lower, upper = np.asarray(self.arena.lower), np.asarray(self.arena.upper)
        length = self.length or float((upper - lower).max()) / LENGTHS
        width = length / math.sqrt(2)
        axes = [
            np.linspace(a - width, b + width, math.ceil((b - a) / width) + 3)
            for a, b in zip(lower, upper, strict=True)
        ]
        centers = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        return KernelPotential.with_zero_weights(centers, width)

    def amplitude(self, kernels: KernelPotential) -> float:
        """Standard deviation of the weights that gives the strength."""
        middle = (self.arena.lower + self.arena.upper) / 2

        def force(weights: Float[Array, " kernel"]) -> Planar:
            filled = eqx.tree_at(lambda k: k.weights, kernels, weights)
            return filled(0.0, middle, jnp.zeros_like(middle))

        slopes = np.asarray(jax.jit(jax.jacfwd(force))(kernels.weights))
        return self.strength / math.sqrt(np.mean(np.sum(slopes**2, axis=1)))


def prior_uncertainty(
    model: Swimmer | OverdampedSwimmer,
    trajectories: Trajectories,
    states: ArrayLike,
    *,
    noise: float,
    prior: PriorField,
    solver: FixedStep | None = None,
) -> Posterior:
    r"""Posterior of a force that is added to a fitted model's environment.

    Its mean is zero: the fit is taken for the best guess. The covariance is
    $(1/a^2 + H/\sigma^2)^{-1}$ with the sum of squares' $H$, starts eliminated.

    Args:
        model: the fitted swimmer.
        trajectories: to which it was fitted.
        states: smoothed states, as of `EvidenceFit.states`.
        noise: $\sigma$ of the observations, positive.
        prior: what forces there may be.
        solver: steps between samples; `FixedStep()` unless given.

    Raises:
        InputError: `noise` is not positive.
    """
    if not noise > 0:
        raise InputError(f"prior_uncertainty noise: expected > 0, got {noise}")
    solver = FixedStep() if solver is None else solver
    with jax.enable_x64(new_val=True):
        kernels = prior.kernels()
        environment = SumForce((model.environment, kernels))
        wider = model.with_environment(environment)
        free, theta = ravel_model(wider, lambda m: m.environment.terms[1].parameters)
        observations = Observations.of(trajectories, jnp.float64)
        linear = linearise(free, theta, jnp.asarray(states), observations, solver)
        amplitude = prior.amplitude(kernels)
    return Posterior(
        free, np.asarray(theta), _weight_covariance(linear.hessian, noise, amplitude)
    )


def _weight_covariance(
    hessian: Float[Array, "n n"], noise: float, amplitude: float
) -> Float[np.ndarray, "n n"]:
    """Covariance of the weights, given the data."""
    values, vectors = np.linalg.eigh(np.asarray(hessian))
    precision = amplitude**-2 + np.maximum(values, 0.0) / noise**2
    return (vectors / precision) @ vectors.T
