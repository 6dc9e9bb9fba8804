"""Small fitted runs, each made once for all tests of one call of pytest.

`RUNS` maps a name to a function that writes data into a folder and returns the words
of the command that fits them. A test asks the fixture `fitted_run` for one:

    def test_something(fitted_run):
        run, data = fitted_run("kernel")

and gets a copy of its own, which it may change. The workers of xdist share what was
fitted through a folder with a lock.
"""

import contextlib
import dataclasses
import io
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest
import tomli_w
from filelock import FileLock
from matplotlib.figure import Figure
from tests.drawn import write_drawn

DATA, RUN, TERMINAL = "data.npz", "run", "terminal.txt"
POTENTIAL = ("--model", "kernel-potential")
"""Named, so that no mixture is fitted besides, which takes as long again."""

EXAMPLES = Path(__file__).parents[1] / "examples"


def network(folder: Path) -> list[str]:
    """Noisy trajectories of the paper, a neural network after a few steps."""
    simulate("paper", folder, "--noise", "0.01")
    steps = ["--recipe", "paper", "--adam-steps", "10", "--lbfgs-steps", "2"]
    return ["fit", str(folder / DATA), "--model", "ude", *steps, "--train", "damping"]


def kernel(folder: Path) -> list[str]:
    """Four short crossings of a barrier, kernels and the damping by evidence."""
    from pinav.trajectories import save

    save(crossings(51), folder / DATA)
    return ["fit", str(folder / DATA), *POTENTIAL, "--train", "damping"]


def positions(folder: Path) -> list[str]:
    """As `kernel`, from positions alone of which one frame is lost."""
    from pinav.trajectories import Trajectories, save

    full = crossings(61)
    tracks = Trajectories.from_arrays(
        [np.delete(times, 7) for times in full.times],
        [np.delete(states[:, :2], 7, axis=0) for states in full.states],
        channels=("x", "y"),
        units={"x": "1", "y": "1", "t": "1"},
    )
    save(tracks, folder / DATA)
    argv = ["fit", str(folder / DATA), "--system", "barrier-crossings"]
    return [*argv, *POTENTIAL, "--train", "damping"]


def langevin(folder: Path) -> list[str]:
    """Three Brownian trajectories, force and diffusion from their increments."""
    simulate("brownian", folder, "--count", "3")
    return ["fit", str(folder / DATA), "--recipe", "langevin"]


def circling(*, driven=True, recorded=True):
    """A robot that circles under commands, 40 s at 8 Hz, or drifts all the same."""
    from pinav.trajectories import Trajectories

    random = np.random.default_rng(3)
    times = np.arange(0, 40, 0.125)
    heading = np.cumsum(random.normal(0, 0.2, len(times)))
    frequency = np.where(times < 20, 1.0, 2.0) * driven
    velocity = 4 * frequency[:, None] * np.stack([np.cos(heading), np.sin(heading)], 1)
    velocity += 0.0 if driven else 0.7
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(0.125 * velocity[:-1], axis=0)])
    path += np.cumsum(0.02 * random.normal(size=path.shape), axis=0)
    commands = {"frequency": [frequency], "heading": [heading]} if recorded else {}
    return Trajectories.from_arrays(
        [times],
        [path + 0.05 * random.normal(size=path.shape)],
        channels=("x", "y"),
        commands=commands,
        units={"x": "um", "y": "um", "t": "s"},
    )


def identified(folder: Path) -> list[str]:
    """Which response a robot has that circles under commands."""
    from pinav.trajectories import save

    save(circling(), folder / DATA)
    return ["identify", str(folder / DATA)]


SHORT = ("--seeds", "42", "1", "--recipe", "paper", "--adam-steps", "12")
"""A reproduction of a few steps."""


def reproduced(folder: Path) -> list[str]:
    """The paper's experiment with two seeds and a few steps; there is no data file."""
    return ["reproduce", *SHORT, "--lbfgs-steps", "3"]


def studied(folder: Path) -> list[str]:
    """A study of two cells that are soon done."""
    return ["study", "noise", *STUDY]


STUDY = ("--models", "physics-only", "--count", "1", "--sigmas", "0.01", "0.1")
"""A study of what needs no fit."""


def heated(folder: Path) -> list[str]:
    """A tumour on a coarse grid."""
    content = tomllib.loads((EXAMPLES / "heat" / "tumour.toml").read_text())
    content["grid"]["cells"], content["step"] = 24, 20.0
    (folder / "tumour.toml").write_text(tomli_w.dumps(content))
    return ["heat", "simulate", str(folder / "tumour.toml")]


RUNS: dict[str, Callable[[Path], list[str]]] = {
    run.__name__: run
    for run in (network, kernel, positions, langevin)
    + (identified, reproduced, studied, heated)
}


def simulate(scenario: str, folder: Path, *options: str) -> None:
    """Write trajectories of a scenario as the command line does."""
    from pinav import cli

    argv = ["simulate", scenario, "--out", str(folder / DATA), *options]
    assert cli.run(argv) == 0


def crossing_system(count: int, samples: int, **changes):
    """The first crossings of the barrier, cut after a number of samples."""
    from pinav.scenarios import barrier_crossings

    whole = barrier_crossings()
    starts, times = whole.starts[:count], whole.times[:samples]
    return dataclasses.replace(whole, starts=starts, times=times, **changes)


def trap_system(dim: int = 2, stiffness=4.0, center=None, **parts):
    """Beads in a trap, of mobility 1/2; further parts are those of `System`."""
    from pinav.dynamics import OverdampedSwimmer
    from pinav.forces import HarmonicTrap, ZeroForce
    from pinav.systems import System, UniformStarts

    known = {
        "name": "bead",
        "swimmer": OverdampedSwimmer(ZeroForce(), ZeroForce(), 0.5),
        "environment": HarmonicTrap(stiffness, center or [0.0] * dim),
        "times": np.linspace(0.0, 2.0, 21),
    }
    if "starts" not in parts:
        known["rule"] = UniformStarts((-1.0,) * dim, (1.0,) * dim, count=3)
    system = System(dim=dim, **(known | parts))
    return system if "starts" in parts else system.with_starts()


def crossings(samples: int, count: int = 4, key: int = 3):
    """Noisy crossings of the barrier, cut after a number of samples."""
    from pinav.trajectories import simulate

    return simulate(crossing_system(count, samples), key=jax.random.key(key))


@contextlib.contextmanager
def standard_promotion():
    """Promotion of types as users have it, in all threads."""
    jax.config.update("jax_numpy_dtype_promotion", "standard")
    try:
        yield
    finally:
        jax.config.update("jax_numpy_dtype_promotion", "strict")


@contextlib.contextmanager
def cheap_residual_fields():
    """Leave kernels out of an identification: tests/identification has them."""
    from pinav.identification.selection import RESIDUALS

    with pytest.MonkeyPatch.context() as patch:
        for name in ("Gaussian process", "potential"):
            patch.delitem(RESIDUALS, name)
        yield


@contextlib.contextmanager
def blank_figures():
    """Make every figure, but draw nothing in its files; those that would be drawn."""
    figures = {}

    def note(figure, renderer):
        figures[id(figure)] = figure

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "draw", note)
        yield figures


@dataclasses.dataclass(frozen=True)
class FittedRuns:
    """Runs that were fitted once, below a folder that all workers know."""

    folder: Path

    def copy(self, name: str, to: Path) -> tuple[Path, Path]:
        """A copy of a run and of its data, fitted before if no test asked yet.

        Args:
            name: of `RUNS`.
            to: an empty folder for the copy.
        """
        source = self.folder / name
        with FileLock(f"{source}.lock"):
            if not (source / "done").exists():
                self.fit(name, source)
        shutil.copytree(source, to, dirs_exist_ok=True)
        return to / RUN, to / DATA

    def fit(self, name: str, folder: Path) -> None:
        """Simulate, fit, and mark the folder as done."""
        from pinav import cli

        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        with standard_promotion(), cheap_residual_fields(), blank_figures() as drawn:
            words = RUNS[name](folder)
            with contextlib.redirect_stdout(io.StringIO()) as terminal:
                assert cli.run([*words, "--out", str(folder / RUN)]) == 0
        said = terminal.getvalue().replace(str(folder), "FOLDER")
        (folder / TERMINAL).write_text(said, encoding="utf-8")
        write_drawn(drawn.values(), folder)
        (folder / "done").touch()
