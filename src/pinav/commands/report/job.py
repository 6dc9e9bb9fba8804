"""Figures and the HTML page of a run, from its saved results alone."""

from pathlib import Path
from typing import Any

import numpy as np

from pinav.commands.analyse.report import analysis_sections
from pinav.commands.compare.job import table
from pinav.commands.discover.report import law_sections
from pinav.commands.evaluate.report import evaluation_sections
from pinav.commands.heat.report import heated
from pinav.commands.identify.report import laddered
from pinav.commands.navigate.report import navigation_sections
from pinav.commands.reproduce.job import stored_field
from pinav.commands.reproduce.report import loss_history, reproduced
from pinav.commands.study.report import studied
from pinav.errors import InputError
from pinav.figures import (
    evidence_bars,
    force_comparison,
    loss_curve,
    observed_paths,
    save_figure,
)
from pinav.figures.style import new_figure
from pinav.files import write_text
from pinav.report import Code, Image, Paragraph, Section, Table, render
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories, load

TITLES = {
    "reproduce": "The paper's benchmark",
    "fit": "A fitted model",
    "compare": "Models compared",
    "study": "A study of models",
    "recording": "A recording",
    "heat": "Bioheat",
    "navigate": "Navigation",
}


def write_report(folder: RunFolder) -> Path:
    """Draw the figures of a finished run and write its `report.html`.

    Raises:
        InputError: the run is not finished, or one of its files is damaged.
    """
    if not folder.has("metrics.json"):
        raise InputError(
            f"{folder.path} is not finished; go on with --resume, then report"
        )
    sections = {
        "reproduce": reproduced,
        "fit": _fitted,
        "compare": _compared,
        "study": studied,
        "recording": laddered,
        "heat": heated,
        "navigate": navigation_sections,
    }
    job = folder.config().get("job")
    if job not in sections:
        raise InputError(f"{folder.path}/config.toml: job {job!r} is unknown")
    title = TITLES[job]
    try:
        results = [*sections[job](folder), *evaluation_sections(folder)]
        content = [*results, *analysis_sections(folder), *_provenance(folder)]
    except KeyError as error:
        raise InputError(
            f"{folder.path}: its results miss {error}; they were written by another "
            "version of pinav: run it again with --overwrite"
        ) from error
    path = folder.path / "report.html"
    write_text(path, render(title, _subtitle(folder), content), overwrite=True)
    return path


def _subtitle(folder: RunFolder) -> str:
    environment = folder.read_json("environment.json")
    return f"pinav {environment['pinav']}, run {folder.path.name}"


def _fitted(folder: RunFolder) -> list[Section]:
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
    return [*sections, *law_sections(folder, data.units)]


def _compared(folder: RunFolder) -> list[Section]:
    """The evidence of each model, and what it says."""
    metrics = folder.read_json("metrics.json")
    rows = [(name, *map(str.strip, cells)) for name, cells in table(metrics["models"])]
    header = ("model", "log evidence", "cost of choices", "below the best", "outcome")
    figure = evidence_bars(
        {name: row["log_evidence"] for name, row in metrics["models"].items()}
    )
    files = save_figure(figure, folder.path / "figures", "evidence")
    content = [
        *(Paragraph(verdict["text"]) for verdict in metrics["verdicts"]),
        Table(header, rows, EVIDENCE_NOTE),
        Image(
            files.svg,
            "Bars: by how much the log evidence of each model is below the best",
            "Nats below the best model; the scale is logarithmic above one.",
        ),
    ]
    return [Section("The evidence", content)]


EVIDENCE_NOTE = (
    "Log evidence in nats, hyperparameters integrated out (their cost is the third "
    "column); starts and learned constants have priors of unit information."
)


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


def _provenance(folder: RunFolder) -> list[Section]:
    environment = folder.read_json("environment.json")
    config = (folder.path / "config.toml").read_text(encoding="utf-8")
    return [
        Section("Configuration", [Code(config)]),
        Section("Versions", [Table(("what", "version"), list(environment.items()))]),
    ]
