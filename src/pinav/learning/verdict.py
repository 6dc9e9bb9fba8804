"""The verdict of a fit: whether its force can be trusted, and where."""

import dataclasses
import enum
from typing import ClassVar

import numpy as np

from pinav.fitting import Outcome
from pinav.fitting.checks.departures import Contradiction


class Standing(enum.Enum):
    """How far the force of a fit can be trusted; `str()` gives the words.

    Attributes:
        TRUSTED: no check contradicts it.
        PREDICTS: rollouts of the same tracks are all that it stands for.
        CONTRADICTS: the data contradict what the system states.
        UNCONVERGED: another step would change it.
    """

    TRUSTED = "trusted where data are"
    PREDICTS = "trusted nowhere beyond a prediction of the same tracks"
    CONTRADICTS = "contradicts the system"
    UNCONVERGED = "not converged"

    def __str__(self) -> str:
        return self.value


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether a fit can be trusted, and the reason."""

    DERIVED: ClassVar = ("says",)

    standing: Standing
    reason: str

    @property
    def is_trusted(self) -> bool:
        """The force can be trusted where there are data."""
        return self.standing is Standing.TRUSTED

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
    is_adequate: bool | None,
    has_bands: bool,
) -> Verdict:
    """The verdict on a fit.

    Args:
        outcome: the word for how it ended.
        contradictions: the largest gain first.
        copied: two equal tracks.
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
        standing = Standing.CONTRADICTS
        if first.name == "outlier":
            standing = Standing.PREDICTS
        return Verdict(standing, f"{first.clause} ({first.gain:.0f} nats)")
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
