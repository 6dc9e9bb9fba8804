"""One cell of the benchmark: a system, a way to fit it, a seed."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec

from benchmarks._sweep import write_measurement
from benchmarks.trainer.systems import CENTER, BenchmarkSystem, benchmark_system
from pinav.dynamics import Swimmer
from pinav.evaluation import (
    field_map,
    force_error_at_samples,
    force_errors,
    predict,
    score,
)
from pinav.fitting import (
    Cause,
    Outcome,
    confirm,
    diagnose,
    fit_bayes,
    kernel_environment,
)
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import (
    ModelChoice,
    learned_part,
    summarise_for_matching,
)
from pinav.forces import KernelPotential, SumForce, gaussian_swirl
from pinav.learning.matching import matching
from pinav.learning.recipes import Curriculum, Paper
from pinav.sweeps import Cell
from pinav.systems import System
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
        samples: relative error of the force at the samples; None without a force.
        near: the same on a map, near the data (`pinav.evaluation.Regions`).
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
    samples: float | None = None
    near: float | None = None


FAILED = 1e-2
"""Error of a fit whose cause is looked for."""


Ending = tuple[Any, Outcome, float]
"""A fitted model, how its fit ended, and the residual of its own rollouts, which is
infinite where noise decides it."""


def _truth(drawn: BenchmarkSystem) -> System:
    return drawn.system


@dataclasses.dataclass(frozen=True)
class Column:
    """A way to fit a system, or a reason why no fit to it can succeed.

    Attributes:
        fit: fits the known physics and what is learned beside them.
        truth: the system that is observed.
        wrong: factor by which the drag that the fit is told is wrong.
        cause: the cause that a failed fit should name.
    """

    fit: Callable[[Any, Trajectories, int], Ending]
    truth: Callable[[BenchmarkSystem], System] = _truth
    wrong: float = 1.0
    cause: Cause | None = None

    def known(self, drawn: BenchmarkSystem) -> Swimmer:
        """The physics that the fit is told."""
        swimmer: Any = drawn.system.swimmer
        damping = self.wrong * swimmer.drag.damping
        return eqx.tree_at(lambda s: s.drag.damping, swimmer, damping)


def _by_matching(model: str, recipe: str) -> Callable[[Any, Trajectories, int], Ending]:
    def run(known: Any, data: Trajectories, seed: int) -> Ending:
        choice = ModelChoice(model, seed=seed)
        summary = summarise_for_matching(choice, known, data)
        untrained = build(choice, known, summary)
        method = matching(
            Paper() if recipe == "paper" else Curriculum(), data, untrained
        )
        (result,) = method.fit(
            [untrained],
            data,
            trainable=learned_part,
        )
        residual = float((result.losses[-1] / data.num_observed) ** 0.5)
        return result.model, result.outcome, residual

    return run


def _by_evidence(known: Any, data: Trajectories, seed: int) -> Ending:
    del seed
    model = known.with_environment(kernel_environment(KernelPotential, data))
    result = fit_bayes(model, data, throw=False)
    return result.model, result.outcome, float("inf")


def _noisy(drawn: BenchmarkSystem) -> System:
    return eqx.tree_at(lambda s: s.observation.noise, drawn.system, NOISE)


def _crossing(drawn: BenchmarkSystem) -> System:
    """From eight sides, at two speeds: a field along one path explains anything."""
    start, paths = drawn.system.starts[0], []
    for turn in range(8):
        angle = turn * jnp.pi / 4
        rotate = jnp.asarray(
            [[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]]
        )
        speed = 1.0 if turn % 2 == 0 else 1.5
        position, velocity = rotate @ (start[:2] - CENTER), rotate @ start[2:]
        paths.append(jnp.concatenate([CENTER + position, speed * velocity]))
    return dataclasses.replace(drawn.system, starts=jnp.stack(paths))


def _swirling(drawn: BenchmarkSystem) -> System:
    """With a swirl about the same centre, whose largest force is half the barrier's."""
    speed = float(jnp.max(jnp.linalg.norm(drawn.system.starts[:, 2:], axis=1)))
    swirl = gaussian_swirl(0.25 * speed**2, CENTER, drawn.width)
    barrier: Any = drawn.system.environment
    crossing = _crossing(drawn)
    return dataclasses.replace(crossing, environment=SumForce((barrier, swirl)))


def _coarse(drawn: BenchmarkSystem) -> System:
    """Observed so seldom that the force changes much between two samples."""
    apart = drawn.width / float(jnp.max(jnp.abs(drawn.system.starts[:, 2:])))
    every = max(round(apart / 0.1), 2)
    crossing = _crossing(drawn)
    return dataclasses.replace(crossing, times=drawn.system.times[::every])


_POTENTIAL = _by_matching("neural-potential", "curriculum")

COLUMNS: dict[str, Column] = {
    "network": Column(_by_matching("ude", "curriculum")),
    "kernel": Column(_by_matching("kernel-potential", "curriculum")),
    "black-box": Column(_by_matching("nn-only", "curriculum")),
    "paper": Column(_by_matching("paper-ude", "paper")),
    "noisy-kernel": Column(_by_evidence, _noisy),
    "wrong-drag": Column(_POTENTIAL, _crossing, wrong=1.3, cause=Cause.PHYSICS),
    "swirl": Column(_POTENTIAL, _swirling, cause=Cause.NO_POTENTIAL),
    "coarse": Column(_POTENTIAL, _coarse, cause=Cause.SAMPLES),
}
"""Ways to fit by name. With the last three a potential without time should
fail: the drag is 30 % too large, a swirl is added, or samples are a width apart."""

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
    drawn, way = benchmark_system(key), COLUMNS[column]
    truth = way.truth(drawn)
    data = simulate(truth, key=jax.random.key(key))
    clean = data
    if truth.observation.noise > 0:
        clean = simulate(eqx.tree_at(lambda s: s.observation.noise, truth, 0.0))
    start, spent = time.perf_counter(), time.process_time()
    model, outcome, residual = way.fit(way.known(drawn), data, seed)
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
            **_force_errors(model, truth, clean),
        ),
    )


def _force_errors(model: Any, truth: System, data: Trajectories) -> dict[str, float]:
    if not isinstance(model, Swimmer) or truth.environment is None:
        return {}
    pair = model.environment, truth.environment
    learned, true = (field_map(force, data) for force in pair)
    near = force_errors(learned, true)["near"]
    return {"samples": force_error_at_samples(*pair, data), "near": near}


def _cause(model: Any, data: Trajectories) -> str:
    cause = diagnose(model, data) if isinstance(model, Swimmer) else None
    return "" if cause is None else cause.name.lower()
