"""The result of `pinav study`: fits of several models to more data, or more noise."""

import dataclasses
import math

from pinav.evaluation import Agreement, RolloutSummary

VISITED = "visited"
"""The region whose force error the figure of a study shows."""


@dataclasses.dataclass(frozen=True)
class StudyFit:
    """One fit of a study; one that failed has no scores.

    Attributes:
        model: name of the model.
        seed: seed of starts, noise and network.
        trajectories: number of trajectories that it was fitted to.
        sigma: standard deviation of the observations.
        outcome: word for how the fit ended, or why it failed.
        force: agreement with the true force by the distance to the data; none where
            the model has no force.
        rollouts: position errors over held-out starts.
    """

    model: str
    seed: int
    trajectories: int
    sigma: float
    outcome: str
    force: dict[str, Agreement] = dataclasses.field(default_factory=dict)
    rollouts: RolloutSummary | None = None

    def force_error(self, region: str) -> float:
        """Relative L2 error of the force in a region; NaN without a force."""
        return self.force[region].error if self.force else math.nan

    def cosine(self, region: str) -> float:
        """Cosine similarity of the force in a region; NaN without a force."""
        return self.force[region].cosine if self.force else math.nan

    def rollout(self, score: str) -> float:
        """A score of the rollouts, by the name of its field; NaN without one."""
        return math.nan if self.rollouts is None else getattr(self.rollouts, score)


@dataclasses.dataclass(frozen=True)
class Study:
    """All fits of a study.

    Attributes:
        name: `data-efficiency` or `noise`.
        scenario: name of the scenario that the data are of.
        fits: one for each model, seed and amount of data or noise.
    """

    name: str
    scenario: str
    fits: tuple[StudyFit, ...]
