"""The options of the commands: explained in plain words, and named as they are."""

import contextlib
import importlib
import io
import re
from functools import cache
from pathlib import Path

import pytest
from validation.truth import TRUTH

from pinav.commands import COMMANDS
from pinav.commands.command import Command, resolve
from pinav.commands.dispatch import execute
from pinav.commands.parsing import parse, tag_words

ROOT = Path(__file__).parents[1]
NOTEBOOK = ROOT / "docs" / "notebook"
PAGES = [
    *ROOT.glob("*.md"),
    *(p for p in (ROOT / "docs").rglob("*.md") if p.parent != NOTEBOOK),
]
"""Pages of today; the notebook tells of earlier versions."""

SOURCES = [*(ROOT / "src").rglob("*.py"), *(ROOT / "examples").rglob("*.py")]
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")

BENCHMARKS = {
    "fields": "fields.table",
    "fit": "fit.compare",
    "paper-weakness": "paper_weakness",
    "trainer": "trainer.table",
}
PLAIN = ("accelerator", "gradient", "growth", "heat", "navigate", "recordings", "start")
BENCHMARKS |= dict(zip(PLAIN, PLAIN, strict=True))

BENCH = "python -m benchmarks "
"""The words before the name of a benchmark."""

FOREIGN = {
    "--version",  # of pinav itself
    "--xla",  # begins the names of XLA's flags
    *("--key", "--nifti"),  # examples/heat/phantom.py
    *("--array", "--cpus-per-task", "--wrap"),  # sbatch
    *("--nthreads", "--nworkers", "--protocol", "--scheduler-file"),
    *("--tls-ca-file", "--tls-cert", "--tls-key"),
}
"""Options of other programs that the pages call, the last ones of dask."""


@cache
def help_of(name: str, *words: str) -> str:
    """What `pinav NAME --help` or that of another program prints."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        if name == TRUTH.words:
            execute(TRUTH, ["--help"])
        elif name.startswith(BENCH):
            place = BENCHMARKS[name.removeprefix(BENCH)]
            module = importlib.import_module(f"benchmarks.{place}")
            assert parse(module.Options, ["--help"], prog=name) is None
        else:
            (command,) = (c for c in COMMANDS if c.name == name)
            execute(command, [*words, "--help"])
    return text.getvalue()


def options_of(name: str) -> set[str]:
    """The options that a command takes."""
    texts = [help_of(name), *(help_of(name, *words) for words in tags_of(name))]
    return set(OPTION.findall("".join(texts)))


def tags_of(name: str) -> list[tuple[str, str]]:
    """The words that choose among options of a command, such as `--recipe paper`."""
    commands = [command for command in COMMANDS if command.name == name]
    return [words for one in commands for words in tag_words(resolve(one.options))]


MOST_OPTIONS = 205
"""Options of all commands, that of the help included; lower it as options go."""


def test_the_commands_have_no_more_options_than_before():
    declared = re.compile(r"^\W*(?:-h, )?(--[a-z][a-z-]*)(?: |$)", re.MULTILINE)
    counts = {c.name: len(declared.findall(help_of(c.name))) for c in COMMANDS}
    assert sum(counts.values()) <= MOST_OPTIONS, counts


NAMES = [c.name for c in COMMANDS] + [BENCH + n for n in BENCHMARKS] + [TRUTH.words]


@pytest.mark.parametrize("name", NAMES)
def test_help_is_in_plain_words(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    text = help_of(name)
    for jargon in ("None", "{}", "(default: )", "(default: True)", "(default: False)"):
        assert jargon not in text, text
    for line in text.splitlines():
        described = re.match(r"│ (?:-\S+|[A-Z\[]+)(?: [^ ]+)*? {2,}(\S.*?) *│$", line)
        if described and not described[1].startswith(("show this help",)):
            assert described[1][0].isupper() or not described[1][0].isalpha(), line


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_what_is_given_by_its_place_is_called_by_its_name(command: Command):
    usage = help_of(command.name).splitlines()[0]
    assert not re.search(r"(?<!-)\b(PATH|STR)\b(?<! PATH\])", plain(usage)), usage


def plain(usage: str) -> str:
    """A usage without its options."""
    return re.sub(r"\[?--[a-z-]+( [^\]\s]+)*\]?", "", usage)


@cache
def known_options() -> set[str]:
    """Options that some program takes."""
    return set.union(FOREIGN, *(options_of(name) for name in NAMES))


def unknown_options(path: Path) -> set[str]:
    """Options that a file names and that no program takes."""
    return set(OPTION.findall(path.read_text(encoding="utf-8"))) - known_options()


GONE = {"--ladder", "--learn", "--scheduler", "--tls-ca", "--tls-cert", "--tls-key"}
"""Options of earlier versions, which the list of changes may name."""


@pytest.mark.parametrize("path", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_every_option_that_a_page_names_exists(path):
    """And is an option of the command before it."""
    gone = GONE if path.name == "CHANGELOG.md" else set()
    assert unknown_options(path) <= gone
    programs = r"pinav [a-z]+|python -m benchmarks [a-z-]+|python -m validation\.truth"
    text = path.read_text(encoding="utf-8")
    for name, words in re.findall(rf"`({programs})([^`]*)`", text):
        name = name.removeprefix("pinav ")
        if name in NAMES:
            assert set(OPTION.findall(words)) <= options_of(name), (name, words)


def test_every_option_that_a_message_or_an_example_names_exists():
    unknown = {path: unknown_options(path) for path in SOURCES}
    assert not {path: words for path, words in unknown.items() if words}
