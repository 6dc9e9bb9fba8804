"""Named compositions of phases, and several of them in turn."""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.arguments import on_device
from pinav.dynamics import RK4, AbstractDynamics, FixedStep, with_dtype
from pinav.errors import InputError
from pinav.fitting.matching.fit import Recipe, fit_many
from pinav.fitting.matching.gauss_newton import (
    DefectMatching,
    GaussNewton,
    RateMatching,
    Rates,
)
from pinav.fitting.matching.phases import LBFGS, AbstractPhase, Adam
from pinav.fitting.matching.state import (
    AbstractCheckpoint,
    AbstractObjective,
    Fit,
    FitProgress,
    Observations,
    Trainable,
    split_trainable,
)
from pinav.fitting.outcome import CONFIRMED, Outcome
from pinav.settings import MAX_STEPS
from pinav.trajectories import Trajectories, informative_samples


def paper_recipe(
    adam_steps: int = 7500, lbfgs_steps: int = 500
) -> tuple[AbstractPhase, ...]:
    """The paper's two phases: Adam at 0.01, then L-BFGS.

    References:
        PI-NAV paper, Table 1.
    """
    return Adam(learning_rate=1e-2, steps=adam_steps), LBFGS(steps=lbfgs_steps)


def curriculum(
    trajectories: Trajectories, *, max_steps: int = MAX_STEPS, precision: float = 1e-7
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
    last = int(trajectories.lengths.max()) - 1
    windows = [5**power for power in range(20) if 5**power < last]
    spread = trajectories.spread
    steps = [
        GaussNewton(jnp.asarray(w), target=spread / 500, steps=max_steps)
        for w in windows
    ]
    whole = GaussNewton(
        jnp.asarray(last),
        target=precision * spread,
        patience=jnp.asarray(3),
        converged=CONVERGED * spread,
        steps=max_steps,
    )
    return *steps, whole


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


STEPS_OF_A_RATE = 20
"""Steps for each channel of the rates that a network learns, at most."""

FIRST_DAMPING, LINEAR_DAMPING = 1e-2, 1e-7
"""Of the first step, and that of a model that is linear in its parameters."""

LEAST_RESIDUAL = 1e-7
"""Of a step from exact data, in units of their spread, that a prior takes for noise."""

MOST_SAMPLES = 300
"""Samples whose rates or errors a network is trained on at once, at most: with fewer,
its error between them stays."""

CONVERGED = 1e-4
"""Residual of a full rollout that counts as converged, in units of the spread."""


def fit_in_turns(
    models: Sequence[AbstractDynamics],
    trajectories: Trajectories,
    recipes: Sequence[Recipe],
    *,
    trainable: Trainable,
    objective: AbstractObjective | None = None,
    dtype: type = jnp.float32,
    checkpoint: AbstractCheckpoint | None = None,
    on_chunk: Callable[[FitProgress], None] | None = None,
) -> list[Fit]:
    """Fit several models; those that do not converge begin anew by the next recipe.

    A later attempt begins with the entries of each matrix of weights in another order,
    which is another draw of a network and leaves kernels without weights as they are.
    Of the attempts at a model the one with the smallest loss is kept. The loss curves
    of all models are those of all attempts, one after the other.

    Args:
        recipes: in the order in which they are tried, one or more.
        checkpoint: of the first recipe; later ones begin anew after an interruption.
    """
    options = {"trainable": trainable, "objective": objective, "dtype": dtype}
    fits = fit_many(
        models,
        trajectories,
        recipes[0],
        checkpoint=checkpoint,
        on_chunk=on_chunk,
        **options,
    )
    for number, recipe in enumerate(recipes[1:]):
        missed = [i for i, fit in enumerate(fits) if fit.outcome not in ENDED]
        if not missed:
            break
        chosen = [_shuffle(models[i], trainable, number) for i in missed]
        again = fit_many(chosen, trajectories, recipe, on_chunk=on_chunk, **options)
        fits = _keep_better(fits, dict(zip(missed, again, strict=True)), _is_worse)
    return fits


ENDED = (Outcome.CONVERGED, Outcome.COMPLETED)
"""Outcomes of fits that begin no other recipe."""


def fit_with_finer_steps(
    fits: Sequence[Fit],
    trajectories: Trajectories,
    recipe: Recipe,
    *,
    trainable: Trainable,
    objective: AbstractObjective,
    dtype: type = jnp.float32,
    on_chunk: Callable[[FitProgress], None] | None = None,
) -> list[Fit]:
    """Fit on where rollouts of finer steps do not follow the data.

    A network can learn an edge between two steps of its solver, which the fit's own
    rollouts do not meet. Such a fit goes on from where it ended, and is kept if it
    follows the data better then, by finer steps.

    Args:
        fits: those that converged are looked at.
        objective: the loss by finer steps than those of the fits.
    """
    with jax.enable_x64(jnp.dtype(dtype) == jnp.float64):
        observations = Observations.of(trajectories, dtype)

    def finer_loss(fit: Fit) -> float:
        with jax.enable_x64(jnp.dtype(dtype) == jnp.float64):
            model = with_dtype(fit.model, dtype)
            return float(_loss(objective, model, observations))

    floor = trajectories.num_observed * (FOLLOWED * trajectories.spread) ** 2
    missed = [
        i
        for i, fit in enumerate(fits)
        if fit.outcome is Outcome.CONVERGED
        and not finer_loss(fit) <= max(CONFIRMED**2 * fit.losses[-1], floor)
    ]
    if not missed:
        return list(fits)
    again = fit_many(
        [fits[i].model for i in missed],
        trajectories,
        recipe,
        trainable=trainable,
        objective=objective,
        dtype=dtype,
        on_chunk=on_chunk,
    )
    kept = _keep_better(
        fits,
        dict(zip(missed, again, strict=True)),
        lambda after, before: not finer_loss(after) < finer_loss(before),
    )
    return [
        dataclasses.replace(one, initial_model=fit.initial_model)
        for one, fit in zip(kept, fits, strict=True)
    ]


FOLLOWED = 1e-5
"""Residual of finer rollouts that is no reason to fit on, in units of the spread."""


@eqx.filter_jit
def _loss(
    objective: AbstractObjective, model: AbstractDynamics, observations: Observations
) -> Float[Array, ""]:
    return objective(model, observations)


def _shuffle(
    model: AbstractDynamics, trainable: Trainable, seed: int
) -> AbstractDynamics:
    """The model with the entries of each trainable matrix in another order."""
    trained, fixed = split_trainable(model, trainable, jnp.float64)
    rng = np.random.default_rng(seed)

    def reorder(leaf: Array) -> Array:
        if leaf.ndim < 2:
            return leaf
        return on_device(rng.permuted(np.ravel(leaf)).reshape(leaf.shape))

    return eqx.combine(jax.tree.map(reorder, trained), fixed)


def _is_worse(after: Fit, before: Fit) -> bool:
    lower = bool(after.losses[-1] <= before.losses[-1])
    return not lower and bool(np.isfinite(before.losses[-1]))


def _keep_better(
    fits: Sequence[Fit], again: dict[int, Fit], is_worse: Callable[[Fit, Fit], bool]
) -> list[Fit]:
    """The better of two attempts at some of the fits, and the others as they are."""
    example = next(iter(again.values()))
    return [
        _join(fit, again.get(i), example, keep=i in again and is_worse(again[i], fit))
        for i, fit in enumerate(fits)
    ]


def _join(before: Fit, after: Fit | None, example: Fit, *, keep: bool) -> Fit:
    """One of two attempts, with the losses of both.

    A model that was fitted already keeps its last loss over the steps of the others.

    Args:
        after: the second; None where there was none.
        example: a second attempt, of any model.
    """
    taken = len(before.losses)
    phases = tuple((name, taken + start) for name, start in example.phases)
    if after is None:
        chosen, losses = before, np.full(len(example.losses), before.losses[-1])
    else:
        chosen, losses = (before if keep else after), after.losses.copy()
        losses[-1] = chosen.losses[-1]
    return dataclasses.replace(
        chosen,
        losses=np.concatenate([before.losses, losses]),
        phases=(*before.phases, *phases),
    )
