"""Each command runs once, on the smallest work, and gives the numbers that are kept."""

import functools
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.drawn import write_drawn
from tests.fitted_runs import blank_figures
from tests.heat_cases import small
from tests.stored_numbers import contents, result_of

from pinav import analysis
from pinav.analysis import effects
from pinav.analysis.discovery import discovery, law_regression
from pinav.analysis.discovery.candidates import POTENTIALS, ROTATIONS
from pinav.commands import COMMANDS
from pinav.runs import RunFolder

WORDS = {
    "simulate": "simulate paper --out {folder}/data.csv",
    "simulate noise": "simulate brownian --count 2 --noise 0.05 "
    "--frame-loss 0.1 --positions-only --out {folder}/data.npz",
    "inspect": "inspect {identified}/data.npz --out {folder}/out",
    "evaluate": "evaluate {kernel}/run {kernel}/data.npz",
    "analyse": "analyse {kernel}/run --points 5 --samples 4",
    "compare": "compare {kernel}/data.npz --models physics-only kernel-potential "
    "--out {folder}/out",
    "discover": "discover {kernel}/run --refits 1",
    "study": "study noise --models physics-only --count 1 --sigmas 0.1 "
    "--out {folder}/out",
    "data": "data list",
    "heat": "heat simulate {folder}/tumour.toml --out {folder}/out",
    "heat learn": "heat learn {folder}/learn.toml --out {folder}/out",
    "heat optimise": "heat optimise {folder}/optimise.toml --out {folder}/out",
    "navigate": "navigate {kernel}/run --from 1,1 --to 2,2 --thrust 1 --time-limit 8 "
    "--step 0.5 --seeds 1 --out {folder}/out",
    "design": "design shear --from=1,5 --to=9,5 --arena=0,0,10,10 --tolerance 0.5 "
    "--designs grid --seeds 1 --most 1 --thrust 1.5 --out {folder}/out",
    "explore": "explore {kernel}/run",
    "live": "live {identified}/data.npz --replay --frames 20",
    "live goal": "live {identified}/data.npz --replay --frames 40 --to 9,5 "
    "--keep-out 5,1,1",
    "export": "export {kernel}/run --to napari --out {folder}/tracks.csv",
    "export positions": "export {positions}/run --to napari --out {folder}/tracks.csv",
    "report": "report {network}/run",
}
"""The words of each command, with the folders of a test and of shared runs."""


def words_of(name: str, folder: Path, fitted_run: Callable) -> list[str]:
    """The words of a command, whose shared runs are copied."""
    for case in re.findall(r"{folder}/(\w+).toml", WORDS[name]):
        small(case, folder)
    names = re.findall(r"{(\w+)}", WORDS[name])
    runs = {n: fitted_run(n)[0].parent for n in {*names} - {"folder"}}
    return WORDS[name].format(folder=folder, **runs).split()


SHARED = {"reproduce": "reproduced", "identify": "identified", "fit": "kernel"}
"""Commands whose runs are made once for all tests, and those runs."""

SLOW = {"design", "navigate"}
"""Commands that compile for more than ten seconds."""


@pytest.fixture(autouse=True)
def little_work(monkeypatch):
    """Few laws, few starts of a map, blank figures: other tests have them all."""
    few = functools.partial(
        analysis.discover_law, laws=(*POTENTIALS[:2], *ROTATIONS[:1])
    )
    monkeypatch.setattr(discovery, "discover_law", few)
    monkeypatch.setattr(law_regression, "MOST_TERMS", 1)
    monkeypatch.setattr(effects, "LYAPUNOV_POINTS", 5)
    with blank_figures() as figures:
        yield figures


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in WORDS]
)
def test_a_command_writes_and_says_what_is_kept(
    name, tmp_path, fitted_run, printed, same_numbers, little_work
):
    words = words_of(name, tmp_path, fitted_run)
    folders = [
        tmp_path,
        *{Path(word).parent for word in words if word.endswith("/run")},
    ]
    before = contents(folders)
    text = printed(*words)
    write_drawn(little_work.values(), tmp_path)
    changed = {f for f, held in contents(folders).items() if before.get(f) != held}
    same_numbers.check(name.replace(" ", "-"), result_of(changed, folders, text))


@pytest.mark.parametrize("command", SHARED)
def test_a_shared_run_is_that_of_its_command(command, fitted_run):
    folder, _ = fitted_run(SHARED[command])
    assert RunFolder.open(folder).command == command


def test_each_command_has_its_words():
    named = {words.split()[0] for words in WORDS.values()} | set(SHARED)
    assert named == {command.name for command in COMMANDS}
