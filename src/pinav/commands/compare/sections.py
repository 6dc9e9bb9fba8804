"""What a comparison of models has to say: their evidence, and the verdicts on it."""

from pinav.commands.compare.result import Comparison
from pinav.figures import Picture
from pinav.figures.laws import evidence_bars
from pinav.report import Paragraph, Section, Table

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


def sections(comparison: Comparison) -> list[Section]:
    """The verdicts, the table of the candidates, and their evidence as bars."""
    picture = Picture(
        "evidence",
        lambda: evidence_bars(
            {name: one.log_evidence for name, one in comparison.models.items()}
        ),
        "Nats below the best model; the scale is logarithmic above one.",
        alt="Bars: by how much the log evidence of each model is below the best",
    )
    sentences = [verdict.text for verdict in comparison.verdicts]
    sentences += [
        f"Rotational fraction of {name} where there are data: {part.value:.3f} ± "
        f"{part.sd:.2g} (sd)."
        for name, one in comparison.models.items()
        if (part := one.rotational_fraction)
    ]
    blocks = [*map(Paragraph, sentences), table(comparison), picture]
    return [Section("The evidence", blocks)]


def table(comparison: Comparison) -> Table:
    """The candidates, the best one first."""
    known = {
        name: one.evidence
        for name, one in comparison.models.items()
        if one.evidence is not None
    }
    best = max((one.log_evidence for one in known.values()), default=0.0)
    rows = [
        (
            name,
            f"{one.log_evidence:.1f}",
            f"{one.correction:.1f}",
            f"{best - one.log_evidence:.1f}",
            comparison.models[name].outcome,
        )
        for name, one in sorted(known.items(), key=lambda pair: -pair[1].log_evidence)
    ]
    failed = [name for name in comparison.models if name not in known]
    rows += [(n, "–", "–", "–", comparison.models[n].reason) for n in failed]
    return Table(HEADER, rows, NOTE)
