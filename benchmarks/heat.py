"""Half an hour of bioheat and its gradient: time after compilation, and memory.

Run with `python -m benchmarks heat`. A heated tumour in muscle with the perfusion laws
of Lang et al., 15 intervals of two minutes, float64; the gradient is that of the
logarithm of the dose by all amplitudes. Each grid has a process of its own; "memory" is
by how much the peak of the process grew while the gradient was compiled and run.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import tyro
from jaxtyping import Array, Float

from benchmarks.fit.child import peak_memory
from pinav.commands.parsing import parse
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import Dirichlet, around, outer
from pinav.thermal.grids import AbstractGrid, CartesianGrid, RadialGrid
from pinav.thermal.perfusion import RegionalPerfusion, lang
from pinav.thermal.protocols import Piecewise, plan_steps
from pinav.thermal.solve import default_stepper, run
from pinav.thermal.sources import PowerSource
from pinav.thermal.starts import AT_REST
from pinav.thermal.tissues import Blood, Tissue, mix

ROOT = Path(__file__).parents[1]


class Case(msgspec.Struct, frozen=True):
    """A grid, and what a run on it may cost.

    Attributes:
        grid: makes it.
        forward: most time of a run [s].
        gradient: most time of its gradient [s].
        memory: most memory of the gradient [MiB].
    """

    grid: Callable[[], AbstractGrid]
    forward: float
    gradient: float
    memory: float


CASES = {
    "radial": Case(lambda: RadialGrid.sphere(0.05, 200), 5e-3, 10e-3, 1024),
    "plane": Case(lambda: CartesianGrid.cubes((128, 128), 5e-4), 1.5, 2.5, 1024),
    "space": Case(lambda: CartesianGrid.cubes((64, 64, 64), 1e-3), 4.0, 16.0, 2048),
}
"""200 cells along a radius, 128 x 128 of 0.5 mm, 64 x 64 x 64 of 1 mm."""


class Measured(msgspec.Struct, frozen=True):
    """What a case took.

    Attributes:
        steps: time steps of the run.
        forward: seconds of the run.
        gradient: seconds of its gradient, the run included.
        compilation: seconds until the gradient is compiled.
        memory: growth of the peak memory of the process by the gradient [MiB].
        compiled: XLA's own temporary memory of the gradient [MiB].
    """

    steps: int
    forward: float
    gradient: float
    compilation: float
    memory: float
    compiled: float


class Options(msgspec.Struct, frozen=True):
    """Time half an hour of bioheat and its gradient on three grids."""

    cases: Annotated[
        tuple[str, ...], tyro.conf.arg(help="Grids: " + ", ".join(CASES))
    ] = tuple(CASES)

    def check(self) -> None:
        """Raise `InputError` where a grid is unknown."""
        for name in self.cases:
            if name not in CASES:
                raise InputError(
                    f"--cases: {name!r} is unknown; choose from: {', '.join(CASES)}"
                )


def main(argv: Sequence[str]) -> None:
    options = parse(Options, argv, prog="python -m benchmarks heat")
    if options is None:
        return
    options.check()
    print(
        f"{'grid':<8}{'steps':>6}{'forward s':>11}{'bar':>7}{'gradient s':>12}"
        f"{'bar':>7}{'memory MiB':>12}{'bar':>6}{'compiled MiB':>14}"
        f"{'compilation s':>15}"
    )
    for name in options.cases:
        print(row(name, in_own_process(name)), flush=True)


def row(name: str, found: Measured) -> str:
    """A line of the schedule."""
    bars = CASES[name]
    return (
        f"{name:<8}{found.steps:>6}{found.forward:>11.4f}{bars.forward:>7g}"
        f"{found.gradient:>12.4f}{bars.gradient:>7g}{found.memory:>12.0f}"
        f"{bars.memory:>6g}{found.compiled:>14.0f}{found.compilation:>15.1f}"
    )


def in_own_process(name: str) -> Measured:
    """Measure a case where nothing else was computed before."""
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "benchmarks.heat", name],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"benchmark of {name} failed:\n{done.stderr}")
    return msgspec.json.decode(done.stdout.splitlines()[-1], type=Measured)


def measure(name: str) -> Measured:
    """Time a case in this process."""
    outcome, amplitudes, steps = half_an_hour(CASES[name].grid())
    forward = jax.jit(outcome).lower(amplitudes).compile()
    seconds = best_time(lambda: forward(amplitudes))
    before, start = peak_memory(), time.perf_counter()
    gradient = jax.jit(jax.grad(outcome)).lower(amplitudes).compile()
    compilation = time.perf_counter() - start
    gradient_seconds = best_time(lambda: gradient(amplitudes))
    used = gradient.memory_analysis()
    return Measured(
        steps=steps,
        forward=seconds,
        gradient=gradient_seconds,
        compilation=compilation,
        memory=peak_memory() - before,
        compiled=0.0 if used is None else used.temp_size_in_bytes / 2**20,
    )


Amplitudes = Float[Array, " interval"]


def half_an_hour(
    grid: AbstractGrid,
) -> tuple[Callable[[Amplitudes], Float[Array, ""]], Amplitudes, int]:
    """Logarithm of the dose by the amplitudes, what they are, and the time steps."""
    model = tumour(grid)
    stepper = default_stepper(model)
    edges = tuple(np.linspace(0.0, 1800.0, 16).tolist())
    protocol = Piecewise.constant(edges, np.full(15, 1e4), 1e5)
    schedule = plan_steps(protocol, stepper.longest_step(model))
    begin = AT_REST.state(model)

    def outcome(amplitudes: Amplitudes) -> Float[Array, ""]:
        driven = eqx.tree_at(lambda p: (p.starts, p.ends), protocol, (amplitudes,) * 2)
        heated = run(
            model, driven, schedule, stepper=stepper, observe=jnp.max, start=begin
        )
        return jnp.log(jnp.sum(heated.final.dose))

    return outcome, protocol.starts, len(schedule.steps)


def tumour(grid: AbstractGrid) -> Bioheat:
    """A tumour of 10 mm in muscle, on any grid."""
    fraction, wall = grid.ball(0.010), Dirichlet(37.0)
    shares, muscle = (fraction, 1 - fraction), Tissue(0.49, 1090.0, 3421.0)
    return Bioheat(
        grid,
        mix(shares, (Tissue(0.55, 1045.0, 3600.0), muscle)),
        Blood(),
        RegionalPerfusion.on_masks(shares, (lang("tumour"), lang("muscle"))),
        (PowerSource(1.5e5 * fraction, 1e4),),
        outer(wall) if len(grid.shape) == 1 else around(grid, wall),
    )


def best_time(call: Callable[[], object]) -> float:
    """Shortest of several calls [s]; fewer of those that take long."""
    jax.block_until_ready(call())
    times = []
    while len(times) < 3 or (sum(times) < 1.0 and len(times) < 50):
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    return min(times)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", val=True)
    print(json.dumps(msgspec.to_builtins(measure(sys.argv[1]))))
