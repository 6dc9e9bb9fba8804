"""Several recipes in turn: what one of them does not fit, the next one tries."""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.dynamics import AbstractDynamics, with_dtype
from pinav.fitting.matching.fit import Recipe, fit_many
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
from pinav.trajectories import Trajectories


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
        others = dict(zip(missed, again, strict=True))
        worse = {i for i, fit in others.items() if _is_worse(fit, fits[i])}
        fits = [
            _join(fit, others.get(i), again[0], keep=i in worse)
            for i, fit in enumerate(fits)
        ]
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

    losses = {
        i: finer_loss(fit)
        for i, fit in enumerate(fits)
        if fit.outcome is Outcome.CONVERGED
    }
    floor = trajectories.num_observed * (FOLLOWED * trajectories.spread) ** 2
    missed = [
        i
        for i, loss in losses.items()
        if not loss <= max(CONFIRMED**2 * fits[i].losses[-1], floor)
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
    after = dict(zip(missed, again, strict=True))
    worse = {i for i, fit in after.items() if not finer_loss(fit) < losses[i]}
    return [
        dataclasses.replace(
            _join(fit, after.get(i), again[0], keep=i in worse),
            initial_model=fit.initial_model,
        )
        for i, fit in enumerate(fits)
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
