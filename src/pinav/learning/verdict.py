"""The verdict of a fit: whether its force can be trusted, and where."""

import dataclasses
import enum
from typing import ClassVar

import numpy as np

from pinav.fitting import Outcome
from pinav.fitting.checks.departures import Contradiction
from pinav.fitting.checks.residuals import OUTLIER
from pinav.fitting.evidence.model_evidence import DECISIVE


class Standing(enum.Enum):
    """Degree of trust in the force of a fit; `str()` gives the words.

    Attributes:
        TRUSTED: no check contradicts it.
        PREDICTS: rollouts of the same tracks are all that it stands for.
        CONTRADICTS: the data contradict what the system states.
        UNSUPPORTED: the data show no force beside the known physics.
        UNCONVERGED: another step would change it.
    """

    TRUSTED = "trusted where data are"
    PREDICTS = "trusted nowhere beyond a prediction of the same tracks"
    CONTRADICTS = "contradicts the system"
    UNSUPPORTED = "no force is supported"
    UNCONVERGED = "not converged"

    def __str__(self) -> str:
        return self.value


@dataclasses.dataclass(frozen=True)
class Verdict:
    """The degree of trust in a fit, and the reason."""

    DERIVED: ClassVar = ("says",)

    standing: Standing
    reason: str

    @property
    def is_trusted(self) -> bool:
        """The force can be trusted where there are data."""
        return self.standing is Standing.TRUSTED

    @property
    def forbids_steering(self) -> bool:
        """The force is wrong, or there may be none: nobody should steer by it."""
        return self.standing in (Standing.CONTRADICTS, Standing.UNSUPPORTED)

    @property
    def says(self) -> str:
        """The verdict as a sentence."""
        return f"Verdict: {self.standing}: {self.reason}."


CREDIBLE = 6.0
"""Nats from which a departure counts.

Some twenty are weighed, so that each needs more than what decides between two."""


def judge(
    outcome: str,
    contradictions: tuple[Contradiction, ...],
    copied: tuple[int, int] | None,
    *,
    support: float | None = None,
    is_adequate: bool | None,
    has_bands: bool,
) -> Verdict:
    """The verdict on a fit.

    Args:
        outcome: the word for how it ended.
        contradictions: the largest gain first.
        copied: two equal tracks.
        support: log evidence of a field beside commands over none [nats]; None where it
            was not asked.
        is_adequate: the residuals look like independent noise; None where that is not
            known.
        has_bands: there is a posterior.
    """
    if copied is not None:
        earlier, later = copied
        return Verdict(
            Standing.PREDICTS,
            f"trajectory {later} copies trajectory {earlier}, so that intervals are "
            "too small: leave it out",
        )
    if contradictions and contradictions[0].gain > CREDIBLE:
        first = contradictions[0]
        told = f"{first.clause} ({first.gain:.0f} nats)"
        if first.name == OUTLIER:
            told += ", so that errors are not normal: leave such rows out"
            return Verdict(Standing.PREDICTS, told)
        return Verdict(Standing.CONTRADICTS, told)
    if support is not None and not support > DECISIVE:
        reason = f"its log evidence over the known physics alone is {support:.1f} nats"
        return Verdict(Standing.UNSUPPORTED, reason)
    if outcome not in map(str, (Outcome.CONVERGED, Outcome.COMPLETED)):
        return Verdict(Standing.UNCONVERGED, f"the fit ended {outcome}")
    if is_adequate is False:
        return Verdict(
            Standing.PREDICTS,
            "residuals are not independent noise, and no single number of the system "
            "explains them",
        )
    if not has_bands:
        return Verdict(
            Standing.PREDICTS,
            "without a posterior nothing tells how far beside the tracks the force "
            "holds; fit noisy or further trajectories with --recipe bayes",
        )
    weighed = len(contradictions)
    against = "no check of the data" if not weighed else f"none of {weighed} departures"
    gain = contradictions[0].gain if weighed else np.nan
    numbers = f" (the best differs by {gain:.1f} nats)" if weighed else ""
    return Verdict(Standing.TRUSTED, f"{against} contradicts the fit{numbers}")
