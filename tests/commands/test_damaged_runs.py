"""Commands on damaged runs, data and cases: one line, and nothing half-written.

Computation is stopped where the numbers begin, because only what is read can be
damaged: a damage that nobody sees ends there, too.
"""

import random

import jax
import pytest
from tests.commands.test_heat import small
from tests.commands.test_interruptions import damaged, one_line

from pinav import cli
from pinav.commands import report_page
from pinav.commands.analyse import job as analyse_job
from pinav.commands.discover import job as discover_job
from pinav.commands.evaluate import job as evaluate_job
from pinav.commands.explore import job as explore_job
from pinav.commands.heat.learn import LearnTask
from pinav.commands.heat.simulate import SimulateTask
from pinav.commands.navigate import job as navigate_job
from pinav.errors import FitError

COMMANDS = {
    "evaluate": ("evaluate", "run", "data.npz"),
    "analyse": ("analyse", "run"),
    "discover": ("discover", "run"),
    "navigate": ("navigate", "run", "--from", "1,1", "--to", "2,2", "--out", "out"),
    "explore": ("explore", "run"),
    "export": ("export", "run", "--to", "napari", "--out", "out.csv"),
    "report": ("report", "run"),
}
CASES = {
    "heat simulate": ("heat", "simulate", "tumour.toml", "--out", "out"),
    "heat learn": ("heat", "learn", "tumour.toml", "--out", "out"),
}
READ = {".toml", ".json", ".npz", ".eqx"}


class Reached(FitError):
    """The numbers begin."""


STAGES = (
    (evaluate_job, "clean_trajectories"),
    (analyse_job, "split_force"),
    (discover_job, "discover_law"),
    (navigate_job, "controller"),
    (explore_job, "document"),
    (SimulateTask, "run"),
    (LearnTask, "run"),
    (report_page, "write_report"),
)
"""Where the numbers of each command begin."""


def stop(*args, **options):
    raise Reached("the numbers begin")


def refusal(argv, capsys):
    """The exit code of a command that stops before its numbers, and its complaint."""
    with pytest.MonkeyPatch.context() as patch, jax.numpy_dtype_promotion("standard"):
        for owner, name in STAGES:
            patch.setattr(owner, name, stop)
        code = cli.run(argv)
    return code, capsys.readouterr().err


def contents(folder):
    """Every file below a folder, and its bytes."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path: path.read_bytes() for path in files}


def check(argv, folder, capsys):
    """Refused with one line and nothing changed, or read to the end."""
    before = contents(folder)
    code, errors = refusal(argv, capsys)
    assert code in (0, 1, 2), errors
    assert code == 0 or one_line(errors), errors
    after = contents(folder)
    assert before.items() <= after.items()
    assert not [path for path in after if path.suffix == ".tmp"]
    if code == 2:
        assert before.keys() == after.keys(), argv


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_run_is_refused_in_one_line(seed, fitted_run, monkeypatch, capsys):
    rng = random.Random(seed)
    run, data = fitted_run(rng.choice(("kernel", "kernel", "langevin", "identified")))
    monkeypatch.chdir(run.parent)
    files = [path for path in sorted(run.iterdir()) if path.suffix in READ]
    file = rng.choice([*files, data])
    if rng.random() < 0.1:
        file.unlink()
    else:
        file.write_bytes(damaged(file.read_bytes(), rng))
    check(rng.choice(list(COMMANDS.values())), run.parent, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_case_is_refused_in_one_line(seed, tmp_path, monkeypatch, capsys):
    rng = random.Random(seed)
    case = small("tumour", tmp_path, learn={"data": "probes.csv"})
    rows = [f"a,{t},0.0,{37 + 0.01 * t}" for t in range(0, 200, 20)]
    readings = tmp_path / "probes.csv"
    readings.write_text("\n".join(["probe,t,r,T", *rows, ""]))
    file = rng.choice((case, readings))
    file.write_bytes(damaged(file.read_bytes(), rng))
    monkeypatch.chdir(tmp_path)
    check(rng.choice(list(CASES.values())), tmp_path, capsys)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_run_without_its_files_is_refused_at_once(
    name, tmp_path, monkeypatch, capsys
):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("mine")
    (tmp_path / "data.npz").write_bytes(b"not an archive")
    monkeypatch.chdir(tmp_path)
    code, errors = refusal(COMMANDS[name], capsys)
    assert code == 2
    assert one_line(errors)
    assert {path.name for path in tmp_path.rglob("*")} == {
        "run",
        "mine.txt",
        "data.npz",
    }
