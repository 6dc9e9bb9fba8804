"""The directive `command-help`: a section for each command, as its `--help` says."""

import contextlib
import io
import os
import re
from typing import Any
from unittest import mock

from docutils import nodes
from docutils.parsers.rst import Directive

from pinav.commands import COMMANDS
from pinav.commands.command import Command, resolve
from pinav.commands.dispatch import execute
from pinav.commands.parsing import tag_words


def help_of(command: Command, *words: str) -> str:
    """What `pinav COMMAND --help` prints into a file, with other words before it."""
    text = io.StringIO()
    columns = mock.patch.dict(os.environ, COLUMNS="80")
    with columns, contextlib.redirect_stdout(text):
        execute(command, [*words, "--help"])
    return text.getvalue()


def help_parts(text: str) -> tuple[str, list[str], str]:
    """Usage, paragraphs of the description, and tables of the options."""
    head, tables = re.split(r"\n (?=positional arguments|options)", text, maxsplit=1)
    usage, *paragraphs = head.strip().split("\n\n")
    lines = (line.rstrip() for line in tables.splitlines())
    return usage, [" ".join(part.split()) for part in paragraphs], "\n".join(lines)


def tagged_groups(command: Command) -> list[str]:
    """The options that belong to a choice, such as `--recipe paper`, for each one."""
    groups = []
    for option, tag in tag_words(resolve(command.options)):
        group = f"{option.removeprefix('--')} options"
        _, _, tables = help_parts(help_of(command, option, tag))
        parts = re.split(r"\n\n (?=\w+ options\n)", tables)
        (part,) = (one for one in parts if one.startswith(group))
        groups.append(f"{option} {tag}: {part.strip()}")
    return groups


class CommandHelp(Directive):
    """Sections of all commands, in the order of `pinav --help`."""

    def run(self) -> list[nodes.Node]:
        """One section for each command."""
        return [_section(command) for command in COMMANDS]


def _section(command: Command) -> nodes.section:
    usage, paragraphs, tables = help_parts(help_of(command))
    name = f"pinav {command.name}"
    section = nodes.section(ids=[f"pinav-{command.name}"], names=[name])
    section += nodes.title(name, name)
    section += [nodes.paragraph("", "", *_words(text)) for text in paragraphs]
    for text in (usage, tables.rstrip(), *tagged_groups(command)):
        section += nodes.literal_block(text, text, language="text")
    return section


def _words(text: str) -> list[nodes.Node]:
    """A sentence whose options stay as they are typed, with two hyphens."""
    parts = re.split(r"(--[a-z][a-z-]*)", text)
    return [
        nodes.literal(part, part) if part.startswith("--") else nodes.Text(part)
        for part in parts
        if part
    ]


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
