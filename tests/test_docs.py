"""Every block of code of the pages runs, and every file they link to is there."""

import importlib
import os
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest
from docs.figures.draw import RECIPES
from docs.figures.workshop import Workshop
from docs.follow import blocks, command_lines, save_settings
from PIL import Image
from validation.truth import TRUTH
from validation.truth import __main__ as truth

from pinav import cli
from pinav.commands import COMMANDS
from pinav.commands.command import resolve
from pinav.commands.parsing import parse

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md")), *TUTORIALS]


def page_id(page: Path) -> str:
    """The path of a page, as people write it."""
    return page.relative_to(ROOT).as_posix()


@pytest.fixture
def sandbox(tmp_path, monkeypatch):
    """An empty folder beside the examples, in which the code of a page runs."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


LONG = {"bead.md", "tracker.md", "wrong-force.md"}
"""Tutorials of some minutes: `make validate` runs them, tests read their commands."""

EXTRAS = {"exchange.md": ("xarray", "h5netcdf", "sklearn", "magpylib")}
"""Optional packages that the code of a page needs."""


def mark_of(page: Path) -> pytest.MarkDecorator:
    """Pages run with the slow tests, or where their packages are installed."""
    needs = EXTRAS.get(page.name)
    if page.name in LONG and page in TUTORIALS and not os.environ.get("PINAV_LONG"):
        return pytest.mark.skip("some minutes: PINAV_LONG=1 or make validate runs it")
    return pytest.mark.extras(*needs) if needs else pytest.mark.slow


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=mark_of(p), id=page_id(p)) for p in PAGES if blocks(p)],
)
@pytest.mark.usefixtures("optimised")
def test_the_code_of_a_page_runs(page, sandbox, fitted_runs, recording):
    """README and tutorials begin with nothing, others with a fitted run."""
    if page.name != "README.md" and page not in TUTORIALS:
        run, _ = fitted_runs.copy("kernel", sandbox)
        (sandbox / "runs").mkdir()
        run.rename(sandbox / "runs" / "mine")
    for language, text in blocks(page):
        if language == "python":
            run_python(text, sandbox, recording)
        elif language == "toml":
            save_settings(text, sandbox)
        else:
            run_commands(text)


def run_python(text: str, sandbox: Path, recording) -> None:
    """Run a block; recordings that it names are put beside it."""
    for name in re.findall(r'"([\w.-]+\.(?:csv\.gz|xlsx))"', text):
        (sandbox / name).symlink_to(recording(RECORDED_IN[name]) / name)
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    numbers = re.findall(r"^[-.e\d]+$", done.stdout, flags=re.MULTILINE)
    if "pinav.score(" in text:  # the example of the README
        assert 0.0 < float(done.stdout.split()[-1]) < 2.0
    assert all(np.isfinite(float(number)) for number in numbers)


def run_commands(text: str) -> None:
    """Run the lines that call pinav."""
    for words in command_lines(text):
        if words[0] == "pinav":
            with jax.numpy_dtype_promotion("standard"):
                assert cli.run(words[1:]) == 0, words
        elif words[:3] == TRUTH.words.split():
            assert truth.run(words[3:]) == 0, words
        else:
            assert words[0] == "make", f"{words} is never run"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_the_commands_and_settings_of_a_page_can_be_read(page):
    text = page.read_text(encoding="utf-8")
    for kind, block in re.findall(
        r"^```(sh|bash|toml)\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    ):
        if kind == "toml":
            assert tomllib.loads(block)
            continue
        for words in command_lines(block):
            if words[0] == "pinav":
                command, arguments = cli.command_named(words[1]), words[2:]
            elif words[:3] == TRUTH.words.split():
                command, arguments = TRUTH, words[3:]
            else:
                continue
            assert command is not None, words
            options = resolve(command.options)
            assert parse(options, arguments, prog="pinav") is not None, words


def test_the_page_of_commands_holds_the_help_of_each(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    command_help = importlib.import_module("command_help")
    for command in COMMANDS:
        text = command_help.help_of(command)
        usage, paragraphs, tables = command_help.help_parts(text)
        assert usage.startswith(f"usage: pinav {command.name} ")
        assert paragraphs[0].endswith(".")
        shown = set(re.findall(r"--[a-z-]{2,}", usage + " ".join(paragraphs) + tables))
        assert shown == set(re.findall(r"--[a-z-]{2,}", text))
    assert "```{command-help}" in (DOCS / "commands.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", TUTORIALS, ids=page_id)
def test_a_tutorial_says_what_it_needs_and_how_long_it_takes(page):
    text = page.read_text(encoding="utf-8")
    for part in (
        "**You need**",
        "**You will have**",
        "**Time:**",
        "\n## Where to go next",
    ):
        assert part in text, part


def methods() -> list[str]:
    """The pages of methods, as the front page lists them."""
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = re.search(r'caption: "Explanation.*?\n\n(.*?)```', index, re.DOTALL)
    assert listed is not None
    assert len(listed[1].split()) > 8
    return listed[1].split()


def test_every_page_of_a_method_has_a_figure_and_says_when_it_is_wrong():
    for name in methods():
        text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
        assert "\n## When it is wrong\n" in text, name
        assert "](figures/" in text, name


FIGURES = {p.name: p for p in sorted((DOCS / "figures").glob("*.png"))}


def test_every_figure_has_a_recipe_and_is_shown():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    shown = re.findall(r"!\[[^\]]+\]\([^)]*?([\w-]+\.png)\)", text)
    assert set(shown) == set(RECIPES) == set(FIGURES)


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_small_enough_for_a_page_and_large_enough_to_read(name):
    path = FIGURES[name]
    with Image.open(path) as picture:
        assert 600 <= picture.width <= 1250
        assert picture.mode != "RGBA"  # dark pages would shine through
    assert path.stat().st_size < 60_000


def test_a_run_of_a_figure_that_was_cut_short_is_made_again(tmp_path):
    workshop, made = Workshop(tmp_path), []

    def write(path):
        made.append(path)
        path.write_text("numbers")
        if len(made) == 1:
            raise RuntimeError("cut short")

    with pytest.raises(RuntimeError):
        workshop.file("numbers.txt", write)
    for _ in range(2):
        assert workshop.file("numbers.txt", write).read_text() == "numbers"
    assert len(made) == 2


RECORDED_IN = {"sessions.csv.gz": "magscope_cellbot_sessions"}
"""Folders of the recordings that the pages name."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name
)
@pytest.mark.usefixtures("optimised")
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


NOTEBOOK = sorted((DOCS / "notebook").glob("*.md"))
"""What tells of earlier versions, and may name what is gone."""


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOK], ids=page_id)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"


NAMING = [*PAGES, ROOT / "CONTRIBUTING.md", *sorted((DOCS / "api").glob("*.md"))]
"""Pages that name files, folders and modules; the change log tells of earlier ones."""

TOP = r"tests|validation|benchmarks|examples|src|docs"
BELOW = "|".join(path.name for path in (ROOT / "src/pinav").iterdir() if path.is_dir())
FILES = re.compile(
    rf"(?<![\w/.-])((?:{TOP}|{BELOW}|formats)/[\w*/.-]+\.(?:py|toml|js))\b"
)
FOLDERS = re.compile(r"`((?:\w+/)+)`")
MODULES = re.compile(r"\b(?:pinav|benchmarks|validation)(?:\.[A-Za-z]\w*)+")
PLACES = (ROOT, ROOT / "src/pinav", ROOT / "src/pinav/recordings")
"""Folders from which the pages name files."""

OF_RUNS = {"cells/", "figures/"}
"""Folders below a run."""


@pytest.mark.parametrize("page", NAMING, ids=page_id)
def test_what_a_page_names_of_the_repository_is_there(page):
    text = page.read_text(encoding="utf-8")
    names = {*FILES.findall(text), *FOLDERS.findall(text)} - OF_RUNS
    gone = {n for n in names if not any(any(p.glob(n)) for p in PLACES)}
    gone |= {n for n in MODULES.findall(text) if not is_importable(n)}
    assert not gone


def is_importable(name: str) -> bool:
    """True for a module, and for what a module holds."""
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True
