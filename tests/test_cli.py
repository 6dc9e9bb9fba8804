import os
import re
import signal
import subprocess
import sys
import threading
import time
from importlib import metadata
from pathlib import Path

import jax
import pytest
from tests.defects import told

from pinav import __version__, cli, numerics
from pinav.commands import COMMANDS, dispatch
from pinav.commands.command import resolve
from pinav.commands.fit import FitOptions
from pinav.commands.identify import IdentifyOptions
from pinav.commands.parsing import parse
from pinav.commands.reproduce import ReproduceOptions
from pinav.commands.settings import Settings
from pinav.reading import Reading


def fails(capsys, *argv: str) -> str:
    """The one line that a failing command prints."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
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
IDENTIFY = "identify a.csv --out b"
NAVIGATE = "navigate nowhere --from 0,0 --to 9,9 --out b"
ONLINE = "navigate --out b --learn-online"
DESIGN = "design paper --from=1,1 --to=9,9 --out b"
STUDY = "study noise --out b"
LIVE = "live nothing"

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
    f"{IDENTIFY} --train-fraction 1": "--train-fraction: expected between 0",
    f"{IDENTIFY} --max-tracks -1": "--max-tracks: expected 0 or more",
    f"{IDENTIFY} --reading fps=a": "reading: Expected `float . null`, got `str` - at",
    f"{IDENTIFY} --reading speed=1": "reading: Object contains unknown field `speed`",
    f"{IDENTIFY} --reading fps=": "expected a value after 'fps='",
    f"{IDENTIFY} --reading no.toml": "no.toml: expected NAME=VALUE, or a TOML file",
    f"{IDENTIFY} --reading delay=-1": "delay: expected 0 or more, got -1.0",
    "compare a.npz --out b --models neural-force": "--models: expected at least 2",
    f"{NAVIGATE} --thrust 0": "--thrust: expected > 0",
    f"{NAVIGATE} --time-limit -1": "--time-limit: expected > 0",
    f"{NAVIGATE} --delay -0.1": "--delay: expected 0 or more",
    f"{NAVIGATE} --seeds 0": "--seeds: expected 1 or more",
    f"{NAVIGATE} --samples -1": "--samples: expected 0 or more",
    f"{NAVIGATE} --keep-out 1,2": "--keep-out: expected 3 or 4 numbers",
    f"{NAVIGATE} --arena 1,2,3": "--arena: expected 4 or 6 numbers",
    "navigate --out b": "RUN: expected the folder of a fit, or --learn-online",
    "navigate somewhere --out b": "--from, --to: expected the places",
    "navigate nowhere --learn-online vortex --out b": "nowhere",
    f"{ONLINE} vortex-current --from 1,1": "--from, --to: expected the places",
    f"{ONLINE} paper": "task 'paper' is unknown; choose one of: barrier-",
    f"{ONLINE} maze --from=1,1 --to=2,2": "maze",
    f"{ONLINE} wall --from=1,1 --to=2,2": "a swimmer in the plane, got 'wall'",
    f"{ONLINE} follow-line": "expected a place to reach, got FollowPath",
    "design paper --out b": "--from, --to: expected the places",
    "design maze --from=1,1 --to=9,9 --out b": "maze",
    "design wall --from=1,1 --to=9,9 --out b": "expected a swimmer in the plane",
    f"{DESIGN} --release 3,3,1,1": "--release: expected X0,Y0,X1,Y1 with X0 < X1",
    f"{DESIGN} --release=-50,0,1,1": "--release: expected a rectangle inside of the",
    f"{DESIGN} --designs": "--designs",
    f"{DESIGN} --duration 0.1": "--duration: expected two steps or more",
    f"{DESIGN} --accuracy 1": "--accuracy",
    f"{DESIGN} --data nowhere.csv": "nowhere.csv",
    f"{STUDY} --sigmas -1": "--sigmas: expected 0 or more, got -1.0",
    f"{STUDY} --count 0": "--count: expected 1 or more, got 0",
    f"{STUDY} --max-steps 10000000": "--max-steps: expected 1 to 1e.06, got 10000000",
    f"{STUDY} --seeds 1 1": "--seeds: 1 is given twice; drop one",
    f"{STUDY} --models": "--models: expected at least one",
    f"{STUDY} --workers 0": "--workers: expected 1 or more, got 0",
    f"{STUDY} --workers here": "--workers: expected a number, or the address",
    f"{STUDY} --cell-timeout 0": "--cell-timeout: expected > 0",
    "study noise nowhere --out b": "scenario 'nowhere' is unknown",
    "study noise brownian --out b": "system 'brownian' is stochastic",
    "study data-efficiency paper --out b": "has one fixed start",
    "study growth --out b": "invalid choice 'growth'",
    f"{LIVE} --to=0,0 --keep-out 1,1,2": "lies in the forbidden",
    f"{LIVE} --keep-out 1,1,0": "--keep-out: expected a radius > 0, got 0",
    f"{LIVE} --replay --speed 0": "--speed: expected a number > 0 or max",
    f"{LIVE} --replay --speed x": "--speed: expected a number > 0",
    f"{LIVE} --resume": "--resume: needs the --out of a session",
    f"{LIVE} --replay --commands-to x": "nobody listens",
    f"{LIVE} --to 1": "--to: expected 2 numbers with commas",
    f"{LIVE} --replay": "nothing: no such file",
    f"{LIVE} --page 70000": "--page: expected between -1 and 65536",
    "live tcp://10.0.0.1:5000": "needs a shared secret",
    "heat": "Missing from pinav heat",
    "heat melt": "melt",
    "heat simulate": "CASE",
    "heat simulate no.toml": "no.toml: cannot be read",
    "heat simulate .": "cannot be read",
    "heat simulate a.toml --colour red": "--colour",
    "heat simulate a.toml a.toml": "a.toml",
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


def test_an_interruption_says_how_to_go_on_and_an_error_is_raised(capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(dispatch, "execute", interrupt)
    argv = ["fit", "my data.csv", "--out", "r", "--overwrite"]
    assert cli.run(argv) == cli.INTERRUPTED
    line = capsys.readouterr().err
    assert line.endswith("continue with: pinav fit 'my data.csv' --out r --resume\n")

    def fail(*_):
        raise ValueError("ours")

    monkeypatch.setattr(dispatch, "execute", fail)
    with pytest.raises(ValueError, match="ours"):
        cli.run(["explore", "run"])


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
    with told("c.toml: Object contains unknown field `seeds`"):
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


def test_flags_are_for_the_compiler_that_knows_them():
    assert "fusion_emitters" in numerics.compiler_flags({}, "0.10.2")["XLA_FLAGS"]
    assert numerics.compiler_flags({}, "0.11.0") == {}
    assert numerics.compiler_flags({"XLA_FLAGS": ""}, "0.10.2") == {}
    code = "import jax; jax.jit(lambda x: x + 1)(1.0)"
    flags = numerics.compiler_flags({}, metadata.version("jaxlib"))
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=os.environ | flags, capture_output=True)
    assert done.returncode == 0, done.stderr


def test_compiled_code_is_kept_for_this_machine_where_it_can_be(tmp_path):
    variables = numerics.compilation_cache({"XDG_CACHE_HOME": str(tmp_path)})
    folder = Path(variables["JAX_COMPILATION_CACHE_DIR"])
    assert folder.parent == tmp_path / "pinav"
    assert folder.is_dir()
    assert int(variables["JAX_COMPILATION_CACHE_MAX_SIZE"]) > 0
    empty = tmp_path / "empty"
    empty.mkdir()
    for chosen in ("JAX_COMPILATION_CACHE_DIR", "JAX_ENABLE_COMPILATION_CACHE"):
        choice = {"XDG_CACHE_HOME": str(empty), chosen: "false"}
        assert numerics.compilation_cache(choice) == {}
        assert not any(empty.iterdir())
    file = empty / "file"
    file.write_text("")
    assert numerics.compilation_cache({"XDG_CACHE_HOME": str(file)}) == {}
