r"""Gradient matching: the unknown along the observed paths, without a rollout.

Complete states that are all but exact give their own rates of change, by splines, and
with the known physics the unknown force at every sample. Kernels as fine as the
evidence asks for carry it to the places beside the paths. Networks learn the rates
themselves before the errors of their rollouts (`RateMatching`).

References:
    Varah, SIAM J. Sci. Stat. Comput. 3, 28 (1982); Ramsay et al., J. R. Stat. Soc. B
    69, 741 (2007).
"""

import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractDynamics, Swimmer
from pinav.fitting.environments.force_prior import (
    ForcePrior,
    KernelKind,
    choose_kernels,
    kernel_ladder,
    lay_layers,
    layers_root,
    regress,
    with_weights,
)
from pinav.fitting.environments.rates import (
    MOST_SAMPLES,
    ForceSamples,
    observed_rates,
    thin_rates,
)
from pinav.fitting.matching import recipes
from pinav.fitting.matching.gauss_newton import Rates
from pinav.forces import (
    AbstractForce,
    AbstractLearnedForce,
    KernelForce,
    KernelPotential,
    LayeredPotential,
    ZeroForce,
    as_learned_force,
)
from pinav.trajectories import Trajectories


def match_kernels(swimmer: Swimmer, rates: Rates) -> AbstractForce:
    """The force that the known physics leave unexplained.

    Its kernels surround the samples at which it acts. It is a potential, in layers
    where it must be, unless a force without one alone suits the samples.

    Args:
        swimmer: the known physics; its environment is left out.
    """
    samples = ForceSamples.of(swimmer, rates)
    kinds: tuple[KernelKind, ...] = (KernelPotential, KernelForce)
    for kind in kinds:
        prior = choose_kernels(kind, samples)
        if prior is not None:
            return prior.force
    layers = lay_layers(samples)
    return with_weights(layers, regress(layers, samples)[0])


def kernels_of(
    kind: KernelKind, swimmer: Swimmer, rates: Rates
) -> AbstractLearnedForce:
    """Untrained kernels for the force that the known physics leave unexplained.

    Where no grid of one width suits a potential it gets layers; a force without one has
    the finest kernels that there is room for.
    """
    samples = ForceSamples.of(swimmer, rates)
    prior = choose_kernels(kind, samples)
    if prior is not None:
        return prior.environment
    if kind is KernelPotential:
        return lay_layers(samples)
    *_, finest = kernel_ladder(kind, samples.places)
    return finest


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
    samples = ForceSamples.of(model, rates)
    if isinstance(environment, LayeredPotential):
        return layers_root(environment, samples)
    return ForcePrior.of(environment, samples).root()


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
    rates = thin_rates(rates, recipes.MOST_SAMPLES)
    return dataclasses.replace(rates, rates=rates.rates[:, dim:])


BESIDE = 0.02
"""Distance of states beside the paths, in standard deviations of each channel."""
