"""One cell of the benchmark: a system, a way to fit it, a seed."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec

from benchmarks._sweep import write_measurement
from benchmarks.trainer.systems import BenchmarkSystem, benchmark_system
from pinav.commands.matching import CurriculumSettings, matching
from pinav.dynamics import Swimmer
from pinav.evaluation import predict, score
from pinav.evaluation.force_fields import field_map, force_errors
from pinav.fitting import Outcome, confirm, diagnose, fit_bayes, kernel_environment
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.choice import ModelChoice, learned_part
from pinav.fitting.environments.summary import summarise_for_matching
from pinav.forces import KernelPotential
from pinav.sweeps import Cell
from pinav.trajectories import Trajectories, simulate


class Measurement(msgspec.Struct, frozen=True):
    """What a fit achieved.

    Attributes:
        key: of the system.
        column: the way it was fitted.
        seed: of the network.
        rmse: of rollouts from the true starts, all states; infinite when diverged.
        seconds: of the fit, compilation included.
        processor_seconds: of all threads of the process meanwhile, which other work on
            the machine hardly changes.
        outcome: the word for how the fit ended.
        encounter: what the first trajectory does.
        form: of the potential.
        width: of the potential [L].
        cause: of an error above `FAILED`, as `diagnose` tells it.
        visited: relative error of the force within a short distance of the data
            (`pinav.evaluation.Regions`); None without a force.
        near: the same within a longer distance.
    """

    key: int
    column: str
    seed: int
    rmse: float
    seconds: float
    processor_seconds: float
    outcome: str
    encounter: str
    form: str
    width: float
    cause: str = ""
    visited: float | None = None
    near: float | None = None


FAILED = 1e-2
"""Error of a fit whose cause is looked for."""


Ending = tuple[Any, Outcome, float]
"""A fitted model, how its fit ended, and the residual of its own rollouts, which is
infinite where noise decides it."""


def _by_matching(model: str, recipe: str) -> Callable[..., Ending]:
    def run(drawn: BenchmarkSystem, data: Trajectories, seed: int) -> Ending:
        choice = ModelChoice(model, seed=seed)
        known: Any = drawn.system.swimmer
        summary = summarise_for_matching(choice, known, data)
        untrained = build(choice, known, summary)
        method = matching(CurriculumSettings(recipe), data, untrained)
        (result,) = method.fit(
            [untrained],
            data,
            trainable=learned_part,
        )
        residual = float((result.losses[-1] / data.num_observed) ** 0.5)
        return result.model, result.outcome, residual

    return run


def _by_evidence(drawn: BenchmarkSystem, data: Trajectories, seed: int) -> Ending:
    del seed
    known: Any = drawn.system.swimmer
    model = known.with_environment(kernel_environment(KernelPotential, data))
    result = fit_bayes(model, data, throw=False)
    return result.model, result.outcome, float("inf")


COLUMNS: dict[str, Callable[..., Ending]] = {
    "network": _by_matching("ude", "curriculum"),
    "kernel": _by_matching("kernel-potential", "curriculum"),
    "black-box": _by_matching("nn-only", "curriculum"),
    "paper": _by_matching("paper-ude", "paper"),
    "noisy-kernel": _by_evidence,
}
"""Ways to fit by name; the last one is given data with noise."""

SEEDLESS = ("kernel", "noisy-kernel")
"""Ways without a network, which has a seed."""

NOISE = 1e-3
"""Of the noisy data."""


class TrainerCell(msgspec.Struct, frozen=True):
    """What decides a fit beside the system and the seed.

    Attributes:
        column: the way to fit.
    """

    column: str


def cell_of(key: int, column: str, seed: int) -> Cell:
    """The cell of a system, a way to fit it and a seed."""
    return Cell.of(
        "benchmarks.trainer.cells:measure",
        TrainerCell(column),
        system=str(key),
        seed=seed,
        label=f"{column} {key} {seed}",
    )


def measure(cell: Cell, folder: Path) -> None:
    """Fit and score one cell."""
    key, column, seed = int(cell.system), cell.read(TrainerCell).column, cell.seed
    drawn = benchmark_system(key)
    clean = data = simulate(drawn.system)
    if column == "noisy-kernel":
        noisy = eqx.tree_at(lambda s: s.observation.noise, drawn.system, NOISE)
        data = simulate(noisy, key=jax.random.key(key))
    start, spent = time.perf_counter(), time.process_time()
    model, outcome, residual = COLUMNS[column](drawn, data, seed)
    jax.block_until_ready(eqx.filter(model, eqx.is_array))
    seconds, spent = time.perf_counter() - start, time.process_time() - spent
    rmse = score(*predict(model, clean), clean).total
    outcome = confirm(outcome, residual, rmse, float(clean.states.std()))
    write_measurement(
        folder,
        Measurement(
            key=key,
            column=column,
            seed=seed,
            rmse=rmse if jnp.isfinite(rmse) else 1e300,
            seconds=seconds,
            processor_seconds=spent,
            outcome=str(outcome),
            encounter=drawn.encounter,
            form=drawn.form,
            width=drawn.width,
            cause=_cause(model, clean) if not rmse <= FAILED else "",
            **_force_errors(model, drawn, clean),
        ),
    )


def _force_errors(
    model: Any, drawn: BenchmarkSystem, data: Trajectories
) -> dict[str, float]:
    if not isinstance(model, Swimmer) or drawn.system.environment is None:
        return {}
    pair = model.environment, drawn.system.environment
    learned, true = (field_map(force, data) for force in pair)
    errors = force_errors(learned, true)
    return {name: errors[name] for name in ("visited", "near")}


def _cause(model: Any, data: Trajectories) -> str:
    cause = diagnose(model, data) if isinstance(model, Swimmer) else None
    return "" if cause is None else cause.name.lower()
