"""Work that an accelerator takes side by side, timed on whatever device JAX finds.

Run with `python -m benchmarks accelerator`; `JAX_PLATFORMS=cpu` before it measures the
processor of the same machine. Three kinds of work: fits of the paper's benchmark from
many first guesses of its network in one call, half an hour of bioheat in space with its
gradient, and closed loops with the path integral controller. All in float64; each is
timed in its first call, compilation included, and in a second one.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import tyro

from benchmarks import heat
from benchmarks._options import begin
from pinav.commands.settings import Settings
from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.files import write_text
from pinav.fitting import TrajectoryLoss, curriculum, fit_many
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import ModelChoice, learned_part, summarise_data
from pinav.navigation.control.default import controller
from pinav.navigation.task.catalogue import task
from pinav.navigation.trials.closed_loop import run_many
from pinav.scenarios import paper
from pinav.thermal.grids import CartesianGrid
from pinav.trajectories import simulate

TASK = "barrier-weak"
"""Task of the closed loops."""

SIDE = 0.064
"""Side of the heated cube [m]."""


class Options(Settings, frozen=True):
    """Time fits, a run of bioheat and closed loops on the device that JAX finds."""

    out: Annotated[Path, tyro.conf.arg(help="Folder of the results.")] = Path(
        "runs/bench-accelerator"
    )
    fits: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Numbers of fits in one call.")
    ] = (1, 256)
    cells: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Cells of bioheat along each side.")
    ] = (64,)
    loops: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Numbers of closed loops in one call.")
    ] = (1, 4096)
    max_steps: Annotated[
        int, tyro.conf.arg(help="Fits: steps of each window at most.")
    ] = 20

    def check_together(self) -> None:
        """Raise `InputError` where an option makes no sense."""
        for name in ("fits", "cells", "loops"):
            if any(value < 1 for value in getattr(self, name)):
                raise InputError(f"--{name}: expected numbers of 1 or more")
        if self.max_steps < 1:
            raise InputError("--max-steps: expected 1 or more")


class Row(msgspec.Struct, frozen=True):
    """What one piece of work took.

    Attributes:
        work: what was done.
        number: how many, side by side.
        first: seconds of the first call, with the compilation.
        second: seconds of the second call.
        quality: a number that is the same on every device, to some digits.
        meaning: what that number is.
    """

    work: str
    number: int
    first: float
    second: float
    quality: float
    meaning: str


def main(argv: Sequence[str]) -> None:
    options = begin(Options, argv, "accelerator")
    if options is None:
        return
    device = jax.devices()[0]
    print(f"device: {device.device_kind} ({device.platform}), JAX {jax.__version__}")
    print(
        f"{'work':<18}{'number':>7}{'first s':>10}{'second s':>10}{'each ms':>10}"
        "  result"
    )
    lines = ["device,work,number,first,second,quality,meaning"]
    for row in rows(options):
        print(line(row), flush=True)
        lines.append(
            f"{device.device_kind},{row.work},{row.number},{row.first!r},"
            f"{row.second!r},{row.quality!r},{row.meaning}"
        )
        options.out.mkdir(parents=True, exist_ok=True)
        write_text(
            options.out / "accelerator.csv", "\n".join(lines) + "\n", overwrite=True
        )


def rows(options: Options) -> Iterator[Row]:
    """The measurements, one by one."""
    for count in options.loops:
        yield loops(count)
    for side in options.cells:
        yield from bioheat(side)
    for count in options.fits:
        yield fits(count, options.max_steps)


def line(row: Row) -> str:
    """A line of the table."""
    return (
        f"{row.work:<18}{row.number:>7}{row.first:>10.2f}{row.second:>10.3f}"
        f"{1e3 * row.second / row.number:>10.2f}  {row.meaning} {row.quality:.6g}"
    )


Result = TypeVar("Result")


def twice(call: Callable[[], Result]) -> tuple[Result, float, float]:
    """A result, and the seconds of the first and the second call."""
    seconds = []
    result = None
    for _ in range(2):
        start = time.perf_counter()
        result = jax.block_until_ready(call())
        seconds.append(time.perf_counter() - start)
    assert result is not None
    return result, seconds[0], seconds[1]


def fits(count: int, max_steps: int) -> Row:
    """Fits of the paper's network by windows that grow, from `count` seeds."""
    data = simulate(paper())
    known, summary = paper().swimmer, summarise_data(data)
    models = [
        build(ModelChoice("ude", seed=seed), known, summary) for seed in range(count)
    ]
    recipe = curriculum(data, max_steps=max_steps)

    def fit() -> np.ndarray:
        results = fit_many(
            models,
            data,
            recipe,
            trainable=learned_part,
            objective=TrajectoryLoss(FixedStep(substeps=2)),
            dtype=jnp.float64,
        )
        return np.array([float(result.losses[-1]) for result in results])

    losses, first, second = twice(fit)
    rmse = float(np.sqrt(np.median(losses) / data.num_observed))
    return Row("paper's fit", count, first, second, rmse, "median RMSE")


def bioheat(side: int) -> Iterator[Row]:
    """Half an hour of bioheat in a cube, and its gradient by the amplitudes."""
    grid = CartesianGrid.cubes((side, side, side), SIDE / side)
    outcome, amplitudes, _ = heat.half_an_hour(grid)
    forward = jax.jit(outcome)
    value, first, second = twice(lambda: forward(amplitudes))
    yield Row(f"bioheat {side}^3", 1, first, second, float(value), "logarithm of dose")
    backward = jax.jit(jax.grad(outcome))
    slopes, first, second = twice(lambda: backward(amplitudes))
    size = float(jnp.linalg.norm(slopes))
    yield Row(f"gradient {side}^3", 1, first, second, size, "norm")


def loops(count: int) -> Row:
    """Closed loops of the default controller with the true model."""
    problem = task(TASK)
    steering = controller(problem, problem.truth)
    keys = jax.random.split(jax.random.key(7), count)
    episodes, first, second = twice(lambda: run_many(problem, steering, keys))
    arrival = float(np.median(episodes.arrival_time))
    return Row("closed loop", count, first, second, arrival, "median arrival")
