"""Named compositions of phases."""

import jax.numpy as jnp
import numpy as np

from pinav.errors import InputError
from pinav.fitting.matching.distillation import Distillation, Rates
from pinav.fitting.matching.gauss_newton import GaussNewton
from pinav.fitting.matching.phases import LBFGS, AbstractPhase, Adam
from pinav.trajectories import Trajectories


def paper_recipe(
    adam_steps: int = 7500, lbfgs_steps: int = 500
) -> tuple[AbstractPhase, ...]:
    """The paper's two phases: Adam at 0.01, then L-BFGS.

    Args:
        adam_steps: 7500 in the paper.
        lbfgs_steps: 500 in the paper.

    References:
        PI-NAV paper, Table 1.
    """
    return Adam(learning_rate=1e-2, steps=adam_steps), LBFGS(steps=lbfgs_steps)


def curriculum(
    trajectories: Trajectories,
    *,
    rates: Rates | None = None,
    max_steps: int = 20,
    precision: float = 1e-7,
) -> tuple[AbstractPhase, ...]:
    """The default recipe: Gauss-Newton from one-step matching to the full rollout.

    Windows of 1, 5, 25, ... samples, five times longer in each phase, then the whole
    trajectory. A window is left as soon as the full rollout is within a five-hundredth
    of the spread of the data. Jumping straight to the full rollout creeps: after
    one-step matching it can still be off by more than the data extend.

    Args:
        trajectories: their length and spread set windows and tolerances.
        rates: of change from which the model is distilled before its first rollout,
            such as `distillation_rates` makes.
        max_steps: steps of each phase at most.
        precision: root-mean-square residual at which the fit ends, in units of the
            spread of the data (rounding and the solver's error set the floor).

    Raises:
        InputError: `max_steps` is not positive.
    """
    if max_steps < 1:
        raise InputError(f"curriculum max_steps: expected >= 1, got {max_steps}")
    last = int(trajectories.lengths.max()) - 1
    windows = [5**power for power in range(20) if 5**power < last]
    values = trajectories.states[trajectories.observed]
    spread = float(np.std(values)) or 1.0
    first: tuple[AbstractPhase, ...] = () if rates is None else (Distillation(rates),)
    steps = [
        GaussNewton(jnp.asarray(w), target=spread / 500, steps=max_steps)
        for w in windows
    ]
    full = GaussNewton(
        jnp.asarray(last),
        target=precision * spread,
        patience=jnp.asarray(3),
        converged=CONVERGED * spread,
        steps=max_steps,
    )
    return *first, *steps, full


CONVERGED = 1e-4
"""Residual of a full rollout that counts as converged, in units of the spread."""
