"""Each command runs once, on the smallest work that it accepts."""

import functools
from collections.abc import Callable
from pathlib import Path

import jax
import pytest
from tests.commands.test_heat import small
from tests.fitted_runs import blank_figures

from pinav import analysis, cli
from pinav.analysis import effects
from pinav.analysis.discovery import discovery, law_regression
from pinav.analysis.discovery.potentials import POTENTIALS, ROTATIONS
from pinav.commands import COMMANDS
from pinav.runs import RunFolder

NARROW = ("--thrust", "1", "--time-limit", "8", "--step", "0.5", "--seeds", "1")


class Folder:
    """A folder of a test and the shared runs that it may copy."""

    def __init__(self, path: Path, fitted_run: Callable[[str], tuple[Path, Path]]):
        self.path = path
        self.out = ("--out", str(path / "out"))
        self.fitted_run = fitted_run

    def run(self, name: str) -> str:
        return str(self.fitted_run(name)[0])

    def data(self, name: str) -> str:
        return str(self.fitted_run(name)[1])


WORDS: dict[str, Callable[[Folder], tuple[str, ...]]] = {
    "simulate": lambda f: ("paper", "--out", str(f.path / "data.csv")),
    "inspect": lambda f: (f.data("identified"), *f.out),
    "evaluate": lambda f: (f.run("kernel"), f.data("kernel")),
    "analyse": lambda f: (f.run("kernel"), "--points", "5", "--samples", "4"),
    "compare": lambda f: (
        *(f.data("kernel"), "--models", "physics-only", "kernel-potential", *f.out),
    ),
    "discover": lambda f: (f.run("kernel"), "--refits", "1"),
    "study": lambda f: ("noise", "--models", "physics-only", "--count", "1", *f.out),
    "data": lambda f: ("list",),
    "heat": lambda f: ("simulate", str(small("tumour", f.path)), *f.out),
    "navigate": lambda f: (
        *(f.run("kernel"), "--from", "1,1", "--to", "2,2", *NARROW, *f.out),
    ),
    "design": lambda f: (
        *("shear", "--from=1,5", "--to=9,5", "--arena=0,0,10,10", "--tolerance", "0.5"),
        *(
            "--designs",
            "grid",
            "--seeds",
            "1",
            "--most",
            "1",
            "--thrust",
            "1.5",
            *f.out,
        ),
    ),
    "explore": lambda f: (f.run("kernel"),),
    "live": lambda f: (f.data("identified"), "--replay", "--frames", "20"),
    "export": lambda f: (
        *(f.run("kernel"), "--to", "napari", "--out", str(f.path / "tracks.csv")),
    ),
    "report": lambda f: (f.run("network"),),
}


SHARED = {"reproduce": "reproduced", "identify": "identified", "fit": "kernel"}
"""Commands whose runs are made once for all tests, and those runs."""

SLOW = {"design", "navigate"}  # they compile for more than ten seconds


def cases():
    marks = {name: [pytest.mark.slow] for name in SLOW}
    return [pytest.param(name, marks=marks.get(name, [])) for name in WORDS]


@pytest.fixture(autouse=True)
def little_work(monkeypatch):
    """Few laws, few starts of a map, blank figures: other tests have them all."""
    few = functools.partial(
        analysis.discover_law, laws=(*POTENTIALS[:2], *ROTATIONS[:1])
    )
    monkeypatch.setattr(discovery, "discover_law", few)
    monkeypatch.setattr(law_regression, "MOST_TERMS", 1)
    monkeypatch.setattr(effects, "LYAPUNOV_POINTS", 5)
    with blank_figures():
        yield


@pytest.mark.parametrize("command", cases())
def test_a_command_ends_with_success(command, tmp_path, fitted_run, capsys):
    words = WORDS[command](Folder(tmp_path, fitted_run))
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        assert cli.run([command, *words]) == 0
    assert capsys.readouterr().out


@pytest.mark.parametrize("command", SHARED)
def test_a_shared_run_is_that_of_its_command(command, fitted_run):
    folder, _ = fitted_run(SHARED[command])
    assert RunFolder.open(folder).command == command


def test_each_command_has_its_words():
    assert set(WORDS) | set(SHARED) == {command.name for command in COMMANDS}
