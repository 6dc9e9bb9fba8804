"""Sections of the report of a fit: its errors, its constants, the learned force."""

from typing import Any

import numpy as np

from pinav.commands.reproduce.job import stored_field
from pinav.commands.reproduce.report import loss_history
from pinav.figures import force_comparison, loss_curve, observed_paths, save_figure
from pinav.figures.style import new_figure
from pinav.report import Image, Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories, load


def fit_sections(folder: RunFolder) -> list[Section]:
    """The sections of the report of a fit."""
    metrics = folder.read_json("metrics.json")
    data = load(folder.path / "data.npz")
    arrays = folder.read_arrays("results.npz")
    chosen = {
        k: metrics[k] for k in ("noise", "log_evidence", "iterations") if k in metrics
    }
    content = [
        _one_row(metrics["rmse"], "Root-mean-square errors of rollouts."),
        *([_one_row(chosen, "What the evidence chose.")] if chosen else []),
        *([_one_row(metrics["loss"], "Training loss.")] if "loss" in metrics else []),
        *_constants(metrics),
        _paths(folder, data, arrays),
    ]
    sections = [Section(f"The fit: {metrics['model']}, {metrics['recipe']}", content)]
    if "field/learned" in arrays:
        sections.append(
            Section("The learned force", _learned_force(folder, data, arrays, metrics))
        )
    return sections


def _paths(folder: RunFolder, data: Trajectories, arrays) -> Image:
    """All trajectories, and the loss where the recipe has one."""
    with_loss = folder.has("losses-model.npz")
    figure = new_figure(7.5 if with_loss else 4.2, 3.4)
    axes = figure.subplots(1, 2) if with_loss else [figure.subplots()]
    observed_paths(
        [np.where(p.observed[:, :2], p.states[:, :2], np.nan) for p in data],
        [ys[:n, :2] for ys, n in zip(arrays["ys"], data.lengths, strict=True)],
        units=data.units,
        ax=axes[0],
    )
    caption = "Observed positions and rollouts of the fitted model."
    if with_loss:
        loss_curve(*loss_history(folder, "model"), ax=axes[1])
        caption += " Right: training loss."
    files = save_figure(figure, folder.path / "figures", "fit")
    return Image(files.svg, "Observed trajectories and rollouts of the model", caption)


def _learned_force(folder, data, arrays, metrics) -> list[Paragraph | Image | Table]:
    """Maps of the force, with what is known of its truth and of its uncertainty."""
    true = stored_field(arrays, "true") if "field/true" in arrays else None
    figure = force_comparison(
        stored_field(arrays, "learned"),
        true=true,
        sd=arrays.get("field/sd"),
        path=_joined(data),
        units=data.units,
    )
    files = save_figure(figure, folder.path / "figures", "force")
    content: list[Paragraph | Image | Table] = [
        Image(
            files.svg,
            "Maps of the learned force and of how well it is known",
            "The force of the environment on a swimmer at rest. Hatched: farther than "
            "1 from any sample, an extrapolation.",
        )
    ]
    if "force_error" in metrics:
        errors = {f"{k} (%)": 100 * v for k, v in metrics["force_error"].items()}
        content.append(
            _one_row(
                errors,
                "Relative L2 error of the force against the scenario's truth, on grid "
                "points within 0.35 of a sample, within 1.0, and on the whole grid.",
            )
        )
    return content


def _joined(data: Trajectories) -> np.ndarray:
    """All observed paths in one array, a row of NaN between two."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate(
        [
            part
            for p in data
            for part in (np.where(p.observed[:, :2], p.states[:, :2], np.nan), gap)
        ]
    )


def _constants(metrics: dict[str, Any]) -> list[Table]:
    rows = [
        (name, learned["value"], "–" if learned["sd"] is None else learned["sd"])
        for name, learned in metrics["learned"].items()
    ]
    header = ("constant", "value", "standard deviation")
    return [Table(header, rows, "Constants learned.")] if rows else []


def _one_row(values: dict[str, float], caption: str) -> Table:
    return Table(tuple(values), [tuple(values.values())], caption)
