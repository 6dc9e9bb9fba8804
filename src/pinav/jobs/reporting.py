"""Figures and the HTML page of a run, from its saved results alone."""

from pathlib import Path
from typing import Any

import numpy as np

from pinav.errors import InputError
from pinav.evaluation import Decomposition
from pinav.files import write_text
from pinav.jobs.analysis_pages import analysis_sections
from pinav.jobs.compare import table
from pinav.jobs.evaluation_report import evaluated
from pinav.jobs.heat_report import heated
from pinav.jobs.law_report import law_sections
from pinav.jobs.reproduce import key_of, stored_field
from pinav.jobs.study_report import studied
from pinav.jobs.table2 import DIFFERENCES, PAPER, ROWS
from pinav.report import (
    Code,
    FigureFiles,
    Image,
    Paragraph,
    Section,
    Table,
    acceleration_figure,
    evidence_bars,
    figure1,
    force_comparison,
    loss_curve,
    observed_paths,
    render,
    save_figure,
)
from pinav.report.style import new_figure
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories
from pinav.trajectory_files import load

TITLES = {
    "reproduce": "The paper's benchmark",
    "fit": "A fitted model",
    "compare": "Models compared",
    "study": "A study of models",
    "heat": "Bioheat",
}

BARRIER = ([5.0, 5.0], 2.9)
"""Centre and width of the benchmark's barrier, drawn as context."""


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
        "reproduce": _reproduction,
        "fit": _fitted,
        "compare": _compared,
        "study": studied,
        "heat": heated,
    }
    job = folder.config().get("job")
    if job not in sections:
        raise InputError(f"{folder.path}/config.toml: job {job!r} is unknown")
    title = TITLES[job]
    try:
        results = [*sections[job](folder), *evaluated(folder)]
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


def _reproduction(folder: RunFolder) -> list[Section]:
    metrics = folder.read_json("metrics.json")
    arrays = folder.read_arrays("results.npz")
    seed = metrics["seeds"][0]
    return [
        Section("Table 2", _table2(metrics)),
        Section("Figure 1: the UDE", [_figure1(folder, arrays, seed, "ude")]),
        Section(
            "Figure 1 for the network alone",
            [
                Paragraph("The paper left this figure out."),
                _figure1(folder, arrays, seed, "nn-only"),
            ],
        ),
        *_kernel_figure(folder, arrays),
        Section("The learned force", _forces(folder, metrics, arrays, seed)),
        Section("What makes up the acceleration", [_parts(folder, arrays, seed)]),
    ]


def _table2(metrics: dict[str, Any]) -> list[Paragraph | Table]:
    columns = ("x", "y", "vx", "vy", "total", "position")
    rows: list[tuple] = []
    for row in metrics["table2"]:
        label = "–" if row["seed"] is None else str(row["seed"])
        rows.append((row["model"], label, *(row[name] for name in columns)))
    for model in PAPER:
        printed = metrics["paper_table2"][model]
        cells = ("–" if printed[n] is None else f"{printed[n]:g}" for n in columns)
        rows.append((f"{model}, as printed in the paper", "–", *cells))
    factors = [(name, factor) for name, factor in metrics["improvement"].items()]
    return [
        Table(
            ("model", "seed", *columns),
            [row for model in ROWS for row in rows if row[0].split(",")[0] == model],
            "Root-mean-square errors of rollouts from the true start, dimensionless. "
            "Total is the root mean square of the four columns.",
        ),
        *(Paragraph(text) for text in DIFFERENCES),
        _spread(metrics),
        Table(
            ("ratio of median total errors", "factor"),
            factors,
            "How many times smaller the trained UDE's error is.",
        ),
        _losses(metrics),
    ]


def _spread(metrics: dict[str, Any]) -> Table:
    rows = [
        (model, spread["median"], spread["best"], spread["worst"])
        for model, spread in metrics["summary_total"].items()
        if model not in ("physics-only", "ude-kernel")
    ]
    seeds = ", ".join(map(str, metrics["seeds"]))
    caption = f"Total error over the seeds {seeds}."
    return Table(("model", "median", "best", "worst"), rows, caption)


def _losses(metrics: dict[str, Any]) -> Table:
    rows = [
        (model, seed, loss["start"], loss["end"], loss["decades"], loss["iterations"])
        for model, losses in metrics["loss"].items()
        for seed, loss in losses.items()
    ]
    paper = metrics["paper_loss"]
    decades = float(np.log10(paper["start"] / paper["end"]))
    printed = (paper["start"], paper["end"], decades, 8000)
    rows.append(("ude, as printed", "42", *printed))
    header = ("model", "seed", "loss at start", "at end", "decades", "iterations")
    return Table(header, rows, "Training loss, the sum of squares of eq. (3).")


def _figure1(
    folder: RunFolder, arrays: dict[str, np.ndarray], seed: int | None, model: str
) -> Image:
    losses, phases = _loss_history(folder, model)
    figure = figure1(
        arrays["times"],
        arrays["truth"],
        arrays[key_of(f"{model}-untrained", seed)],
        arrays[key_of(model, seed)],
        losses,
        phases,
        model=model,
        barrier=BARRIER,
    )
    files = save_figure(figure, folder.path / "figures", f"figure1-{model}")
    return _image(
        files,
        f"Trajectory, velocity and training loss of the model {model}",
        f"{key_of(model, seed)}: (a, b) trajectory, (c) training loss with the "
        "change of phase marked, (d, e) velocity; before and after training, against "
        "the truth. Dimensionless, synthetic data.",
    )


def _loss_history(
    folder: RunFolder, name: str
) -> tuple[np.ndarray, list[tuple[str, int]]]:
    stored = folder.read_arrays(f"losses-{name}.npz")
    names, starts = stored["phase_names"], stored["phase_starts"]
    phases = [(str(n), int(start)) for n, start in zip(names, starts, strict=True)]
    return stored["losses"], phases


def _kernel_figure(folder, arrays) -> list[Section]:
    if "ude-kernel" not in arrays:
        return []
    text = (
        "The same physics with a static kernel potential in place of the network: "
        "linear in its weights, and nothing random in it."
    )
    image = _figure1(folder, arrays, None, "ude-kernel")
    return [Section("Figure 1 for the kernel residual", [Paragraph(text), image])]


def _forces(folder, metrics, arrays, seed) -> list[Paragraph | Image | Table]:
    rows = [
        (label, *(100 * errors[k] for k in ("visited", "near", "everywhere")))
        for label, errors in metrics["force_error"].items()
    ]
    drawn = [
        name for name in (f"ude-{seed}", "ude-kernel") if f"field/{name}" in arrays
    ]
    return [
        *(_force(folder, arrays, label) for label in drawn),
        Table(
            ("model", "visited (%)", "near (%)", "everywhere (%)"),
            rows,
            "Relative L2 error of the force on grid points within 0.35 of a sample, "
            "within 1.0, and on the whole grid.",
        ),
        Paragraph(
            "One trajectory does not determine the field: away from the path the "
            "learned force is an extrapolation, whatever the trajectory error says. "
            "The network also sees time; each point shows the time of the nearest "
            "sample, the reading most favourable to it."
        ),
    ]


def _force(folder, arrays, label: str) -> Image:
    true, learned = stored_field(arrays, "true"), stored_field(arrays, label)
    figure = force_comparison(learned, true=true, path=arrays["truth"][:, :2])
    files = save_figure(figure, folder.path / "figures", f"force-{label}")
    return _image(
        files,
        "True force, learned force and their difference on a grid",
        f"The true force, that of {label}, and the difference.",
    )


def _parts(folder, arrays, seed) -> Image:
    prefix = f"parts/ude-{seed}/"
    terms = {
        name.removeprefix(prefix): values
        for name, values in arrays.items()
        if name.startswith(prefix)
    }
    learned = Decomposition(arrays["times"], terms)
    true_terms = terms | {"environment": arrays["parts/true"]}
    truth = Decomposition(arrays["times"], true_terms)
    files = save_figure(
        acceleration_figure(learned, true=truth),
        folder.path / "figures",
        "acceleration",
    )
    return _image(
        files,
        "Propulsion, learned environment and drag along the trajectory",
        "a(t) = propulsion + environment + drag along the true trajectory, UDE of "
        f"seed {seed}.",
    )


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
        _image(
            files,
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
        loss_curve(*_loss_history(folder, "model"), ax=axes[1])
        caption += " Right: training loss."
    files = save_figure(figure, folder.path / "figures", "fit")
    return _image(files, "Observed trajectories and rollouts of the model", caption)


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
        _image(
            files,
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


def _image(files: FigureFiles, alt: str, caption: str) -> Image:
    return Image(files.svg, alt, caption)
