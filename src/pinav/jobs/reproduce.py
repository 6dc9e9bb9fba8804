"""`pinav reproduce`: the paper's experiment, from nothing to its table and figures."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pinav.dynamics import AbstractDynamics, Swimmer
from pinav.evaluation import (
    FieldMap,
    decompose,
    field_map,
    force_errors,
    predict,
    score,
)
from pinav.fitting import Fit, fit_many, paper_recipe
from pinav.forces import ZeroForce
from pinav.jobs.fit import write_losses
from pinav.jobs.models import PAPER_MODELS, build_model, residual
from pinav.jobs.progress import FitReporter
from pinav.jobs.settings import ReproduceSettings
from pinav.jobs.table2 import HEADER, PAPER, PAPER_LOSS, Row, improvements, summary
from pinav.runs import RunFolder
from pinav.scenarios import Scenario, scenario
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories, simulate
from pinav.trajectory_files import load, save


def reproduce(settings: ReproduceSettings, folder: RunFolder) -> list[Row]:
    """Simulate the benchmark, train UDE and NN-only, score, and write the results.

    Whatever the folder already holds is not computed again.

    Args:
        settings: recipe and seeds.
        folder: the run.

    Returns:
        The rows of Table 2.
    """
    benchmark = scenario("paper")
    data = _data(benchmark, folder)
    for name in PAPER_MODELS:
        if not _fitted(name, settings.seeds, folder):
            _write_fits(
                name, settings.seeds, _fit(name, settings, data, folder), folder
            )
    rows, arrays = _evaluate(benchmark, data, settings.seeds, folder)
    folder.write_table("table2.csv", HEADER, [row.cells for row in rows])
    folder.write_arrays("results.npz", arrays)
    folder.write_json("metrics.json", _metrics(settings, rows, arrays, folder))
    return rows


def _data(benchmark: Scenario, folder: RunFolder) -> Trajectories:
    if not folder.has("data.npz"):
        save(simulate(benchmark), folder.path / "data.npz")
    return load(folder.path / "data.npz")


def _fitted(name: str, seeds: Sequence[int], folder: RunFolder) -> bool:
    return all(folder.has(model_file(name, seed)) for seed in seeds)


def model_file(name: str, seed: int) -> str:
    """Name of the file that holds a trained model."""
    return f"model-{name}-{seed}.eqx"


def _fit(name, settings, data, folder) -> list[Fit]:
    known = scenario("paper").truth
    with FitReporter(folder, name) as report:
        return fit_many(
            [PAPER_MODELS[name](known, seed) for seed in settings.seeds],
            data,
            paper_recipe(settings.adam_steps, settings.lbfgs_steps),
            trainable=residual,
            dtype=jnp.float32,
            checkpoint=folder.checkpoint(name),
            on_chunk=report,
        )


def _write_fits(name, seeds, fits: Sequence[Fit], folder: RunFolder) -> None:
    """Write losses first: a model file says that all of its fit is there."""
    write_losses(name, fits, folder)
    for seed, fit in zip(seeds, fits, strict=True):
        header = {
            "kind": "paper",
            "name": name,
            "seed": seed,
            "physics": "paper",
            "dtype": "float32",
        }
        folder.write_model(model_file(name, seed), header, fit.model)


def _evaluate(benchmark, data, seeds, folder):
    """Score every model; return the rows and the arrays behind the figures."""
    arrays = {"times": data.times[0], "truth": data.states[0]}
    rows = []

    def add(model: str, seed: int | None, dynamics: AbstractDynamics) -> None:
        predictions, outcomes = predict(dynamics, data)
        rows.append(Row(model, seed, score(predictions, outcomes, data)))
        arrays[_key(model, seed)] = predictions[0]

    add("physics-only", None, _without_environment(benchmark.truth))
    trained = {
        (name, seed): folder.read_model(model_file(name, seed), build_model)
        for name in PAPER_MODELS
        for seed in seeds
    }
    for seed in seeds:
        add("nn-only", seed, trained["nn-only", seed])
    for name in ("nn-only-untrained", "ude-untrained"):
        build = PAPER_MODELS[name.removesuffix("-untrained")]
        for seed in seeds:
            add(name, seed, build(benchmark.truth, seed))
    for seed in seeds:
        add("ude", seed, trained["ude", seed])
        arrays |= _force_arrays(benchmark.truth, trained["ude", seed], seed, data)
        for name in PAPER_MODELS:
            own, _ = predict(trained[name, seed], data, solver=FixedStep())
            arrays[f"{_key(name, seed)}/own"] = own[0]
    rows = [row for row in rows if row.model in PAPER]
    return rows, arrays


def _without_environment(truth: Swimmer) -> Swimmer:
    return eqx.tree_at(lambda swimmer: swimmer.environment, truth, ZeroForce())


def _force_arrays(truth, swimmer, seed, data) -> dict[str, np.ndarray]:
    """The true and the learned field, and the parts of the acceleration."""
    true = field_map(truth.environment, data)
    learned = field_map(swimmer.environment, data)
    parts = decompose(swimmer, data.times[0], data.states[0])
    true_parts = decompose(truth, data.times[0], data.states[0])
    arrays = {
        "field/x": true.x,
        "field/y": true.y,
        "field/distance": true.distance,
        "field/true": true.force,
        f"field/ude-{seed}": learned.force,
        "parts/true": true_parts.terms["environment"],
    }
    parts_of = {f"parts/ude-{seed}/{name}": a for name, a in parts.terms.items()}
    return arrays | parts_of


def _key(model: str, seed: int | None) -> str:
    return model if seed is None else f"{model}-{seed}"


def _metrics(settings, rows, arrays, folder) -> dict[str, Any]:
    """Everything that a script would ask for; nothing that varies with the clock."""
    losses = {name: folder.read_arrays(f"losses-{name}.npz") for name in PAPER_MODELS}
    return {
        "recipe": settings.recipe,
        "seeds": list(settings.seeds),
        "table2": [
            {"model": row.model, "seed": row.seed}
            | dict(zip(HEADER[2:], row.errors, strict=True))
            for row in rows
        ],
        "paper_table2": {
            k: dict(zip(HEADER[2:], v, strict=True)) for k, v in PAPER.items()
        },
        "summary_total": summary(rows),
        "improvement": improvements(rows),
        "loss": {name: _losses(settings.seeds, losses[name]) for name in PAPER_MODELS},
        "paper_loss": PAPER_LOSS,
        "own_integrator_total": {
            _key(name, seed): _own_total(arrays, _key(name, seed))
            for name in PAPER_MODELS
            for seed in settings.seeds
        },
        "force_error": {
            str(seed): _force_error(arrays, seed) for seed in settings.seeds
        },
    }


def _losses(seeds, stored) -> dict[str, dict[str, Any]]:
    return {
        str(seed): {
            "start": float(losses[0]),
            "end": float(losses[-1]),
            "decades": float(np.log10(losses[0] / losses[-1])),
            "diverged": bool(diverged),
        }
        for seed, losses, diverged in zip(
            seeds, stored["losses"], stored["diverged"], strict=True
        )
    }


def _own_total(arrays, key) -> float:
    """Total error as the integrator of the fit sees it."""
    difference = arrays[f"{key}/own"] - arrays["truth"]
    return float(np.sqrt(np.mean(difference**2)))


def _force_error(arrays, seed) -> dict[str, float]:
    return force_errors(
        stored_field(arrays, f"ude-{seed}"), stored_field(arrays, "true")
    )


def stored_field(arrays: dict[str, np.ndarray], name: str) -> FieldMap:
    """The field map of that name in `results.npz`."""
    return FieldMap(
        arrays["field/x"],
        arrays["field/y"],
        arrays[f"field/{name}"],
        arrays["field/distance"],
    )
