r"""`fit_langevin`: an environment from paths that thermal noise kicks.

Without inertia $dX = (u + M F)\,dt + \sqrt{2D}\,dW$. From one observation to the next
an increment is nearly normal about the drift (Euler and Maruyama): divided by
$\sqrt{\Delta t}$, all have the variance 2D, and kernels are linear in their weights. So
the evidence chooses prior and diffusion as `fit_bayes` chooses prior and noise.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import (
    AbstractDynamics,
    BrownianSwimmer,
    OverdampedSwimmer,
    with_dtype,
)
from pinav.errors import InputError
from pinav.fitting.bayes.parameters import learned_environment
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.engine.problem import Step
from pinav.fitting.engine.steps import FullStep
from pinav.fitting.environments.kernels import check_size
from pinav.fitting.environments.refinement import (
    AS_FINE_AS_ASKED,
    Refinement,
    iterate_refined,
)
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.least_squares import Regression
from pinav.trajectories import Trajectories


class Increments(eqx.Module):
    r"""Displacements between observed samples that follow one another; as residuals.

    Attributes:
        times: at the start of each [T].
        positions: there [L].
        steps: displacement [L].
        intervals: duration [T].
        counts: how many each trajectory has.
    """

    times: Float[np.ndarray, " increment"]
    positions: Float[np.ndarray, "increment dim"]
    steps: Float[np.ndarray, "increment dim"]
    intervals: Float[np.ndarray, " increment"]
    counts: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, trajectories: Trajectories) -> "Increments":
        """All increments; one spans the gap where samples are missing.

        Raises:
            InputError: no trajectory has two samples with all positions observed.
        """
        parts = []
        for piece in trajectories:
            seen = piece.observed.all(axis=1)
            times, positions = piece.times[seen], piece.states[seen]
            row = times[:-1], positions[:-1], np.diff(positions, axis=0), np.diff(times)
            parts.append(row)
        times, positions, steps, intervals = map(
            np.concatenate, zip(*parts, strict=True)
        )
        if not len(times):
            raise InputError(
                "fit_langevin trajectories: expected two or more samples with all "
                "positions observed in one of them, got none"
            )
        counts = tuple(len(part[0]) for part in parts)
        return cls(times, positions, steps, intervals, counts)

    @property
    def log_determinant(self) -> float:
        r"""$\log\det$ of the change from residuals to displacements."""
        return float(np.log(self.intervals).sum() * self.steps.shape[1])

    def in_time(
        self, residuals: Float[np.ndarray, " residual"]
    ) -> list[Float[np.ndarray, "_ channel"]]:
        """Residuals of each trajectory in the order of time."""
        rows = residuals.reshape(len(self.times), -1)
        return np.split(rows, np.cumsum(self.counts)[:-1])

    def __call__(self, model: OverdampedSwimmer) -> Float[Array, " residual"]:
        r"""Residuals $(\text{drift}\,\Delta t - \Delta x) / \sqrt{\Delta t}$."""
        root = jnp.sqrt(jnp.asarray(self.intervals))[:, None]
        drift = jax.vmap(model)(jnp.asarray(self.times), jnp.asarray(self.positions))
        return (drift * root - jnp.asarray(self.steps) / root).reshape(-1)


def fit_langevin(
    model: AbstractDynamics,
    trajectories: Trajectories,
    *,
    diffusion: float | None = None,
    refine: Refinement | None = AS_FINE_AS_ASKED,
) -> EvidenceFit:
    r"""Fit the force, and the diffusion coefficient, to stochastic paths.

    The likelihood is that of Euler and Maruyama's scheme with one step from sample to
    sample: intervals must be short against the time in which the force changes. Its
    bias in D is about $\Delta t\,\partial(MF)/\partial x$, relative. Positions must be
    exact against $\sqrt{2 D \Delta t}$: a localisation error $s$ is not modelled, and
    adds about $s^2/\Delta t$ to D. Diffusion is one number: isotropic and the same
    everywhere. Times may be irregular and samples missing.

    Args:
        model: an `OverdampedSwimmer`, or a `BrownianSwimmer` that has one; its
            environment is made of kernels, its mobility turns velocities into forces.
        trajectories: their channels are the positions.
        diffusion: $D$ [L² T⁻¹] where it is known; estimated unless given.
        refine: when kernels turn out too coarse, and finer ones are laid; None keeps
            them.

    Raises:
        InputError: the model is none of these, its environment is not linear in its
            weights, the channels are not its positions, there are no increments, or
            `diffusion` is not positive.

    References:
        Frishman and Ronceray, Phys. Rev. X 10, 021009 (2020); Kloeden and Platen,
        Numerical Solution of Stochastic Differential Equations (1992).
    """
    swimmer = _first_order_swimmer(model, trajectories, diffusion)
    increments = Increments.of(trajectories)
    noise = None if diffusion is None else float(np.sqrt(2 * diffusion))

    def begin(model: OverdampedSwimmer, states: None = None) -> Regression:
        environment: Any = model.environment
        return Regression.of(
            without_weights(model),
            increments,
            weights=lambda m: m.environment.parameters,
            weights_prior=GaussianWeights(environment.prior()),
            noise=noise,
            step_rule=FullStep(),
            is_linear=True,
            log_determinant=increments.log_determinant,
        )

    with jax.enable_x64(new_val=True):
        problem = begin(with_dtype(swimmer, jnp.float64))
        ended = iterate_refined(problem, begin, refine, trajectories, max_iterations=1)
        fit = evidence_fit(*ended, not_finite=NOT_FINITE, advice={})
    return eqx.tree_at(
        lambda f: f.constants, fit, {"diffusion": _diffusion(ended[2][-1], diffusion)}
    )


NOT_FINITE = "its drift is not finite at the observed positions; check the known forces"


def without_weights(model: OverdampedSwimmer) -> OverdampedSwimmer:
    """The model with an environment whose weights are zero.

    The regression is linear: it is solved about zero, where no digits cancel.
    """
    environment: Any = model.environment
    zeros = jax.tree.map(jnp.zeros_like, environment.parameters)
    return eqx.tree_at(lambda m: m.environment.parameters, model, zeros)


def _diffusion(step: Step, known: float | None) -> Estimate:
    """Diffusion from the noise; its deviation from the degrees of freedom left."""
    if known is not None:
        return Estimate(known, 0.0)
    variance = step.hyperparameters.noise**2
    left = max(step.quadratic.num_free - step.num_determined, 1.0)
    return Estimate(variance / 2, variance / 2 * float(np.sqrt(2 / left)))


def _first_order_swimmer(
    model: AbstractDynamics, trajectories: Trajectories, diffusion: float | None
) -> OverdampedSwimmer:
    swimmer = model.swimmer if isinstance(model, BrownianSwimmer) else model
    if not isinstance(swimmer, OverdampedSwimmer):
        raise InputError(
            "fit_langevin model: expected a swimmer without inertia, got "
            f"{type(model).__name__}; for Swimmer use fit_bayes"
        )
    environment = learned_environment(swimmer)
    if environment is None or not environment.is_linear:
        raise InputError(
            "fit_langevin model: expected an environment made by kernel_environment, "
            f"got {type(swimmer.environment).__name__}"
        )
    check_size(environment)
    dim = environment.dim
    if len(trajectories.channels) != dim:
        raise InputError(
            f"fit_langevin trajectories: expected {dim} channels, positions alone, got "
            f"{', '.join(trajectories.channels)}"
        )
    if diffusion is not None and not 0 < diffusion < np.inf:
        raise InputError(
            f"fit_langevin diffusion: expected a finite number > 0, got {diffusion}; "
            "leave it out to estimate it"
        )
    return swimmer
