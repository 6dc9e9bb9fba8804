"""The wheel: small, without tests, and whole without the checkout."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from pinav.commands import COMMANDS

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    words = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", str(ROOT)]
    done = subprocess.run(
        [*words, "--wheel-dir", str(folder)], capture_output=True, text=True
    )
    if done.returncode:
        pytest.skip(f"no wheel could be built here: {done.stderr.splitlines()[-1]}")
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The folder that the wheel was unpacked into."""
    folder = tmp_path_factory.mktemp("site")
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


def call(installed, folder, *words):
    """pinav from the unpacked wheel, in an empty folder."""
    environment = os.environ | {"PYTHONPATH": str(installed)}
    code = f"import pinav; assert pinav.__file__.startswith({str(installed)!r})"
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    return subprocess.run(
        [sys.executable, "-m", "pinav", *map(str, words)],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
    )


def test_the_wheel_is_small_and_holds_the_package_alone(wheel):
    assert wheel.stat().st_size < 3e6
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"pinav"}
    assert "pinav/py.typed" in names
    assert not [name for name in names if "test" in Path(name).name]


def test_every_command_has_its_help(installed, tmp_path):
    help_text = call(installed, tmp_path, "--help").stdout
    for command in COMMANDS:
        assert command.name in help_text


def test_data_are_simulated_and_a_run_is_explored(installed, tmp_path, fitted_run):
    done = call(installed, tmp_path, "simulate", "paper", "--out", "data.csv")
    assert done.returncode == 0, done.stderr
    run, _ = fitted_run("kernel")
    done = call(installed, tmp_path, "explore", run)
    assert done.returncode == 0, done.stderr
    assert (run / "explore.html").stat().st_size < 1.5e6
