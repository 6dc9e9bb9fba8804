"""`pinav evaluate`: the models of a run, scored on trajectories."""

from pathlib import Path
from typing import Any

from pinav.errors import InputError
from pinav.evaluation import predict, score
from pinav.jobs.fit import score_metrics
from pinav.jobs.models import build_model
from pinav.jobs.table2 import number
from pinav.runs import RunFolder
from pinav.trajectory_files import load


def evaluate(run: Path, data: Path) -> dict[str, Any]:
    """Score every model of the run on the trajectories of a file.

    Raises:
        InputError: the run holds no model, or a file cannot be read.
    """
    folder = RunFolder.open(run)
    names = folder.models()
    if not names:
        raise InputError(f"{run} holds no model yet; finish it with --resume")
    trajectories = load(data)
    metrics = {}
    for name in names:
        model = folder.read_model(name, build_model)
        predictions, outcomes = predict(model, trajectories)
        result = score(predictions, outcomes, trajectories)
        metrics[name.removesuffix(".eqx")] = score_metrics(result) | {
            "diverged": sum(bool(outcome) for outcome in outcomes)
        }
    return {"data": data.name, "trajectories": len(trajectories), "rmse": metrics}


def text(metrics: dict[str, Any]) -> str:
    """The metrics for a terminal."""
    rows = metrics["rmse"]
    columns = list(next(iter(rows.values())))
    width = max(map(len, rows))
    lines = [f"{'':<{width}}" + "".join(f"{column:>10}" for column in columns)]
    for name, row in rows.items():
        cells = "".join(f"{_cell(row[column]):>10}" for column in columns)
        lines.append(f"{name:<{width}}{cells}")
    return "\n".join(lines)


def _cell(value: float | int) -> str:
    return str(value) if isinstance(value, int) else number(value)
