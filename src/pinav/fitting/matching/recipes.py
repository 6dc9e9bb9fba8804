"""Named compositions of phases."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from pinav.dynamics import RK4, FixedStep
from pinav.errors import InputError
from pinav.fitting.matching.gauss_newton import (
    DefectMatching,
    GaussNewton,
    RateMatching,
    Rates,
)
from pinav.fitting.matching.phases import LBFGS, AbstractPhase, Adam
from pinav.trajectories import Trajectories, informative_samples


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
    max_steps: int = 20,
    precision: float = 1e-7,
) -> tuple[AbstractPhase, ...]:
    """Gauss-Newton from one-step matching to the full rollout.

    Windows of 1, 5, 25, ... samples, five times longer in each phase, then the whole
    trajectory. A window is left as soon as the full rollout is within a five-hundredth
    of the spread of the data. Jumping straight to the full rollout creeps: after
    one-step matching it can still be off by more than the data extend.

    Args:
        precision: root-mean-square residual at which the fit ends, in units of the
            spread of the data (rounding and the solver's error set the floor).

    Raises:
        InputError: `max_steps` is not positive.
    """
    if max_steps < 1:
        raise InputError(f"curriculum max_steps: expected >= 1, got {max_steps}")
    last = int(trajectories.lengths.max()) - 1
    windows = [5**power for power in range(20) if 5**power < last]
    spread = trajectories.spread
    steps = [
        GaussNewton(jnp.asarray(w), target=spread / 500, steps=max_steps)
        for w in windows
    ]
    return *steps, _full_rollout(last, spread, precision, max_steps)


def defect_recipe(
    trajectories: Trajectories,
    *,
    rates: Rates | None = None,
    prior_root: Float[np.ndarray, "parameter direction"] | None = None,
    substeps: int = 1,
    max_steps: int = 40,
    precision: float = 3e-8,
    patience: int = 3,
) -> tuple[AbstractPhase, ...]:
    """The default recipe for exact data: propagated defects, then the full rollout.

    A model begins from rates of change at the data and beside them, or, where none are
    given, from the defects of single steps; a model that is linear in its parameters
    needs no more.

    Args:
        rates: of change that the model learns first, such as `rates_to_match`
            makes.
        prior_root: of a model that is linear in its parameters, such as `ForcePrior`
            tells: see `DefectMatching`.
        substeps: of the linearisation, between two samples.
        precision: as that of `curriculum`.
        patience: slow steps in a row after which a phase ends.

    Raises:
        InputError: `max_steps` is not positive, or a state is not observed.
    """
    if max_steps < 1:
        raise InputError(f"defect_recipe max_steps: expected >= 1, got {max_steps}")
    if not is_complete(trajectories):
        raise InputError(
            "defect_recipe: expected every state observed, because each is the start "
            "of a step; choose curriculum"
        )
    last, spread = int(trajectories.lengths.max()) - 1, trajectories.spread

    def match(
        window: int, samples: Int[np.ndarray, "sample 2"] | None
    ) -> DefectMatching:
        return DefectMatching(
            jnp.asarray(window),
            precision * spread,
            samples=None if samples is None else jnp.asarray(samples),
            prior_root=None if prior_root is None else jnp.asarray(prior_root),
            least_damping=0.0 if prior_root is None else (LEAST_RESIDUAL * spread) ** 2,
            damping=FIRST_DAMPING if rates is not None else LINEAR_DAMPING,
            patience=jnp.asarray(patience),
            converged=CONVERGED * spread,
            steps=max_steps,
            linearisation=FixedStep(RK4, substeps),
        )

    if rates is None:
        return match(1, None), match(last, None)
    samples = informative_samples(trajectories, MOST_SAMPLES) - np.array([0, 1])
    steps = STEPS_OF_A_RATE * rates.rates.shape[1]
    return RateMatching(rates, steps, patience), match(last, samples)


def is_complete(trajectories: Trajectories) -> bool:
    """Whether every state of every sample is observed."""
    return all(bool(one.observed.all()) for one in trajectories)


def _full_rollout(
    last: int, spread: float, precision: float, max_steps: int
) -> GaussNewton:
    return GaussNewton(
        jnp.asarray(last),
        target=precision * spread,
        patience=jnp.asarray(3),
        converged=CONVERGED * spread,
        steps=max_steps,
    )


STEPS_OF_A_RATE = 20
"""Steps for each channel of the rates that a network learns, at most."""

FIRST_DAMPING, LINEAR_DAMPING = 1e-2, 1e-7
"""Of the first step, and that of a model that is linear in its parameters."""

LEAST_RESIDUAL = 1e-7
"""Of a step from exact data, in units of their spread, that a prior takes for noise."""

MOST_SAMPLES = 300
"""Samples whose errors a network is trained on at once, at most: with fewer, its error
between them stays."""

CONVERGED = 1e-4
"""Residual of a full rollout that counts as converged, in units of the spread."""
