"""Sections of the report of a reproduction: Table 2, Figure 1, the learned force."""

import numpy as np

from pinav.commands.reproduce.job import key_of
from pinav.commands.reproduce.metrics import ReproduceMetrics
from pinav.commands.reproduce.table2 import DIFFERENCES, HEADER, ROWS
from pinav.evaluation import Decomposition, FieldMap
from pinav.figures import acceleration_figure, figure1, force_comparison, save_figure
from pinav.learning.matching import Losses
from pinav.report import Image, Paragraph, Section, Table
from pinav.runs import RunFolder

BARRIER = ([5.0, 5.0], 2.9)
"""Centre and width of the benchmark's barrier, drawn as context."""


def reproduction_sections(folder: RunFolder) -> list[Section]:
    """The sections of the report of `pinav reproduce`."""
    metrics = folder.read_metrics("metrics.json", ReproduceMetrics)
    arrays = folder.read_arrays("results.npz")
    seed = metrics.seeds[0]
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


def _table2(metrics: ReproduceMetrics) -> list[Paragraph | Table]:
    rows: list[tuple] = []
    for row in metrics.table2:
        label = "–" if row.seed is None else str(row.seed)
        rows.append((row.model, label, *row.errors))
    for model, printed in metrics.paper_table2.items():
        cells = ("–" if value is None else f"{value:g}" for value in printed.values)
        rows.append((f"{model}, as printed in the paper", "–", *cells))
    return [
        Table(
            HEADER,
            [row for model in ROWS for row in rows if row[0].split(",")[0] == model],
            "Root-mean-square errors of rollouts from the true start, dimensionless. "
            "Total is the root mean square of the four columns.",
        ),
        *map(Paragraph, metrics.remarks),
        *(Paragraph(text) for text in DIFFERENCES),
        _spread(metrics),
        Table(
            ("ratio of median total errors", "factor"),
            list(metrics.improvement.items()),
            "How many times smaller the trained UDE's error is.",
        ),
        _losses(metrics),
    ]


def _spread(metrics: ReproduceMetrics) -> Table:
    rows = [
        (model, spread.median, spread.best, spread.worst)
        for model, spread in metrics.summary_total.items()
        if model not in ("physics-only", "ude-kernel")
    ]
    seeds = ", ".join(map(str, metrics.seeds))
    caption = f"Total error over the seeds {seeds}."
    return Table(("model", "median", "best", "worst"), rows, caption)


def _losses(metrics: ReproduceMetrics) -> Table:
    rows = [
        (model, seed, loss.start, loss.end, loss.decades, loss.iterations)
        for model, losses in metrics.loss.items()
        for seed, loss in losses.items()
    ]
    paper = metrics.paper_loss
    decades = float(np.log10(paper.start / paper.end))
    printed = (paper.start, paper.end, decades, 8000)
    rows.append(("ude, as printed", "42", *printed))
    header = ("model", "seed", "loss at start", "at end", "decades", "iterations")
    return Table(header, rows, "Training loss, the sum of squares of eq. (3).")


def _figure1(
    folder: RunFolder, arrays: dict[str, np.ndarray], seed: int | None, model: str
) -> Image:
    losses = folder.load(f"losses-{model}", Losses)
    figure = figure1(
        arrays["times"],
        arrays["truth"],
        arrays[key_of(f"{model}-untrained", seed)],
        arrays[key_of(model, seed)],
        losses.values,
        losses.phases,
        model=model,
        barrier=BARRIER,
    )
    files = save_figure(figure, folder.path / "figures", f"figure1-{model}")
    return Image(
        files.svg,
        f"Trajectory, velocity and training loss of the model {model}",
        f"{key_of(model, seed)}: (a, b) trajectory, (c) training loss with the "
        "change of phase marked, (d, e) velocity; before and after training, against "
        "the truth. Dimensionless, synthetic data.",
    )


def _kernel_figure(folder: RunFolder, arrays: dict[str, np.ndarray]) -> list[Section]:
    if "ude-kernel" not in arrays:
        return []
    text = (
        "The same physics with a static kernel potential in place of the network: "
        "linear in its weights, and nothing random in it."
    )
    image = _figure1(folder, arrays, None, "ude-kernel")
    return [Section("Figure 1 for the kernel residual", [Paragraph(text), image])]


def _forces(
    folder: RunFolder,
    metrics: ReproduceMetrics,
    arrays: dict[str, np.ndarray],
    seed: int,
) -> list[Paragraph | Image | Table]:
    rows = [(label, *errors.percent) for label, errors in metrics.force_error.items()]
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


def _force(folder: RunFolder, arrays: dict[str, np.ndarray], label: str) -> Image:
    true, learned = (
        FieldMap.of_arrays(arrays, "true"),
        FieldMap.of_arrays(arrays, label),
    )
    figure = force_comparison(learned, true=true, path=arrays["truth"][:, :2])
    files = save_figure(figure, folder.path / "figures", f"force-{label}")
    return Image(
        files.svg,
        "True force, learned force and their difference on a grid",
        f"The true force, that of {label}, and the difference.",
    )


def _parts(folder: RunFolder, arrays: dict[str, np.ndarray], seed: int) -> Image:
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
    return Image(
        files.svg,
        "Propulsion, learned environment and drag along the trajectory",
        "a(t) = propulsion + environment + drag along the true trajectory, UDE of "
        f"seed {seed}.",
    )
