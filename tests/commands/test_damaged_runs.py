"""Every command on damaged files: one line with a remedy, and nothing half-written.

Computation is stopped where the numbers begin, because only what is read can be
damaged: a damage that nobody sees ends there, too.
"""

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import msgspec
import numpy as np
import pytest
from benchmarks.fit import compare
from benchmarks.fit.contestants import Effort
from tests.benchmarks.test_bench_fit import measurement
from tests.commands.test_interruptions import one_line
from tests.damage import damage
from tests.fitted_runs import SHORT, STUDY, blank_figures
from tests.heat_cases import small
from tests.live.sessions import HELLO, frame_line
from tests.validation.test_truth import trap_folder
from validation.truth import __main__ as truth
from validation.truth import job as truth_job

from benchmarks import __main__ as benchmarks
from pinav import cli
from pinav.analysis import analysis
from pinav.analysis.discovery import discovery
from pinav.commands import results
from pinav.commands.explore import job as explore_job
from pinav.commands.heat import job as heat_job
from pinav.commands.navigate import job as navigate_job
from pinav.commands.reproduce import job as reproduce_job
from pinav.errors import FitError
from pinav.evaluation import evaluation
from pinav.live.messages import encode
from pinav.thermal.setup import Setup

KEYS = range(300)
"""Faults were sought with even keys, and what was mended was judged by odd ones."""

READ = {".toml", ".json", ".npz", ".eqx", ".csv", ".jsonl", ".txt", ".py"}


class Reached(FitError):
    """The numbers begin."""


def stop(*args, **options):
    raise Reached("the numbers begin")


STAGES = (
    (evaluation, "clean_trajectories"),
    (analysis, "helmholtz_split"),
    (discovery, "discover_law"),
    (navigate_job, "compare_models"),
    (reproduce_job, "matching"),
    (reproduce_job, "predict"),
    (truth_job, "judge_trap"),
    (explore_job, "document"),
    (heat_job, "simulate"),
    (Setup, "readings"),
    (results, "write_report"),
    (compare, "_train"),
)
"""Where the numbers of each command begin."""


def words(*lines: str) -> tuple[tuple[str, ...], ...]:
    """The words of each command."""
    return tuple(tuple(line.split()) for line in lines)


READ_ONLY = ("explore run", "report run")
FITTED = words(
    *("evaluate run data.npz", "analyse run", "discover run"),
    *("navigate run --from 1,1 --to 2,2 --out out", "explore run"),
    *(f"export run --to {form} --out out.csv" for form in ("napari", "trackmate")),
    "report run",
)


class Subject(NamedTuple):
    """What is damaged, and the commands that read it.

    Attributes:
        make: puts the files into a folder; gets what copies a fitted run there.
        commands: one of which is run in that folder.
    """

    make: Callable[[Path, Callable[[str, Path], object]], object]
    commands: tuple[tuple[str, ...], ...]


def run_of(name: str) -> Callable[[Path, Callable[[str, Path], object]], object]:
    return lambda folder, copy: copy(name, folder)


def case(folder: Path, copy: Callable) -> None:
    small("tumour", folder, {"learn": {"data": "probes.csv"}})
    rows = [f"a,{t},0.0,{37 + 0.01 * t}" for t in range(0, 200, 20)]
    (folder / "probes.csv").write_text("\n".join(["probe,t,r,T", *rows, ""]))


def session(folder: Path, copy: Callable) -> None:
    """Frames of a rig, a table of the same, and a session that was begun.

    What a rig writes while it runs is not damaged: pinav waits for better lines.
    """
    frames = [frame_line(n, x=0.1 * n, frequency=1.0) for n in range(8)]
    lines = encode(HELLO) + b"\n".join(frames) + b'\n{"type":"bye"}\n'
    for name in ("frames.jsonl", "rig.lines"):
        (folder / name).write_bytes(lines)
    rows = [f"{0.1 * n:.1f},{n},0,1,0.5" for n in range(60)]
    header = "t_s,x_um,y_um,freq_hz,alpha_rad"
    (folder / "table.csv").write_text("\n".join([header, *rows, ""]))
    assert cli.run(["live", str(folder / "rig.lines"), "--out", str(folder)]) == 0


def source(folder: Path, copy: Callable) -> None:
    rows = "\n".join(f"{0.1 * n} {0.2 * n} {n}" for n in range(20))
    (folder / "authors.txt").write_text(rows)


def systems(folder: Path, copy: Callable) -> None:
    for file in SYSTEMS.glob("*.*"):
        shutil.copy(file, folder)


def measured(folder: Path, copy: Callable) -> None:
    """Two fits that a benchmark has kept."""
    (folder / "out").mkdir()
    effort = msgspec.json.encode(Effort()).decode()
    (folder / "out" / "effort.json").write_text(effort)
    for seed in (0, 1):
        kept = msgspec.json.encode(measurement(seed=seed))
        file = folder / "out" / f"ude-{seed}"
        file.with_suffix(".json").write_bytes(kept)
        np.savez(file.with_suffix(".npz"), curve=np.array([[1.0, 0.5], [2.0, 0.1]]))


SYSTEMS = Path(__file__).parents[2] / "examples" / "systems"
SUBJECTS: dict[str, Subject] = {
    "kernel": Subject(run_of("kernel"), FITTED),
    "langevin": Subject(run_of("langevin"), FITTED),
    "identified": Subject(run_of("identified"), FITTED),
    "reproduced": Subject(
        run_of("reproduced"),
        words(
            f"reproduce {' '.join(SHORT)} --lbfgs-steps 3 --out run --resume",
            *READ_ONLY,
        ),
    ),
    "studied": Subject(
        run_of("studied"),
        words(
            f"study noise {' '.join(STUDY)} --out run --resume",
            *("study status run", "report run"),
        ),
    ),
    "heated": Subject(run_of("heated"), words(*READ_ONLY)),
    "case": Subject(
        case, words(*(f"heat {w} tumour.toml --out out" for w in ("simulate", "learn")))
    ),
    "truth": Subject(
        lambda folder, copy: trap_folder(folder), words("truth cases --out out")
    ),
    "data": Subject(
        source, words("data fetch dragged_trap --source authors.txt --out out")
    ),
    "live": Subject(
        session,
        words(
            "live rig.lines --out . --resume",
            "live frames.jsonl --replay",
            "live table.csv --replay --frames 5",
        ),
    ),
    "bench": Subject(
        measured, words("benchmarks fit --out out --only ude --seeds 0 1")
    ),
    "simulate": Subject(
        systems,
        words(*(f"simulate {f.name} --out out.csv" for f in SYSTEMS.glob("*.toml"))),
    ),
}


PROGRAMS = {"benchmarks": benchmarks.run, "truth": truth.run}
"""What runs the commands that are no words of `pinav`."""


def contents(folder: Path) -> dict[Path, bytes]:
    """Every file below a folder, and its bytes."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refusal(argv, capsys):
    """The exit code of a command that stops before its numbers, and its complaint."""
    with pytest.MonkeyPatch.context() as patch, jax.numpy_dtype_promotion("standard"):
        for owner, name in STAGES:
            patch.setattr(owner, name, stop)
        with blank_figures():
            program = PROGRAMS.get(argv[0])
            code = program(argv[1:]) if program else cli.run(argv)
    return code, capsys.readouterr().err


def check(argv: tuple[str, ...], folder: Path, capsys) -> None:
    """Refused with one line and nothing changed, or read to the end."""
    before = contents(folder)
    code, errors = refusal(argv, capsys)
    assert code in (0, 1, 2), errors
    assert code == 0 or one_line(errors), errors
    after = contents(folder)
    assert before.keys() <= after.keys(), before.keys() - after.keys()
    assert not [path for path in after if path.suffix == ".tmp"]
    if "--resume" not in argv:  # which goes on with what a run wrote
        assert before.items() <= after.items(), argv
    if code == 2 and "--resume" not in argv:
        assert before.keys() == after.keys(), argv


@pytest.mark.slow
@pytest.mark.parametrize("key", KEYS)
def test_damaged_files_are_refused_in_one_line(
    key, fitted_runs, tmp_path, monkeypatch, capsys
):
    rng = random.Random(key)
    subject = SUBJECTS[rng.choice(sorted(SUBJECTS))]
    subject.make(tmp_path, fitted_runs.copy)
    (tmp_path / "mine").write_text("mine")
    files = [path for path in sorted(tmp_path.rglob("*")) if path.suffix in READ]
    damage(rng.choice(files), rng)
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    check(rng.choice(subject.commands), tmp_path, capsys)


@pytest.mark.parametrize("argv", FITTED, ids=lambda argv: " ".join(argv[:4]))
def test_a_run_without_its_files_is_refused_at_once(
    argv, tmp_path, monkeypatch, capsys
):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("mine")
    (tmp_path / "data.npz").write_bytes(b"not an archive")
    monkeypatch.chdir(tmp_path)
    code, errors = refusal(argv, capsys)
    assert code == 2
    assert one_line(errors)
    names = {path.name for path in tmp_path.rglob("*")}
    assert names == {"run", "mine.txt", "data.npz"}
