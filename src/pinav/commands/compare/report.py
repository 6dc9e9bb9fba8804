"""Sections of the report of a comparison of models."""

from pinav.commands.compare.metrics import CompareMetrics
from pinav.figures import evidence_bars
from pinav.figures.images import Figures
from pinav.report import Paragraph, Section
from pinav.runs import RunFolder


def comparison_sections(folder: RunFolder) -> list[Section]:
    """The evidence of each model, and the verdicts on it."""
    metrics = folder.read_metrics("metrics.json", CompareMetrics)
    figure = evidence_bars(
        {name: row.log_evidence for name, row in metrics.models.items()}
    )
    content = [
        *(Paragraph(verdict.text) for verdict in metrics.verdicts),
        metrics.table(),
        Figures(folder.path).image(
            "evidence",
            figure,
            "Nats below the best model; the scale is logarithmic above one.",
            alt="Bars: by how much the log evidence of each model is below the best",
        ),
    ]
    return [Section("The evidence", content)]
