import os
import re
import signal
import subprocess
import sys
import threading
import time
from importlib import metadata
from pathlib import Path

import pytest

from pinav import __version__, cli, numerics
from pinav.commands import COMMANDS, dispatch
from pinav.commands.command import resolve
from pinav.commands.fit import FitOptions
from pinav.commands.identify import IdentifyOptions
from pinav.commands.parsing import parse
from pinav.commands.reproduce import ReproduceOptions
from pinav.commands.settings import Settings
from pinav.errors import InputError
from pinav.reading import Reading


def fails(capsys, *argv: str) -> str:
    """The one line that a failing command prints."""
    assert cli.run(argv) == cli.USAGE_ERROR
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    assert lines[0].startswith("pinav: ")
    return lines[0]


def test_help_is_quick_and_loads_nothing_heavy():
    code = (
        "import sys, pinav.cli; pinav.cli.run(['--help']);"
        "heavy = {'jax', 'numpy', 'matplotlib', 'pandas', 'tyro'} & set(sys.modules);"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert time.perf_counter() - start < 2.0  # 0.03 s alone; generous under load
    assert all(command.name in done.stdout for command in COMMANDS)


def test_every_command_explains_itself_without_jax(capsys):
    code = (
        "import sys, pinav.cli\n"
        "for command in pinav.cli.COMMANDS:\n"
        "    assert pinav.cli.run([command.name, '--help']) == 0\n"
        "heavy = {'jax', 'numpy', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("usage: pinav") == len(COMMANDS)


def test_version(capsys):
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out == f"pinav {__version__}\n"


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_every_part_of_a_command_can_be_imported(command):
    assert issubclass(resolve(command.options), Settings)
    assert callable(resolve(command.run))
    assert command.report is None or callable(resolve(command.report))
    assert command.result is None or callable(resolve(command.sections))
    assert not command.title or command.report or command.result


FIT = "fit a.npz --out b"

MISTAKES = {
    "fti": r"unknown command 'fti' \(did you mean fit\?\); see pinav --help",
    f"{FIT} --wdith 3": "--wdith.* see pinav fit --help",
    "fit a.npz": "--out",
    f"{FIT} --width -3": "--width: expected 1 to 4096",
    f"{FIT} --width x": "Error parsing --width",
    f"{FIT} --model cnn": "invalid choice 'cnn'",
    f"{FIT} --adam-steps 0": "--adam-steps: expected",
    f"{FIT} --max-steps 0": "--max-steps: expected",
    f"{FIT} --recipe pape": "--recipe: expected one of default, bayes, langevin, curr",
    f"{FIT} --recipe bayes --lbfgs-steps 3": "--lbfgs-steps: only the recipe paper us",
    "fit absent.npz --out b": "absent.npz.*No such file",
    "fit --out b": "expected a file of data, got none; give one or more",
    "fit a.csv --workers 2 --out b": "a.csv: cannot read: No such file",
    "fit a.csv b.csv --out b": "a.csv: cannot read: No such file",
    "identify --out b": "expected a file of data, got none; give one or more",
    "identify a.csv b.csv --out b": "a.csv: cannot read: No such file",
    "identify a.csv --out b --train-fraction 1": "--train-fraction: expected between 0",
    "identify a.csv --out b --max-tracks -1": "--max-tracks: expected 0 or more",
    "inspect absent.csv": "absent.csv: cannot read: No such file",
    "inspect a.csv --columns x": "--columns: expected words such as x=X, got 'x'",
    "inspect a.csv --fps -1": "fps: expected > 0, got -1",
    "reproduce --seeds": "--seeds: expected at least one, got 0",
    "reproduce --seeds 1 1": "--seeds: 1 is given twice",
    "reproduce --resume --overwrite": "--resume and --overwrite: choose",
    "simulate papre --out x.npz": "system 'papre' is unknown; name a file",
    "simulate paper --out x.doc": "x.doc: expected a name ending in .npz or .csv",
    "simulate paper --out absent/a.npz": "absent; make it first",
    "simulate paper --out x.npz --noise -1": "--noise: expected 0",
    "simulate swirl --out x.npz --frame-loss 1": "--frame-loss: expected 0 to below 1",
    "simulate swirl --out x.npz --count 0": "--count: expected 1 or more, got 0",
    "simulate paper --out x.npz --count 2": "scenario 'paper' has one fixed start",
    "evaluate nowhere x.npz": "nowhere holds no run",
    "analyse nowhere --points 4": "--points: expected 5 or more",
    "analyse nowhere --draws 1": "--draws: expected 2 or more",
    "analyse nowhere --reference -1": "--reference: expected 0 or more",
    "analyse nowhere --samples 100": "--samples: expected a power of two",
    "analyse nowhere --relative 1.5": "--relative: expected between 0 and 1",
    "analyse nowhere --shift 0": "--shift: expected > 0",
    "discover nowhere --refits 0": "--refits: expected 1 or more",
    "export nowhere --to napari --out a.csv --draws 0": "draws: expected 1 or more",
    "export nowhere --to napari --out a.csv --points 1": "points: expected 2 or more",
    "report nowhere": "nowhere holds no run",
}


@pytest.mark.parametrize(("words", "message"), MISTAKES.items())
def test_mistakes_get_one_line(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = fails(capsys, *words.split())
    assert re.search(message, line), line
    assert not list(tmp_path.iterdir()), "nothing half-written"


def test_an_interruption_says_how_to_go_on(capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(dispatch, "execute", interrupt)
    argv = ["fit", "my data.csv", "--out", "r", "--overwrite"]
    assert cli.run(argv) == cli.INTERRUPTED
    line = capsys.readouterr().err
    assert line.endswith("continue with: pinav fit 'my data.csv' --out r --resume\n")


def test_an_interrupt_that_a_library_makes_an_error_of_its_own_is_an_interrupt(
    capsys, monkeypatch
):
    def call_compiled_code(*_):
        try:
            cli._interrupt(signal.SIGINT, None)
        except KeyboardInterrupt:
            raise ValueError("invalid affine transformation matrix") from None

    monkeypatch.setattr(cli, "SIGNALLED", threading.Event())
    monkeypatch.setattr(dispatch, "execute", call_compiled_code)
    assert cli.run(["explore", "run"]) == cli.INTERRUPTED
    assert capsys.readouterr().err == "pinav: interrupted\n"


def test_an_error_without_an_interrupt_is_raised(monkeypatch):
    def fail(*_):
        raise ValueError("ours")

    monkeypatch.setattr(dispatch, "execute", fail)
    with pytest.raises(ValueError, match="ours"):
        cli.run(["explore", "run"])


def test_a_config_file_of_a_recording_sets_how_it_is_read_and_split(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text(
        "train_fraction = 0.6\n[reading]\nfps = 20.0\nunits = {t = 's'}\n"
    )
    argv = ["d.csv", "--out", "o", "--config", str(config), "--train-fraction", "0.8"]
    parsed = parse(IdentifyOptions, argv, "pinav identify")
    assert parsed is not None
    assert parsed.settings.train_fraction == 0.8
    assert parsed.reading == Reading(fps=20.0, units={"t": "s"})
    argv[-2:] = ["--reading", "fps=10", "units.heading=rad", "runs=a,b"]
    parsed = parse(IdentifyOptions, argv, "pinav identify")
    assert parsed is not None
    assert parsed.reading.runs == ("a", "b")
    assert parsed.reading.units == {"heading": "rad"}


def test_a_config_file_sets_and_options_win(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text('seeds = [7, 8]\nadam_steps = 5\n[run]\ncommand = "reproduce"\n')
    argv = ["--config", str(config), "--adam-steps", "7500"]
    options = parse(ReproduceOptions, argv, "pinav reproduce")
    assert options is not None
    assert options.settings.seeds == (7, 8)
    assert options.settings.adam_steps == 7500
    argv = ["d.npz", "--out", "o", f"--config={config}"]
    with pytest.raises(
        InputError, match="c.toml: Object contains unknown field `seeds`"
    ):
        parse(FitOptions, argv, "pinav fit")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("seeds = ", "cannot be read"),
        ("sedes = [1]", "unknown field `sedes`"),
        ('adam_steps = "many"', "Expected `int`, got `str`"),
    ],
)
def test_bad_config_files_are_refused(content, message, tmp_path, capsys):
    config = tmp_path / "c.toml"
    config.write_text(content)
    assert message in fails(capsys, "reproduce", "--config", str(config))
    assert "cannot be read" in fails(capsys, "reproduce", "--config", "absent.toml")


def test_simulate_writes_what_load_reads(tmp_path, capsys):
    path = tmp_path / "data.csv"
    assert cli.run(["simulate", "paper", "--out", str(path), "--noise", "0.1"]) == 0
    assert capsys.readouterr().out == f"{path}: 1 trajectory, 501 samples\n"
    from pinav.trajectories import load

    assert load(path).provenance["scenario"] == "paper"
    assert "exists" in fails(capsys, "simulate", "paper", "--out", str(path))
    assert cli.run(["simulate", "paper", "--out", str(path), "--overwrite"]) == 0


def test_flags_are_for_the_compiler_on_which_they_were_tried():
    assert "fusion_emitters" in numerics.compiler_flags({}, "0.10.2")["XLA_FLAGS"]
    assert numerics.compiler_flags({}, "0.11.0") == {}
    assert numerics.compiler_flags({"XLA_FLAGS": ""}, "0.10.2") == {}


def test_the_compiler_knows_the_flags():
    code = "import jax; jax.jit(lambda x: x + 1)(1.0)"
    flags = numerics.compiler_flags({}, metadata.version("jaxlib"))
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=os.environ | flags, capture_output=True)
    assert done.returncode == 0, done.stderr


def test_compiled_code_is_kept_for_this_machine(tmp_path):
    variables = numerics.compilation_cache({"XDG_CACHE_HOME": str(tmp_path)})
    folder = Path(variables["JAX_COMPILATION_CACHE_DIR"])
    assert folder.parent == tmp_path / "pinav"
    assert folder.is_dir()
    assert int(variables["JAX_COMPILATION_CACHE_MAX_SIZE"]) > 0


def test_compiled_code_is_not_kept_where_it_cannot_or_must_not_be(tmp_path):
    for chosen in ("JAX_COMPILATION_CACHE_DIR", "JAX_ENABLE_COMPILATION_CACHE"):
        choice = {"XDG_CACHE_HOME": str(tmp_path), chosen: "false"}
        assert numerics.compilation_cache(choice) == {}
        assert not any(tmp_path.iterdir())
    file = tmp_path / "file"
    file.write_text("")
    assert numerics.compilation_cache({"XDG_CACHE_HOME": str(file)}) == {}
