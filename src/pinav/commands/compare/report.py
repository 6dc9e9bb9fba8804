"""Sections of the report of a comparison of models."""

from pinav.commands.compare.metrics import CompareMetrics
from pinav.figures import evidence_bars, save_figure
from pinav.report import Image, Paragraph, Section
from pinav.runs import RunFolder


def comparison_sections(folder: RunFolder) -> list[Section]:
    """The evidence of each model, and the verdicts on it."""
    metrics = folder.read_metrics("metrics.json", CompareMetrics)
    figure = evidence_bars(
        {name: row.log_evidence for name, row in metrics.models.items()}
    )
    files = save_figure(figure, folder.path / "figures", "evidence")
    content = [
        *(Paragraph(verdict.text) for verdict in metrics.verdicts),
        metrics.table(),
        Image(
            files.svg,
            "Bars: by how much the log evidence of each model is below the best",
            "Nats below the best model; the scale is logarithmic above one.",
        ),
    ]
    return [Section("The evidence", content)]
