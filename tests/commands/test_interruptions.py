"""Interruptions and damaged input at the command line, in processes of their own."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest
from tests.commands.test_every_command import words_of
from tests.damage import damage_bytes

MAIN = [sys.executable, "-m", "pinav"]

MOMENTS = [0.1 * step for step in range(1, 31)]


def pinav(*words, **options):
    return subprocess.run(
        [*MAIN, *map(str, words)], capture_output=True, text=True, **options
    )


def one_line(text: str) -> bool:
    """One line of ours at the end, and no traceback; a bar of progress may precede."""
    lines = [line for line in text.splitlines() if line.startswith("pinav: ")]
    return len(lines) == 1 and "Traceback" not in text


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "data.csv"
    words = ("simulate", "barrier-crossings", "--count", "1", "--positions-only")
    assert pinav(*words, "--out", path).returncode == 0
    return path


@pytest.mark.slow
@pytest.mark.parametrize("moment", MOMENTS)
def test_an_interrupt_ends_in_one_line_at_any_moment(moment, data, tmp_path):
    out = tmp_path / "run"
    interrupt(["fit", str(data), "--out", str(out), "--max-steps", "3"], moment)
    assert not list(out.glob("**/.*.tmp"))
    if moment in MOMENTS[::6]:  # each of these is a whole fit
        again = pinav("fit", data, "--out", out, "--max-steps", "3", "--resume")
        assert again.returncode == 0, again.stderr


@pytest.mark.slow
@pytest.mark.parametrize("moment", [0.2, 1.0, 3.0])
@pytest.mark.parametrize("command", ["explore", "heat", "identify", "navigate"])
def test_other_commands_end_in_one_line_too(command, moment, tmp_path, fitted_run):
    if command == "identify":
        data = str(fitted_run("identified")[1])
        words = ["identify", data, "--out", str(tmp_path / "out")]
    else:
        words = words_of(command, tmp_path, fitted_run)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    interrupt(words, moment)
    assert not list(tmp_path.glob("**/.*.tmp"))
    assert all(path.read_bytes() == content for path, content in before.items())


def interrupt(words, moment):
    """Send Ctrl-C to a command after some seconds: it has ended, or says so."""
    process = subprocess.Popen([*MAIN, *words], stderr=subprocess.PIPE, text=True)
    time.sleep(moment)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode in (0, 130), errors
    assert process.returncode == 0 or one_line(errors), errors


AFTER = "atexit.register(os.kill, os.getpid(), signal.SIGINT); sys.exit(0)"
THROUGH_COMPILED_CODE = """
try:
    exec('raise KeyboardInterrupt')
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "code"), [(AFTER, 0), (THROUGH_COMPILED_CODE, 130), ("1 / 0", 1)]
)
def test_how_a_command_ends_is_the_exit_status_of_its_process(work, code, tmp_path):
    (tmp_path / "command.py").write_text(
        "import atexit, os, signal, sys; import pinav.cli; from pinav.__main__ import "
        f"main; pinav.cli.main = lambda: exec({work!r}); main()"
    )
    process = subprocess.run(
        [sys.executable, "-m", "command"], capture_output=True, cwd=tmp_path
    )
    assert process.returncode == code
    assert (b"ZeroDivisionError" in process.stderr) == (code == 1)


@pytest.mark.slow
@pytest.mark.parametrize("words", ["fit --help", "report run"])
def test_a_reader_that_leaves_a_pipe_is_no_error(words, fitted_run):
    run, _ = fitted_run("network")
    command = f"cd {run.parent}; {sys.executable} -m pinav {words}"
    done = subprocess.run(
        ["bash", "-c", f"{command} | head -0"], capture_output=True, text=True
    )
    assert done.stderr == ""


@pytest.mark.slow
def test_a_device_that_is_not_there_is_named(data, tmp_path):
    environ = os.environ | {"JAX_PLATFORMS": "cuda"}
    done = pinav("fit", data, "--out", tmp_path / "run", env=environ)
    assert done.returncode == 2
    assert one_line(done.stderr), done.stderr
    assert "unset it, or set it to cpu" in done.stderr


@pytest.mark.slow
def test_a_limit_of_memory_is_named():
    words = f"{sys.executable} -m pinav report nowhere"
    done = subprocess.run(
        ["bash", "-c", f"ulimit -v 1000000; {words}"], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "raise it to 4 GiB" in done.stderr


COMMANDS_OF_DATA = (
    ("inspect",),
    ("identify", "--out", "out"),
    ("fit", "--out", "out", "--max-steps", "1"),
    ("compare", "--out", "out", "--max-steps", "1"),
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_damaged_data_never_end_in_a_traceback(
    seed, data, tmp_path, monkeypatch, capsys
):
    from pinav import cli

    rng = random.Random(seed)
    monkeypatch.chdir(tmp_path)
    name = rng.choice(("data.csv", "data.npz", "system.toml"))
    (tmp_path / name).write_bytes(damage_bytes(data.read_bytes(), rng))
    (tmp_path / "mine.txt").write_text("mine")
    if name == "system.toml":
        argv = ["fit", str(data), "--system", name, "--out", "out", "--max-steps", "1"]
    else:
        command, *options = rng.choice(COMMANDS_OF_DATA)
        argv = [command, name, *options]
    code = cli.run(argv)
    assert code in (0, 1, 2)
    errors = capsys.readouterr().err
    assert code == 0 or one_line(errors), errors
    assert (tmp_path / "mine.txt").read_text() == "mine"
