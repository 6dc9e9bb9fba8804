"""How the time of a Gauss-Newton iteration grows with data, samples and weights.

Run with `python -m benchmarks growth`. Full rollouts of the clean `barrier-crossings`
scenario, the network recipe in float64; and many fits of the paper's benchmark in one
call. What is compared takes turns, so that a change of the machine's speed meets all of
it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from benchmarks._options import begin
from pinav.commands.settings import Settings
from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.figures.images import save_figure
from pinav.figures.palette import (
    BLUE,
    GREY,
)
from pinav.figures.style import SMALL, add_legend, label_axes, new_figure, prepare_axes
from pinav.files import write_text
from pinav.fitting import GaussNewton, Problem, TrajectoryLoss, curriculum, fit_many
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import ModelChoice, learned_part, summarise_data
from pinav.fitting.matching.state import Observations, split_trainable
from pinav.scenarios import barrier_crossings, paper
from pinav.trajectories import Trajectories, concatenate, simulate


class Options(Settings, frozen=True):
    """Time a Gauss-Newton iteration as trajectories, samples, weights, fits grow."""

    out: Annotated[Path, tyro.conf.arg(help="Folder of the results.")] = Path(
        "runs/bench-growth"
    )
    trajectories: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Numbers of trajectories.")
    ] = (1, 4, 16, 64)
    samples: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Samples of each of 4 trajectories.")
    ] = (51, 101, 201, 401)
    widths: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Widths of the network, 4 trajectories.")
    ] = (16, 32, 64)
    fits: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Numbers of fits in one call.")
    ] = (1, 4, 16)
    rounds: Annotated[int, tyro.conf.arg(help="Times that each is timed.")] = 5
    max_steps: Annotated[
        int, tyro.conf.arg(help="Many fits: steps of each window at most.")
    ] = 20

    def check_together(self) -> None:
        """Raise `InputError` where an option makes no sense."""
        for name in ("trajectories", "samples", "widths", "fits"):
            if any(value < 1 for value in getattr(self, name)):
                raise InputError(f"--{name}: expected numbers of 1 or more")
        for name in ("rounds", "max_steps"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name.replace('_', '-')}: expected 1 or more")


def main(argv: Sequence[str]) -> None:
    options = begin(Options, argv, "growth")
    if options is None:
        return
    options.out.mkdir(parents=True, exist_ok=True)
    measured = measure(options)
    print(text(measured))
    rows = ["quantity,number,seconds"]
    for name, times in measured.items():
        rows += [f"{name},{number},{seconds!r}" for number, seconds in times.items()]
    write_text(options.out / "growth.csv", "\n".join(rows) + "\n", overwrite=True)
    print(f"figure: {save_figure(figure(measured), options.out, 'growth').png}")


TRAJECTORIES, SAMPLES, WEIGHTS, FITS = "trajectories", "samples", "weights", "fits"

WIDTH = 32
"""Of the network, where it does not vary."""

Measured = Mapping[str, Mapping[int, float]]
"""Seconds by what was varied and its number."""


def measure(options: Options) -> dict[str, dict[int, float]]:
    data = crossings(max(options.trajectories, default=1))
    four = crossings(4)
    some = {n: iteration(data.select(range(n)), WIDTH) for n in options.trajectories}
    fine = {n: iteration(crossings(4, n), WIDTH) for n in options.samples}
    wide = {
        num_weights(four, width): iteration(four, width) for width in options.widths
    }
    measured = {
        TRAJECTORIES: medians(some, options.rounds),
        SAMPLES: medians(fine, options.rounds),
        WEIGHTS: medians(wide, options.rounds),
        FITS: many_fits(options.fits, options.max_steps),
    }
    return {name: times for name, times in measured.items() if times}


def crossings(count: int, samples: int | None = None) -> Trajectories:
    """Clean crossings of the barrier from random starts, eight for each key.

    Args:
        count: number of trajectories.
        samples: of each, from the same start to the same end; as the scenario has them
            unless given.
    """
    batches = []
    for seed in range(-(-count // 8)):
        scenario = barrier_crossings(jax.random.key(seed))
        scenario = eqx.tree_at(lambda s: s.observation.noise, scenario, 0.0)
        if samples is not None:
            times = jnp.linspace(scenario.times[0], scenario.times[-1], samples)
            scenario = eqx.tree_at(lambda s: s.times, scenario, times)
        batches.append(simulate(scenario))
    return concatenate(batches).select(range(count))


def num_weights(data: Trajectories, width: int) -> int:
    """Weights of the network of this width."""
    leaves = jax.tree.leaves(learned_part(_model(data, width)))
    return sum(leaf.size for leaf in leaves if eqx.is_inexact_array(leaf))


def _model(data: Trajectories, width: int) -> Any:
    known = barrier_crossings().swimmer
    return build(ModelChoice("ude", width=width), known, summarise_data(data))


def iteration(data: Trajectories, width: int) -> Callable[[], object]:
    """One compiled Gauss-Newton iteration on full rollouts, ready to be called."""
    params, static = split_trainable(_model(data, width), learned_part, jnp.float64)
    objective = TrajectoryLoss(FixedStep(substeps=2))
    problem = Problem(static, Observations.of(data, jnp.float64), objective)
    window = jnp.asarray(data.states.shape[1] - 1)
    phase = GaussNewton(window, target=jnp.zeros(()))
    step = eqx.filter_jit(lambda problem, p, s: phase.step(problem, p, s))
    state = eqx.filter_jit(phase.init)(problem, params, problem(params))
    jax.block_until_ready(step(problem, params, state))
    return lambda: jax.block_until_ready(step(problem, params, state))


def medians(calls: Mapping[int, Callable[[], object]], rounds: int) -> dict[int, float]:
    """Median time of each call [s], over rounds in which all take turns."""
    times: dict[int, list[float]] = {number: [] for number in calls}
    for _ in range(rounds):
        for number, call in calls.items():
            start = time.perf_counter()
            call()
            times[number].append(time.perf_counter() - start)
    return {number: float(np.median(values)) for number, values in times.items()}


def many_fits(counts: Sequence[int], max_steps: int) -> dict[int, float]:
    """Time of the default fit of several seeds at once [s], compilation apart."""
    data = simulate(paper())
    known, summary = paper().swimmer, summarise_data(data)
    found = {}
    for count in counts:
        models = [
            build(ModelChoice("ude", seed=seed), known, summary)
            for seed in range(count)
        ]

        def run(steps, models=models):
            fit_many(
                models,
                data,
                curriculum(data, max_steps=steps),
                trainable=learned_part,
                objective=TrajectoryLoss(FixedStep(substeps=2)),
                dtype=jnp.float64,
            )

        run(max_steps)
        start = time.perf_counter()
        run(max_steps)
        found[count] = time.perf_counter() - start
    return found


def slope(times: Mapping[int, float]) -> float:
    """Exponent p of seconds ~ number ** p, by least squares on logarithms."""
    if len(times) < 2:
        return float("nan")
    return float(np.polyfit(np.log(list(times)), np.log(list(times.values())), 1)[0])


def text(measured: Measured) -> str:
    """The tables: time by number, and the slope under each."""
    heads = {
        TRAJECTORIES: f"trajectories, width {WIDTH} (one Gauss-Newton iteration)",
        SAMPLES: f"samples of 4 trajectories, width {WIDTH} (one iteration)",
        WEIGHTS: "weights of the network, 4 trajectories (one iteration)",
        FITS: "fits in one call, paper's benchmark (all iterations)",
    }
    lines = []
    for name, times in measured.items():
        lines += ["", heads[name]]
        for number, seconds in times.items():
            rate = f"{number / seconds:>10.2f} fits/s" if name == FITS else ""
            lines.append(f"{number:>6} {1e3 * seconds:>10.0f} ms{rate}")
        lines.append(f" slope {slope(times):.2f} (log-log; 1 is linear)")
    return "\n".join(lines)


def figure(measured: Measured) -> Figure:
    """Time over number, one panel for each quantity that was varied."""
    drawn = new_figure(2.5 * len(measured), 2.6)
    for index, (name, times) in enumerate(measured.items()):
        panel(name, times, ax=drawn.add_subplot(1, len(measured), index + 1))
    return drawn


def panel(name: str, times: Mapping[int, float], *, ax: Axes | None = None) -> Axes:
    """Time over number on logarithmic axes, and a line of slope one."""
    ax = prepare_axes(ax)
    numbers, seconds = np.array(list(times)), np.array(list(times.values()))
    ax.plot(numbers, seconds, "o-", color=BLUE, label=f"slope {slope(times):.2f}")
    linear = seconds[0] * numbers / numbers[0]
    ax.plot(numbers, linear, ":", color=GREY, label="linear")
    ax.set_xscale("log", base=2)
    ax.set_yscale("log")
    ax.set_xticks(numbers)
    ax.xaxis.set_major_formatter(ScalarFormatter())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.tick_params(which="both", labelsize=SMALL)
    what = "time of all fits [s]" if name == FITS else "time per iteration [s]"
    label_axes(ax, name, what)
    add_legend(ax, loc="upper left")
    return ax
