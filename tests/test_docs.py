"""Every block of code of the pages runs, and every file they link to is there."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

from pinav import cli

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each block of code that can be run, in order."""
    text = page.read_text(encoding="utf-8")
    return re.findall(r"^```(python|sh)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


@pytest.fixture
def sandbox(tmp_path, monkeypatch):
    """An empty folder beside the examples, in which the code of a page runs."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


EXTRAS = {"exchange.md": ("xarray", "h5netcdf", "sklearn", "magpylib")}
"""Optional packages that the code of a page needs."""


def mark_of(page: Path) -> pytest.MarkDecorator:
    """Pages run with the slow tests, or where their packages are installed."""
    needs = EXTRAS.get(page.name)
    return pytest.mark.extras(*needs) if needs else pytest.mark.slow


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=mark_of(p), id=p.name) for p in PAGES if blocks(p)],
)
def test_the_code_of_a_page_runs(page, sandbox, fitted_runs, recording):
    """The README begins with nothing, other pages with a fitted run and its data."""
    if page.name != "README.md":
        run, _ = fitted_runs.copy("kernel", sandbox)
        (sandbox / "runs").mkdir()
        run.rename(sandbox / "runs" / "mine")
    for language, text in blocks(page):
        if language == "python":
            run_python(text, sandbox, recording)
        else:
            run_commands(text)


def run_python(text: str, sandbox: Path, recording) -> None:
    """Run a block; recordings that it names are put beside it."""
    for name in re.findall(r'"([\w.-]+\.(?:csv\.gz|xlsx))"', text):
        (sandbox / name).symlink_to(recording(RECORDED_IN[name]) / name)
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    numbers = re.findall(r"^[-.e\d]+$", done.stdout, flags=re.MULTILINE)
    assert all(np.isfinite(float(number)) for number in numbers)


def run_commands(text: str) -> None:
    """Run the lines that call pinav; a line may go on after a backslash."""
    for line in text.replace("\\\n", " ").strip().splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["pinav"]:
            with jax.numpy_dtype_promotion("standard"):
                assert cli.run(words[1:]) == 0, line
        else:
            assert words[:1] in ([], ["make"]), f"{line!r} is never run"


RECORDED_IN = {"sessions.csv.gz": "magscope_cellbot_sessions"}
"""Folders of the recordings that the pages name."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_settings_that_a_page_shows_can_be_read(page):
    text = page.read_text(encoding="utf-8")
    for block in re.findall(r"^```toml\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        tomllib.loads(block)


@pytest.mark.slow
def test_the_example_of_the_readme_has_a_small_error():
    (example,) = (t for name, t in blocks(ROOT / "README.md") if "score(" in t)
    done = subprocess.run(
        [sys.executable, "-c", example], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert 0.0 < float(done.stdout.split()[-1]) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name
)
def test_the_examples_run(path):
    done = subprocess.run([sys.executable, path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_the_make_targets_exist():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = re.findall(r"make ([a-z]+)", README)
    assert named
    for target in named:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"
