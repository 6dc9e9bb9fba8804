r"""Gradient matching: the unknown along the observed paths, without a rollout.

Complete states that are all but exact give their own rates of change, by splines, and
with the known physics the unknown force at every sample. Kernels as fine as held-out
samples ask for carry it to the places beside the paths. Networks learn the rates
themselves before the errors of their rollouts (`RateMatching`).

References:
    Varah, SIAM J. Sci. Stat. Comput. 3, 28 (1982); Ramsay et al., J. R. Stat. Soc. B
    69, 741 (2007).
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from pinav.dynamics import AbstractDynamics, Swimmer
from pinav.fitting.environments.force_prior import (
    ForcePrior,
    lay_smooth_kernels,
    layers_root,
)
from pinav.fitting.environments.force_regression import (
    KernelKind,
    Layer,
    force_columns,
    force_grids,
    lay_layers,
    match_grid,
    regress,
)
from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.fitting.environments.rates import (
    DEGREE,
    MOST_SAMPLES,
    observed_rates,
    residual_forces,
    thin_rates,
)
from pinav.fitting.matching.gauss_newton import Rates
from pinav.forces import (
    KernelForce,
    KernelPotential,
    LayeredPotential,
    ZeroForce,
    as_learned_force,
)
from pinav.trajectories import Trajectories, informative_rows

MOST_RATES = 300
"""Samples whose rates a network learns, at most."""

GOOD_ENOUGH = 1e-6
"""Relative error of held-out samples that needs no finer kernels."""


def match_kernels(swimmer: Swimmer, rates: Rates) -> KernelPotential | KernelForce:
    """The force that the known physics leave unexplained.

    Its kernels surround the samples at which it acts. They are a little finer than
    those whose error at held-out samples is the smallest; a potential, unless a force
    without one explains them far better.

    Args:
        swimmer: the known physics; its environment is left out.
    """
    samples = _ForceSamples.of(swimmer, rates)
    best = _choose(_try_grids((KernelPotential, KernelForce), samples))
    return _fit_grid(best, samples)


def lay_kernels_of(
    kind: KernelKind, swimmer: Swimmer, rates: Rates
) -> KernelPotential | KernelForce | None:
    """Untrained kernels with a prior that suits what the known physics leave.

    Returns:
        The kernels; None where no grid of one width suits the force.
    """
    prior = lay_smooth_kernels(kind, *_ForceSamples.of(swimmer, rates))
    return None if prior is None else prior.environment  # pyright: ignore


def prior_root(
    model: AbstractDynamics, trajectories: Trajectories
) -> Float[np.ndarray, "weight weight"] | None:
    """A root of the prior of a kernel model's weights, as its data ask for.

    Args:
        model: untrained, linear in what it learns.
        trajectories: exact, every state observed.

    Returns:
        The root; None where the data or the model are of another kind.
    """
    rates = observed_rates(trajectories)
    if rates is None or not isinstance(model, Swimmer):
        return None
    environment = as_learned_force(model.environment)
    if environment is None:
        return None
    _, positions, forces = _ForceSamples.of(model, rates)
    if isinstance(environment, LayeredPotential):
        return layers_root(environment, positions, forces)
    return ForcePrior.of(environment, positions, forces).root()


def match_potential(swimmer: Swimmer, rates: Rates) -> tuple[Layer, ...]:
    """Kernels of a potential for the force that the known physics leave unexplained.

    A grid of one width where one explains the force; a hill with a long tail asks for
    layers (`lay_layers`).
    """
    samples = _ForceSamples.of(swimmer, rates)
    prior = lay_smooth_kernels(KernelPotential, *samples)
    laid = None if prior is None else prior.environment.kernels
    if laid is not None:
        return ((np.asarray(laid.centers), float(laid.width)),)
    best = _choose(_try_grids((KernelPotential,), samples))
    if best.within > ONE_WIDTH:
        return lay_layers(samples.positions, samples.forces)
    return (surround_with_kernels(samples.places, _finer(best.grid)),)


class _ForceSamples(NamedTuple):
    """Forces at samples, those of a regression.

    Attributes:
        places: all positions at which a force acts [L].
        positions: of the samples that enter the regression [L].
    """

    places: Float[np.ndarray, "place dim"]
    positions: Float[np.ndarray, "point dim"]
    forces: Float[np.ndarray, "point dim"]

    @classmethod
    def of(cls, swimmer: Swimmer, rates: Rates) -> "_ForceSamples":
        dim = rates.states.shape[1] // 2
        forces = residual_forces(swimmer, rates)
        acting = _where_a_force_acts(forces)
        known = _where_it_is_known(rates, forces)
        parts = [np.flatnonzero(known & acting), np.flatnonzero(known & ~acting)]
        kept = np.concatenate(
            [rows[informative_rows(rates.states[rows], MOST_SAMPLES)] for rows in parts]
        )
        positions = rates.states[:, :dim]
        return cls(positions[acting], positions[kept], forces[kept])


def _try_grids(kinds: Sequence[KernelKind], samples: _ForceSamples) -> "list[_Trial]":
    """Errors of grids from coarse to fine, until one needs no finer kernels."""
    places, positions, forces = samples
    # Every fourth sample, so that held-out places lie among the others.
    held_out = np.arange(len(positions)) % 4 == 2
    size = float(np.sqrt(np.mean(forces[held_out] ** 2))) or 1.0
    trials: list[_Trial] = []
    for kind in kinds:
        for grid, columns in force_grids(kind, places, positions):
            weights = regress(columns[~held_out], forces[~held_out])
            missed = np.square(columns @ weights - forces)
            held, within = (
                float(np.sqrt(missed[part].mean())) / size
                for part in (held_out, ~held_out)
            )
            trials.append(_Trial(held, within, kind, grid))
            if held < GOOD_ENOUGH:
                return trials
    return trials


def _fit_grid(best: "_Trial", samples: _ForceSamples) -> KernelPotential | KernelForce:
    """Kernels of a trial, a little finer, fitted to all samples."""
    kind = best.kind
    centers, width = surround_with_kernels(samples.places, _finer(best.grid))
    columns = force_columns(kind, samples.positions, centers, width)
    weights = regress(columns, samples.forces)
    shape = centers.shape if kind is KernelForce else centers.shape[:1]
    return kind(jnp.asarray(weights.reshape(shape)), jnp.asarray(centers), width)


def _where_a_force_acts(
    forces: Float[np.ndarray, "point dim"],
) -> Bool[np.ndarray, " point"]:
    """At which samples more acts than a ten-millionth of the largest force."""
    sizes = np.linalg.norm(forces, axis=1)
    acting = sizes >= LEAST_FORCE * sizes.max()
    return acting if acting.sum() > DEGREE else np.ones_like(acting)


def _where_it_is_known(
    rates: Rates, forces: Float[np.ndarray, "point dim"]
) -> Bool[np.ndarray, " point"]:
    """At which points splines agree on the force, unless that is almost nowhere."""
    if rates.doubts is None:
        return np.ones(len(forces), bool)
    known = rates.doubts <= RELIABLE * np.linalg.norm(forces, axis=1).max()
    return known if known.mean() > MOSTLY else np.ones_like(known)


RELIABLE, MOSTLY = 1e-3, 0.5
"""Doubts of a force that count as none, relative to the largest one; share of the
points above which the others are left out."""

LEAST_FORCE = 1e-7
"""Relative to the largest force: what acts less is left without kernels."""


class _Trial(NamedTuple):
    """A grid and its relative errors.

    Attributes:
        held_out: error at samples that were left out.
        within: error at the others.
    """

    held_out: float
    within: float
    kind: KernelKind
    grid: KernelGrid


def _choose(trials: list[_Trial]) -> _Trial:
    """The coarsest of the best trials; a potential unless others are `FAR_BETTER`.

    Held-out errors near those of the splines hardly tell grids from each other, and a
    finer one leaves more of the force undecided beside the path.

    Where samples are too far apart to predict each other, the ones that are left out
    tell nothing; then the coarsest potential is taken that explains the samples
    themselves.
    """
    potentials = [trial for trial in trials if trial.kind is KernelPotential]
    if min(trial.held_out for trial in trials) >= TELLING:
        enough = max(EXPLAINED, min(trial.within for trial in potentials))
        return next(trial for trial in potentials if trial.within <= enough)
    best, potential = (
        min(several, key=lambda trial: trial.held_out)
        for several in (trials, potentials)
    )
    # A force can only look better by chance where it has more weights than a potential:
    # it must be far better.
    far_better = FAR_BETTER * best.held_out < potential.held_out
    chosen = best if far_better else potential
    return next(
        trial
        for trial in trials
        if trial.kind is chosen.kind and trial.held_out <= AS_GOOD * chosen.held_out
    )


FAR_BETTER, AS_GOOD = 10.0, 2.0
"""Factors in the error of held-out samples."""


def _finer(grid: KernelGrid) -> KernelGrid:
    return match_grid(round(FINER * grid.across))


FINER = 4 / 3
"""Rates by splines are less exact than trajectories, which ask for finer kernels."""

TELLING, EXPLAINED = 0.05, 1e-5
"""Relative error of held-out samples above which they cannot judge a grid, and that of
the others at which they are explained."""


ONE_WIDTH = 2e-5
"""Relative error of the samples that enter a regression above which kernels of one
width do not explain them; the errors of splines are mostly below."""


def simpler_models(
    swimmer: AbstractDynamics, trajectories: Trajectories
) -> dict[str, Swimmer]:
    """Models without a network by their names: matched kernels, and physics alone."""
    rates = observed_rates(trajectories)
    if rates is None or not isinstance(swimmer, Swimmer):
        return {}
    return {
        "a kernel field": swimmer.with_environment(match_kernels(swimmer, rates)),
        "the known physics": swimmer.with_environment(ZeroForce()),
    }


def rates_to_match(model: Any, trajectories: Trajectories) -> Rates | None:
    """Rates that a model learns first, at the observed states.

    Those of a swimmer are of its velocity alone: the rates of its position are known. A
    model without known physics is asked for the same rates beside the states, too, so
    that its rollouts do not depart from each other.

    Returns:
        The rates, or None where samples are too few to tell them.
    """
    rates = observed_rates(trajectories)
    if rates is None:
        return None
    dim = rates.states.shape[1] // 2
    if not isinstance(model, Swimmer):
        rates = thin_rates(rates, MOST_SAMPLES)
        spread = rates.states.std(axis=0)
        rng = np.random.default_rng(0)
        offsets = BESIDE * spread * rng.normal(size=rates.states.shape)
        beside = dataclasses.replace(rates, states=rates.states + offsets)
        return jax.tree.map(lambda *a: np.concatenate(a), rates, beside)
    rates = thin_rates(rates, MOST_RATES)
    return dataclasses.replace(rates, rates=rates.rates[:, dim:])


BESIDE = 0.02
"""Distance of states beside the paths, in standard deviations of each channel."""
