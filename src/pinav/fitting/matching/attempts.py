"""Several recipes in turn: what one of them does not fit, the next one tries."""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pinav.arguments import on_device
from pinav.dynamics import AbstractDynamics
from pinav.fitting.matching.fit import Recipe, fit_many
from pinav.fitting.matching.objectives import AbstractObjective
from pinav.fitting.matching.state import AbstractCheckpoint, Fit, FitProgress
from pinav.fitting.matching.trainable import Trainable, split_trainable
from pinav.fitting.outcome import Outcome
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
        models: starts of the fit.
        trajectories: what is observed.
        recipes: in the order in which they are tried, one or more.
        trainable: see `fit_many`, as the other arguments.
        objective: what is minimised.
        dtype: precision of the fit.
        checkpoint: of the first recipe; later ones begin anew after an interruption.
        on_chunk: called after each chunk of steps.
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
        fits = [_join(fit, others.get(i), again[0]) for i, fit in enumerate(fits)]
    return fits


ENDED = (Outcome.CONVERGED, Outcome.COMPLETED)
"""Outcomes of fits that begin no other recipe."""


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


def _join(before: Fit, after: Fit | None, example: Fit) -> Fit:
    """The better of two attempts, with the losses of both.

    A model that was fitted already keeps its last loss over the steps of the others.
    """
    taken = len(before.losses)
    phases = tuple((name, taken + start) for name, start in example.phases)
    if after is None:
        losses = np.full(len(example.losses), before.losses[-1])
        chosen = before
    else:
        losses, chosen = after.losses.copy(), after
        if not after.losses[-1] <= before.losses[-1] and np.isfinite(before.losses[-1]):
            chosen = before
            losses[-1] = before.losses[-1]
    return dataclasses.replace(
        chosen,
        losses=np.concatenate([before.losses, losses]),
        phases=(*before.phases, *phases),
    )
