r"""The force that the data of a fit leave open, on the whole arena.

A fit of few trajectories can be sure of more than it may be: its kernels end not far
from the data, and its evidence may have found that forces fade away from there. Before
one asks where to go next, such certainty is put aside: to the fitted force is added a
Gaussian process, with a potential of mean zero, which fills the arena with forces of a
given strength and is then conditioned on the data.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pinav.arguments import Planar, check_positive
from pinav.dynamics import FixedStep, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import Observations, Posterior, ravel_model
from pinav.fitting.engine.multiple_shooting import linearise
from pinav.forces import KernelPotential, SumForce
from pinav.navigation.task.zones import Rectangle
from pinav.trajectories import Trajectories

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
