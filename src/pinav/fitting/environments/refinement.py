r"""Kernels as fine as the evidence asks for.

A field cannot vary faster than the kernels that it is made of. Where the data want it
to, the evidence drives the length scale $\ell$ of the weights below the width $b$ of a
kernel, and no weights repair the misfit: the kernels are then too coarse. With
$\ell \ge b$ the prior, not the grid, limits the field, and finer kernels change little.
"""

import functools
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.fitting.engine.evidence_fit import EvidenceProgress, iterate
from pinav.fitting.engine.problem import AbstractProblem, Step
from pinav.fitting.environments.kernels import (
    IN_SPACE,
    MOST_WEIGHTS,
    OFTEN,
    KernelGrid,
    finest_kernels,
    num_weights,
    observed_positions,
    surround_with_kernels,
)
from pinav.fitting.evidence.hyperparameter_uncertainty import is_confined
from pinav.fitting.outcome import Outcome
from pinav.forces import AbstractForce, AbstractLearnedForce, as_learned_force
from pinav.forces.priors import Shape
from pinav.trajectories import Trajectories


class Refinement(eqx.Module):
    r"""When kernels are laid anew, closer to each other, and how far that may go.

    Attributes:
        factor: by which their spacing and width shrink.
        shortest: length scale $\ell$ of the prior, in widths, below which kernels are
            too coarse.
        max_weights: weights at most. A step costs the square of their number, the
            search for the shape of their prior the cube.
        envelope: whether kernels are too coarse, too, where the envelope of their prior
            ended at the narrowest that they allow.

    Raises:
        InputError: `factor` is not greater than one, or another number not positive.
    """

    factor: float = 1.5
    shortest: float = 1.0
    max_weights: int = MOST_WEIGHTS
    envelope: bool = False

    def __check_init__(self) -> None:
        for name, least in (("factor", 1), ("shortest", 0), ("max_weights", 0)):
            if not getattr(self, name) > least:
                raise InputError(
                    f"Refinement.{name}: expected > {least}, got {getattr(self, name)}"
                )

    def is_needed(self, environment: AbstractForce, shape: Shape) -> bool:
        """Whether the kernels are too coarse; never without a grid of kernels to learn.

        Args:
            shape: of its prior, as the evidence chose it; empty where its weights were
                known.
        """
        learned = as_learned_force(environment)
        if learned is None or not len(shape):
            return False
        if self.envelope and is_confined(learned.prior(), shape):
            return True
        scales = learned.length_scales(shape)
        return min(scales, default=np.inf) < self.shortest

    def finer(
        self,
        environment: AbstractLearnedForce,
        around: Trajectories | Float[np.ndarray, "place dim"],
    ) -> AbstractLearnedForce | None:
        """The untrained environment on a finer grid; None where it has no room.

        Its kernels are as far apart as they are wide, and reach as far beyond the data
        as those of `KernelGrid()`; where these are too many in space, less far, and
        there are a share `OFTEN` of all at most. The part that changes with time stays
        as it is.

        Args:
            around: data, or places that the kernels surround [L].
        """
        dim, kernels = environment.dim, environment.kernels
        if kernels is None:
            return None
        places = (
            observed_positions(around, dim)
            if isinstance(around, Trajectories)
            else around
        )
        extent = np.ptp(places, axis=0).max()
        grid = KernelGrid(across=round(self.factor * extent / float(kernels.width)))
        made = environment.kernels_on(*surround_with_kernels(places, grid))
        if num_weights(made) <= self.max_weights:
            return made
        if dim < 3:  # in a plane kernels keep how far they reach
            return None
        most = min(self.max_weights, int(OFTEN * MOST_WEIGHTS))
        made = finest_kernels(environment.kernels_on, places, most, IN_SPACE)
        laid = made.kernels
        is_finer = laid and WORTH * float(laid.width) < float(kernels.width)
        return made if is_finer else None


WORTH = 1.1
"""Factor by which the spacing of a grid that is less fine than was asked must be
smaller."""


AS_FINE_AS_ASKED = Refinement()
"""Unless a fit is told otherwise."""

AS_FINE_AS_BUMPS = Refinement(envelope=True)
"""Of thermal fits: few paths about one obstacle leave a prior that is a single bump,
which must be allowed to be narrow."""


def iterate_refined(
    problem: AbstractProblem,
    begin: Callable[..., AbstractProblem],
    refine: Refinement | None,
    trajectories: Trajectories,
    max_iterations: int,
    on_step: Callable[[EvidenceProgress], None] | None = None,
) -> tuple[AbstractProblem, Outcome, list[Step]]:
    """Iterate on kernels as fine as the evidence asks for.

    Each grid begins anew, so that the result is that of its own fit. Where finer
    kernels diverge the fit of the coarser ones goes on from where it was left.

    Args:
        begin: the problem of another model, linearised about given `states`.
        max_iterations: steps at most on each grid.
    """
    environment = problem.parametric.static.environment

    @functools.cache
    def finer() -> AbstractLearnedForce | None:
        return None if refine is None else refine.finer(environment, trajectories)

    def is_coarse(step: Step) -> bool:
        shape = step.hyperparameters.shape
        return refine is not None and refine.is_needed(environment, shape)

    def asks(step: Step) -> bool:
        return is_coarse(step) and finer() is not None

    outcome, steps = iterate(problem, max_iterations, on_step, asks)
    if steps and asks(steps[-1]):
        model = problem.parametric(jnp.asarray(problem.theta))
        model = eqx.tree_at(lambda m: m.environment, model, finer())
        again = begin(model, states=problem.states)
        finest = iterate_refined(
            again, begin, refine, trajectories, max_iterations, on_step
        )
        if finest[1] is not Outcome.DIVERGED:
            return finest
        if outcome is Outcome.STALLED:  # better too smooth than lost
            outcome, steps = iterate(problem, max_iterations, on_step, begun=steps)
    if outcome is Outcome.CONVERGED and is_coarse(steps[-1]):
        outcome = Outcome.UNDER_RESOLVED
    return problem, outcome, steps
