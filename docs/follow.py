"""The blocks of a page that can be followed, in their order, and a way to do it."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Block(NamedTuple):
    """A block of a page that a reader runs or saves.

    Attributes:
        language: `python`, `sh` or `toml`.
        text: the block as it stands.
    """

    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    """What a page asks its reader to run, or to save under a name, in order."""
    text = page.read_text(encoding="utf-8")
    code = r"^```(python|sh|toml)\n(.*?)^```"
    matches = re.findall(code, text, re.DOTALL | re.MULTILINE)
    every = [Block(*match) for match in matches]
    return [b for b in every if b.language != "toml" or file_of(b.text)]


def file_of(settings: str) -> str:
    """The name under which a page asks to save settings, in their first line."""
    first = re.match(r"# ([\w/.-]+\.toml)\n", settings)
    return first[1] if first else ""


def command_lines(text: str) -> Iterator[list[str]]:
    """The words of each command; a line may go on after a backslash."""
    for line in text.replace("\\\n", " ").strip().splitlines():
        if words := shlex.split(line, comments=True):
            yield words


def save_settings(settings: str, folder: Path) -> None:
    """Save settings under the name that they ask for."""
    path = folder / file_of(settings)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(settings, encoding="utf-8")


def follow(page: Path, folder: Path) -> None:
    """Do in a folder all that a page asks for; `make` is left out.

    Raises:
        subprocess.CalledProcessError: a command failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "examples").exists():
        (folder / "examples").symlink_to(ROOT / "examples")
    for language, text in blocks(page):
        if language == "toml":
            save_settings(text, folder)
        elif language == "python":
            run_python(["-c", text], folder)
        else:
            for words in command_lines(text):
                if words[0] == "pinav":
                    run_python(["-m", *words], folder)
                elif words[0] == "python":
                    run_python(words[1:], folder)


def run_python(arguments: list[str], folder: Path) -> None:
    """Run this Python in a folder, with the package of this checkout."""
    places = [str(ROOT / "src"), str(ROOT), os.environ.get("PYTHONPATH", "")]
    path = os.pathsep.join(place for place in places if place)
    subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        check=True,
    )
