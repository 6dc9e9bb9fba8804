"""Results of `pinav design`: campaigns, recordings, and what to record next."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pinav.navigation.design.campaign import Campaign, Decision
from pinav.navigation.design.candidates import Suggestion
from pinav.navigation.maps import Course, ForceMaps

Path = Float[np.ndarray, "_ 2"]


@dataclasses.dataclass(frozen=True)
class CampaignSummary:
    """Campaigns of one design in a simulation.

    Attributes:
        finished: campaigns in which the way became known by the belief.
        trajectories: median number of trajectories until then; infinite where more than
            half did not finish.
        fewest: least number of trajectories of a campaign.
        largest: greatest number; campaigns that were given up count with theirs.
        reached: median number of trajectories until the true error was below the
            accuracy for the first time; infinite where more than half did not get
            there.
        right: finished campaigns whose true error was below the accuracy.
        error: median of the true relative error at the end.
    """

    campaigns: int
    finished: int
    trajectories: float
    fewest: int
    largest: int
    reached: float
    right: int
    error: float

    @classmethod
    def of(cls, campaigns: Sequence[Campaign]) -> "CampaignSummary":
        """The summary of the campaigns of one design."""
        counts = np.array([len(one.paths) for one in campaigns])
        finished = np.array([one.finished for one in campaigns])
        ends = np.where(finished, counts, np.inf)
        reached = np.array([_first_below(one) for one in campaigns])
        errors = [d.true_error for d in (one.decisions[-1] for one in campaigns)]
        return cls(
            campaigns=len(campaigns),
            finished=int(finished.sum()),
            trajectories=_median(ends),
            fewest=int(counts.min()),
            largest=int(counts.max()),
            reached=_median(reached),
            right=sum(one.right is True for one in campaigns),
            error=_median(np.array([np.nan if e is None else e for e in errors])),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class DesignResult:
    """Trajectories until the force along a way is known.

    Attributes:
        accuracy: relative error of the force along the way that is small enough.
        maps: learned force after the first campaign, or the recordings.
        decision: knowledge of the way then.
        paths: trajectories of the first campaign of each design, or the recordings [L].
        designs: simulated campaigns by the name of their design.
        bounds: bound of the error after each trajectory, by design and campaign.
        next: trajectory to record next; none where no candidate stays in the arena, or
            of a simulation.
    """

    system: str
    accuracy: float
    course: Course
    maps: ForceMaps
    decision: Decision
    thrust: float
    paths: dict[str, tuple[Path, ...]]
    designs: dict[str, CampaignSummary] = dataclasses.field(default_factory=dict)
    bounds: dict[str, tuple[Float[np.ndarray, " _"], ...]] = dataclasses.field(
        default_factory=dict
    )
    next: Suggestion | None = None


def _first_below(campaign: Campaign) -> float:
    for count, decision in enumerate(campaign.decisions):
        error = decision.true_error
        if decision.arrives and error is not None and error <= campaign.accuracy:
            return float(count)
    return np.inf


def _median(values: Float[np.ndarray, " value"]) -> float:
    """The lower median."""
    return float(np.quantile(values, 0.5, method="inverted_cdf"))
