"""Each command runs once, on the smallest work that it accepts."""

import functools
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.fitted_runs import blank_figures
from tests.heat_cases import small

from pinav import analysis
from pinav.analysis import effects
from pinav.analysis.discovery import discovery, law_regression
from pinav.analysis.discovery.candidates import POTENTIALS, ROTATIONS
from pinav.commands import COMMANDS
from pinav.runs import RunFolder

WORDS = {
    "simulate": "paper --out {folder}/data.csv",
    "inspect": "{identified}/data.npz --out {folder}/out",
    "evaluate": "{kernel}/run {kernel}/data.npz",
    "analyse": "{kernel}/run --points 5 --samples 4",
    "compare": "{kernel}/data.npz --models physics-only kernel-potential "
    "--out {folder}/out",
    "discover": "{kernel}/run --refits 1",
    "study": "noise --models physics-only --count 1 --sigmas 0.1 --out {folder}/out",
    "data": "list",
    "heat": "simulate {folder}/tumour.toml --out {folder}/out",
    "navigate": "{kernel}/run --from 1,1 --to 2,2 --thrust 1 --time-limit 8 --step 0.5 "
    "--seeds 1 --out {folder}/out",
    "design": "shear --from=1,5 --to=9,5 --arena=0,0,10,10 --tolerance 0.5 --designs "
    "grid --seeds 1 --most 1 --thrust 1.5 --out {folder}/out",
    "explore": "{kernel}/run",
    "live": "{identified}/data.npz --replay --frames 20",
    "export": "{kernel}/run --to napari --out {folder}/tracks.csv",
    "report": "{network}/run",
}
"""The words of each command, with the folders of a test and of shared runs."""


def words_of(command: str, folder: Path, fitted_run: Callable) -> list[str]:
    """The words of a command, whose shared runs are copied."""
    if command == "heat":
        small("tumour", folder)
    names = re.findall(r"{(\w+)}", WORDS[command])
    runs = {n: fitted_run(n)[0].parent for n in {*names} - {"folder"}}
    return WORDS[command].format(folder=folder, **runs).split()


SHARED = {"reproduce": "reproduced", "identify": "identified", "fit": "kernel"}
"""Commands whose runs are made once for all tests, and those runs."""

SLOW = {"design", "navigate"}  # they compile for more than ten seconds


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


@pytest.mark.parametrize(
    "command", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in WORDS]
)
def test_a_command_ends_with_success(command, tmp_path, fitted_run, printed):
    assert printed(command, *words_of(command, tmp_path, fitted_run))


@pytest.mark.parametrize("command", SHARED)
def test_a_shared_run_is_that_of_its_command(command, fitted_run):
    folder, _ = fitted_run(SHARED[command])
    assert RunFolder.open(folder).command == command


def test_each_command_has_its_words():
    assert set(WORDS) | set(SHARED) == {command.name for command in COMMANDS}
