"""Words of the command line and TOML files become options: strict structs."""

import contextlib
import io
import itertools
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import tyro

from pinav.commands.plain_help import plain_help
from pinav.errors import InputError

Options = TypeVar("Options", bound=msgspec.Struct)


def parse(options: type[Options], argv: Sequence[str], prog: str) -> Options | None:
    """Options from words; None where help was asked for and printed.

    Raises:
        InputError: tyro refuses the words; its boxed message becomes one line.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                options,
                args=list(argv),
                prog=prog,
                **_defaults(options, argv),
                config=(
                    tyro.conf.OmitArgPrefixes,
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.DisallowNone,
                ),
                registry=plain_help(),
            )
    except SystemExit as stop:
        if not stop.code:
            return None
        raise InputError(
            f"{_one_line(complaint.getvalue())}; see {prog} --help"
        ) from stop


def _one_line(box: str) -> str:
    """A boxed message without its title, its rules, its frame and its last advice."""
    lines = (line.strip("│╭╮╰╯├┤─ ") for line in box.splitlines()[1:])
    message = " ".join(line for line in lines if line)
    return message.partition("For full helptext")[0].strip().rstrip(".")


def _defaults(options: type[Options], argv: Sequence[str]) -> dict[str, Any]:
    """Keyword `default` of tyro: the settings of `--config`, where it is given.

    Raises:
        InputError: the file is missing, not TOML, or holds an unknown setting.
    """
    path = _config_path(argv)
    fields = {field.name: field for field in msgspec.structs.fields(options)}
    if path is None or "config" not in fields:
        return {}
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        content.pop(RUN_TABLE, None)
        from_file = _group(content, fields)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"--config {path}: cannot be read: {error}") from error
    except msgspec.ValidationError as error:
        raise InputError(f"--config {path}: {error}") from error
    required = {n: tyro.MISSING for n, field in fields.items() if field.required}
    return {"default": options(**required, **from_file)}


def _group(content: dict[str, Any], fields: dict[str, Any]) -> dict[str, Any]:
    """Each group of settings from those entries of a file that are its own.

    Raises:
        msgspec.ValidationError: an entry has the wrong type, or no group knows it.
    """
    groups = {
        name: field.type
        for name, field in fields.items()
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct)
    }
    names = {name: set(kind.__struct_fields__) for name, kind in groups.items()}
    known = set.union(*names.values())
    return {
        name: msgspec.convert(
            {
                key: value
                for key, value in content.items()
                if key in names[name] or (name == "settings" and key not in known)
            },
            kind,
        )
        for name, kind in groups.items()
    }


def _config_path(argv: Sequence[str]) -> Path | None:
    for word, following in itertools.pairwise([*argv, ""]):
        if word == "--config" and following:
            return Path(following)
        if word.startswith("--config="):
            return Path(word.removeprefix("--config="))
    return None


RUN_TABLE = "run"
"""Table of a run's config.toml beside its settings; such a file is welcome too."""
