"""The result of `pinav compare`: the evidence of several models of the same data."""

import dataclasses

from pinav.fitting import Estimate, ModelEvidence


@dataclasses.dataclass(frozen=True)
class ComparedModel:
    """The evidence of one model.

    Attributes:
        outcome: word for how its fit ended, or `failed`.
        evidence: of the model; none for a failed fit.
        noise: standard deviation of the observations.
        weights: number of learned parameters.
        rotational_fraction: of a mixture, where there are data.
        reason: why the fit failed.
    """

    outcome: str
    evidence: ModelEvidence | None = None
    noise: float | None = None
    weights: int = 0
    rotational_fraction: Estimate | None = None
    reason: str = ""

    @property
    def log_evidence(self) -> float | None:
        """Log evidence [nats], hyperparameters integrated out; none without a fit."""
        return None if self.evidence is None else self.evidence.log_evidence


@dataclasses.dataclass(frozen=True)
class ComparisonVerdict:
    """The answer of the evidence to a question.

    Attributes:
        models: the simple and the rich model.
        difference: of their log evidence [nats]; none where one has none.
        text: the answer in a sentence.
    """

    models: tuple[str, str]
    difference: float | None
    text: str


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Several models of the same data.

    Attributes:
        models: each candidate by its name.
        verdicts: answers to the questions that two of the candidates decide.
    """

    models: dict[str, ComparedModel]
    verdicts: tuple[ComparisonVerdict, ...]
