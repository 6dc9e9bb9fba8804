"""Table 2 of the paper: its printed values, and ours beside them."""

import math

import numpy as np

from pinav.commands.reproduce.result import ROWS, ModelRollout, Reproduction
from pinav.report import Cell, Paragraph, Table

HEADER = ("model", "seed", "x", "y", "vx", "vy", "total", "position")

PAPER = {
    "physics-only": (4.34, 2.46, 0.49, 0.39, 2.52, 3.53),
    "nn-only": (0.27, 0.27, 0.32, 0.28, 0.285, None),
    "ude-untrained": (3.71, 25.61, 0.59, 0.97, 12.95, None),
    "ude": (0.012, 0.013, 0.017, 0.017, 0.015, 0.0126),
}
"""The paper's printed errors: x, y, vx, vy, total; position-only from its text."""

PAPER_LOSS = (3.9e4, 4.5e-1)
"""The paper's training loss at start and end (section 3.1)."""

PAPER_STEPS = 8000
"""Steps of Adam and L-BFGS in the paper's Table 1."""

DIFFERENCES = (
    "The constants of the benchmark are identified from the paper's physics-only row, "
    "not published; they are one point of a family.",
    "NN-only: the paper prints 0.285. With the same training as the UDE, a black box "
    "that sees time fits this one trajectory far better than that, by the paper's own "
    "recipe as well as the UDE does. What tells them apart (other starts, longer "
    "horizons, the force field itself) is not in this table.",
    "UDE (untrained): depends on the random start of the network alone. The paper's "
    "own row (total 12.95) and the start of its loss curve (3.9e4, that is total 4.4) "
    "are not the same network, so no run can match both.",
    "All errors are of rollouts solved anew in float64 at tolerance 1e-11.",
)
"""Where our table and the paper's differ, and why."""


def csv_row(row: ModelRollout) -> tuple[Cell, ...]:
    """A line as it stands in `table2.csv`."""
    seed = "" if row.seed is None else row.seed
    return (row.model, seed, *(repr(row.errors[name]) for name in HEADER[2:]))


def table2_blocks(result: Reproduction) -> list[Paragraph | Table]:
    """The table beside the paper's values, its spread over seeds, and the losses."""
    return [
        _table2(result),
        *map(Paragraph, result.remarks),
        *map(Paragraph, DIFFERENCES),
        _spread(result),
        Table(
            ("ratio of median total errors", "factor"),
            list(result.improvement.items()),
            "How many times smaller the trained UDE's error is.",
        ),
        _losses(result),
    ]


def _table2(result: Reproduction) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for model in ROWS:
        rows += [
            (row.model, _seed(row), *(row.errors[name] for name in HEADER[2:]))
            for row in result.table2
            if row.model == model
        ]
        if model in PAPER:
            cells = ("–" if value is None else f"{value:g}" for value in PAPER[model])
            rows.append((f"{model}, as printed in the paper", "–", *cells))
    return Table(
        HEADER,
        rows,
        "Root-mean-square errors of rollouts from the true start, dimensionless. Total "
        "is the root mean square of the four columns.",
    )


def _spread(result: Reproduction) -> Table:
    rows = [
        (model, spread.median, spread.best, spread.worst)
        for model, spread in result.summary_total.items()
        if model not in ("physics-only", "ude-kernel")
    ]
    seeds = ", ".join(map(str, result.settings.seeds))
    caption = f"Total error over the seeds {seeds}."
    return Table(("model", "median", "best", "worst"), rows, caption)


def _losses(result: Reproduction) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for row in result.table2:
        if row.model in result.losses:
            losses = result.losses[row.model].values[result.place(row)]
            start, end = float(losses[0]), float(losses[-1])
            decades = float(np.log10(losses[0] / losses[-1]))
            steps = int(losses.size - 1)
            rows.append((row.model, _seed(row), start, end, decades, steps))
    decades = math.log10(PAPER_LOSS[0] / PAPER_LOSS[1])
    rows.append(("ude, as printed", "42", *PAPER_LOSS, decades, PAPER_STEPS))
    header = ("model", "seed", "loss at start", "at end", "decades", "iterations")
    return Table(header, rows, "Training loss, the sum of squares of eq. (3).")


def _seed(row: ModelRollout) -> str:
    return "–" if row.seed is None else str(row.seed)
