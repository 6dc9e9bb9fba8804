"""The results of `pinav compare`, as its files hold them."""

import msgspec

from pinav.commands.cells import EstimateRow
from pinav.report import Table


class Candidate(msgspec.Struct, frozen=True, omit_defaults=True):
    """The evidence of one model.

    Attributes:
        outcome: the word for how its fit ended, or `failed`.
        log_evidence: hyperparameters integrated out [nats]; none for a failed fit.
        best: log evidence at the best hyperparameters [nats].
        correction: for the uncertainty of the hyperparameters [nats].
        noise: standard deviation of the observations.
        weights: number of learned parameters.
        rotational_fraction: of a mixture, where there are data.
        reason: for a failure.
    """

    outcome: str
    log_evidence: float | None = None
    best: float | None = None
    correction: float | None = None
    noise: float | None = None
    weights: int | None = None
    rotational_fraction: EstimateRow | None = None
    reason: str = ""


class Verdict(msgspec.Struct, frozen=True):
    """The answer of the evidence to a question.

    Attributes:
        models: the simple and the rich model.
        difference: of their log evidence [nats]; none where one has none.
        text: the answer in a sentence.
    """

    models: tuple[str, str]
    difference: float | None
    text: str


class CompareMetrics(msgspec.Struct, frozen=True):
    """The numbers of a comparison.

    Attributes:
        models: each candidate by its name.
        verdicts: the questions that two of the candidates answer.
    """

    models: dict[str, Candidate]
    verdicts: tuple[Verdict, ...]

    def table(self) -> Table:
        """The candidates, the best one first."""
        known = {
            name: one.log_evidence
            for name, one in self.models.items()
            if one.log_evidence is not None
        }
        best = max(known.values(), default=0.0)
        rows = []
        for name in sorted(known, key=lambda name: -known[name]):
            one, below = self.models[name], known[name] - best
            cells = (
                f"{known[name]:.1f}",
                f"{one.correction or 0.0:.1f}",
                f"{below:.1f}",
            )
            rows.append((name, *cells, one.outcome))
        failed = [name for name in self.models if name not in known]
        rows += [(n, "–", "–", "–", self.models[n].reason) for n in failed]
        return Table(HEADER, rows, NOTE)


HEADER = (
    "model",
    "log evidence [nats]",
    "hyperparameter correction [nats]",
    "Δ log evidence [nats]",
    "outcome",
)
NOTE = (
    "Log evidence with the hyperparameters integrated out; starts and learned "
    "constants have priors of unit information."
)
