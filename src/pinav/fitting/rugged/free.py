"""The fit of free kernels: as fine as they must be, or hills beside coarse ones.

Detail finer than the kernels with which fits begin may be in a few places: hills and
wells beside coarse kernels are then simpler and quicker. They must win clearly, since
their evidence is not charged for places that the data chose.
"""

import dataclasses

from pinav.errors import FitError
from pinav.fitting.bayes.fit_bayes import ADVICE
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.environments.kernels import MOST_WEIGHTS, OFTEN
from pinav.fitting.environments.refinement import AS_FINE_AS_ASKED, Refinement
from pinav.fitting.outcome import Outcome
from pinav.fitting.policy import POLICY
from pinav.fitting.rugged.hills import propose_hills
from pinav.fitting.structure.fits import Fits, StructuredFit
from pinav.fitting.structure.survey import Survey, is_worth_a_search

AS_FINE_AS_OFTEN = Refinement(max_weights=int(OFTEN * MOST_WEIGHTS))
"""Kernels on which the places of hills are seen, if there are hills."""


def fit_rough(fits: Fits) -> EvidenceFit:
    """The fit of free kernels that are as fine as a search for terms needs them.

    Raises:
        FitError: it fails.
    """
    return dataclasses.replace(fits, throw=False).fit(AS_FINE_AS_OFTEN)


def fit_free(fits: Fits, rough: EvidenceFit | None = None) -> StructuredFit:
    """The fit of free kernels, or of hills, without any other structure.

    Args:
        rough: what `fit_rough` gives, where it is known.

    Raises:
        FitError: it fails; where `throw`, it does not converge.
    """
    quiet = dataclasses.replace(fits, throw=False)
    rough = fit_rough(fits) if rough is None else rough
    kernels = rough.model.environment
    is_finer = float(kernels.kernels.width) < float(fits.kernels.kernels.width)
    if is_finer and not fits.trace.is_over:
        hills = _fit_hills(quiet, rough)
        if hills is not None and hills.gain > POLICY.clear:
            return hills
        finer = AS_FINE_AS_ASKED.finer(kernels, fits.specification.trajectories)
        if rough.outcome is Outcome.UNDER_RESOLVED and finer is not None:
            fit = quiet.of(finer).about(rough).fit(AS_FINE_AS_ASKED)
            rough = rough if fit.outcome is Outcome.DIVERGED else fit
    if fits.throw and rough.outcome in ADVICE:
        raise FitError(ADVICE[rough.outcome], str(rough.outcome))
    value = rough.hyperparameters.log_evidence  # its correction takes long
    fits.trace.note((), f"free kernels {rough.outcome}", value)
    return StructuredFit(rough)


def _fit_hills(fits: Fits, rough: EvidenceFit) -> StructuredFit | None:
    """The fit of hills about that of free kernels; None where there are none."""
    specification, potential = fits.specification, rough.model.environment
    if not (
        is_worth_a_search(specification.model, specification.trajectories)
        and potential.is_conservative
        and potential.dim == 2
        and rough.outcome in (Outcome.CONVERGED, Outcome.UNDER_RESOLVED)
    ):
        return None
    survey = Survey.of(fits, rough)
    chosen = rough.hyperparameters
    hills = propose_hills(survey.response, survey.noise, potential, chosen)
    fit = None if hills is None else fits.try_terms((hills,), rough)
    if fit is None:
        return None
    gain = fit.log_evidence - StructuredFit(rough).log_evidence
    return dataclasses.replace(fit, gain=gain)
