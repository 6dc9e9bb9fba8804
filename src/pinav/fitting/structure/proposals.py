r"""Terms with a structure that a force may have, proposed from what the data say of it.

For each kind of term its geometry is scanned on a grid by the evidence of the
linearised data (`ForceResponse`) at a fixed smoothness of the profile, and the best is
polished by the engine's own steps. Terms are added as long as the evidence gains more
than their geometry costs.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree

from pinav.errors import FitError
from pinav.fitting.engine.iterate import iterate
from pinav.fitting.engine.steps import FullStep
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    Whitened,
    at_shape,
    best_hyperparameters,
    posterior_mean,
)
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.least_squares import Regression
from pinav.fitting.structure.patterns import lattices, obstacles
from pinav.fitting.structure.response import ForceResponse, force_quadratic
from pinav.fitting.structure.starts import (
    KERNELS,
    Region,
    central_term,
    circular,
    ellipses,
    scanned_terms,
)
from pinav.forces import (
    AbstractTerm,
    CentralTerm,
    EllipticTerm,
    SumForce,
)
from pinav.forces.priors import AbstractPrior, MixturePrior

CLOSER = (0.3, 0.1)
"""Sizes of further grids of centres, each about the best of those before."""

MOST_TERMS = 3
"""Terms of a structure."""

EXPLAINED = 1.5
"""Misfit of a proposal, relative to the noise, above which it is not fitted: its free
remainder would have to carry too much."""

MOST_ROUNDS = 4
"""Times that a term is added, after some of which an earlier one may go."""

POLISH = 8
"""Steps of the engine for the geometry of a proposal."""

Terms = tuple[AbstractTerm, ...]


class Proposal(eqx.Module):
    """Terms with their geometry, and what the linearised data think of them.

    Attributes:
        terms: with weights.
        log_evidence: less what the geometry costs.
        noise: standard deviation of what they leave unexplained.
    """

    terms: Terms
    log_evidence: float
    noise: float


def _linearised(terms: Terms, response: ForceResponse) -> LinearisedObservations:
    """What the data say of the weights of terms of a given geometry."""
    quadratic = force_quadratic(SumForce(terms), response, _weights)
    return LinearisedObservations.of(quadratic)


def _weights(force: Any) -> PyTree:
    return [term.weights for term in force.terms]


def _prior(terms: Terms) -> AbstractPrior:
    """Prior of several terms, independent of each other."""
    whole = terms[0].prior()
    for term in terms[1:]:
        whole = MixturePrior(whole, term.prior())
    return whole


def quick_evidence(terms: Terms, response: ForceResponse) -> float:
    """Log evidence of terms of a geometry, at a fixed smoothness of their profiles.

    The noise is estimated: far from the right geometry nothing explains the data, and
    with the noise fixed wild profiles would.
    """
    prior = _prior(terms)
    try:
        data = _linearised(terms, response)
    except FitError:
        return -np.inf
    best = at_shape(data, prior.covariance, _smooth(terms, prior))
    return best.log_evidence - cost(terms, response)


def with_profiles(terms: Terms, response: ForceResponse) -> Terms:
    """The terms with the weights of highest evidence for their geometry.

    Raises:
        FitError: the data do not depend on them.
    """
    prior, data = _prior(terms), _linearised(terms, response)
    chosen = best_hyperparameters(
        data, prior.covariance, _smooth(terms, prior), prior.bounds, None, prior.slopes
    )
    white = Whitened.of(data, prior.covariance(chosen.shape))
    mean, made = posterior_mean(white, chosen), []
    for term in terms:
        count = len(term.weights)
        weights, mean = jnp.asarray(mean[:count]), mean[count:]
        made.append(eqx.tree_at(lambda one: one.weights, term, weights))
    return tuple(made)


def _smooth(terms: Terms, prior: AbstractPrior) -> Float[np.ndarray, " shape"]:
    """The start of the search, with profiles as smooth as a tenth of the extent."""
    shape = prior.start.copy()
    place = 0
    for index, term in enumerate(terms):
        entries = len(term.prior().start)
        if entries > 1:
            shape[place] = np.log(0.1 * KERNELS)
        place += entries + (index > 0)
    return shape


def cost(terms: Terms, response: ForceResponse) -> float:
    """What the numbers of the geometry cost: a prior of unit information each."""
    count = sum(leaf.size for term in terms for leaf in term.geometry)
    return 0.5 * count * float(np.log(response.num_free)) + 3.0 * len(terms)


def polish(terms: Terms, response: ForceResponse) -> Proposal | None:
    """Profiles and geometry of the highest evidence; None where there is no best.

    A geometry has no derivative while its profile is zero, so that the profiles come
    first.
    """
    try:
        terms = with_profiles(terms, response)
        shaped = any(term.geometry for term in terms)
        problem = Regression.of(
            SumForce(terms),
            response,
            weights=_weights,
            weights_prior=GaussianWeights(_prior(terms)),
            constants=lambda m: [term.geometry for term in m.terms],
            step_rule=FullStep(),
            is_linear=not shaped,
            num_projected=response.num_projected,
        )
        _, steps = iterate(problem, POLISH)
    except FitError:
        return None
    if not steps:
        return None
    best = max(steps, key=lambda step: step.hyperparameters.log_evidence)
    fitted = problem.parametric(jnp.asarray(best.move.theta))
    chosen = best.hyperparameters
    value = float(chosen.log_evidence) - cost(terms, response)
    return Proposal(fitted.terms, value, chosen.noise)


def propose(
    response: ForceResponse, region: Region, noise: float, *, rotational: bool
) -> Proposal | None:
    """The structure of highest evidence; None where no term explains anything.

    Terms are added while the data are not explained to the noise, the evidence gains,
    and the last term explained a good part of what was left. Terms that a later one
    made needless are removed.

    Args:
        response: of the data to forces.
        region: where they are.
        noise: of the observations, roughly.
        rotational: whether the force may have no potential.
    """
    best: Proposal | None = None
    for _ in range(MOST_ROUNDS):
        if best is not None and len(best.terms) == MOST_TERMS:
            break
        terms = () if best is None else best.terms
        trials = _extended(terms, response, region, noise, rotational=rotational)
        if not trials:
            break
        most = max(one.log_evidence for one in trials)
        # kinds come in the order of their freedom: a linear force is a wall, too
        winner = next(t for t in trials if t.log_evidence >= most - 2 * DECISIVE)
        before = np.inf if best is None else best.noise
        if best is not None and winner.log_evidence < best.log_evidence + 2 * DECISIVE:
            break
        best = _prune(winner, response)
        if best.noise < ENOUGH * noise or best.noise > PROGRESS * before:
            break
    return best


def _patterns(response: ForceResponse, region: Region) -> list[Proposal]:
    """Lattices and obstacles of one kind, polished, where simpler terms fail."""
    starts = [_best(lattices(region), (), response), *obstacles(response, region)]
    made = [polish((start,), response) for start in starts]
    return [one for one in made if one is not None and np.isfinite(one.log_evidence)]


def _prune(proposal: Proposal, response: ForceResponse) -> Proposal:
    """Leave out terms that a later one made needless; make circles of ellipses."""
    terms = proposal.terms
    if len(terms) < 2:
        return proposal
    for index in range(len(terms)):
        rest = terms[:index] + terms[index + 1 :]
        simpler = [rest] if index < len(terms) - 1 else []
        term = terms[index]
        if isinstance(term, EllipticTerm):
            circle = (*terms[:index], circular(term), *terms[index + 1 :])
            simpler.append(circle)
        for fewer in simpler:
            made = polish(fewer, response)
            if made and made.log_evidence >= proposal.log_evidence - 2 * DECISIVE:
                return _prune(made, response)
    return proposal


ENOUGH, PROGRESS = 1.15, 0.8
"""Misfit, relative to the noise, at which nothing is left to explain; and relative to
the misfit before, above which further terms lead nowhere."""


def _extended(
    terms: Terms,
    response: ForceResponse,
    region: Region,
    noise: float,
    *,
    rotational: bool,
) -> list[Proposal]:
    """Structures with one term more than there are, of each kind, polished."""
    proposals: list[Proposal] = []
    for starts in scanned_terms(region, rotational=rotational):
        chosen = _best(starts, terms, response)
        for fraction in CLOSER:
            if not isinstance(chosen, CentralTerm):
                break
            closer = [
                central_term(region, place, rotational=chosen.rotational)
                for place in region.grid(np.asarray(chosen.center), fraction)
            ]
            chosen = _best([chosen, *closer], terms, response)
        made = polish((*terms, chosen), response)
        if made is None or not np.isfinite(made.log_evidence):
            continue
        proposals.append(made)
        last = made.terms[-1]
        unexplained = made.noise > ENOUGH * noise and len(region.middle) == 2
        if isinstance(last, CentralTerm) and unexplained:
            bent = polish((*terms, _best(ellipses(last), terms, response)), response)
            proposals += [bent] if bent is not None else []
    explained = any(one.noise < ENOUGH * noise for one in proposals)
    if terms or explained or len(region.middle) != 2:
        return proposals
    patterns = _patterns(response, region)
    # of a sum that is not explained yet a pattern is a poor beginning
    return proposals + [one for one in patterns if one.noise < EXPLAINED * noise]


def _best(
    starts: Sequence[AbstractTerm], terms: Terms, response: ForceResponse
) -> AbstractTerm:
    """The term that explains most beside those that there are."""
    values = [quick_evidence((*terms, start), response) for start in starts]
    return starts[int(np.argmax(values))]
