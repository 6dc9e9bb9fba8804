"""Words of the command line and TOML files become options: strict structs."""

import contextlib
import dataclasses
import io
import itertools
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from pinav.errors import InputError
from pinav.files import read_toml
from pinav.reading import Content, Pairs, Reading

Options = TypeVar("Options", bound=msgspec.Struct)


def parse(options: type[Options], argv: Sequence[str], prog: str) -> Options | None:
    """Options from words; None where help was asked for and printed.

    A field that may be one of several tagged structs is chosen by the option that has
    the name of their tag, such as `--recipe paper`, by the same key of `--config`, or
    by an option that one of them alone has; the others then have no options.

    Raises:
        InputError: tyro refuses the words; its boxed message becomes one line.
    """
    complaint = io.StringIO()
    content = _file_content(argv)
    words, chosen, foreign = list(argv), options, {}
    for field in msgspec.structs.fields(options):
        if members := tagged_members(field.type):
            words, member = _choose(members, words, content)
            chosen = _narrow(chosen, field.name, member)
            foreign |= _foreign(members, member)
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                chosen,
                args=words,
                prog=prog,
                **_defaults(chosen, argv, content),
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
        for word in words:
            if advice := foreign.get(word.partition("=")[0]):
                raise InputError(advice) from stop
        raise InputError(
            f"{_one_line(complaint.getvalue())}; see {prog} --help"
        ) from stop


def tagged_members(annotation: Any) -> dict[str, type[msgspec.Struct]]:
    """The structs of a union by their tags; none of another annotation."""
    members = [one for one in typing.get_args(annotation) if isinstance(one, type)]
    return {
        str(one.__struct_config__.tag): one
        for one in members
        if issubclass(one, msgspec.Struct) and one.__struct_config__.tag is not None
    }


def tag_words(options: type[msgspec.Struct]) -> list[tuple[str, str]]:
    """The words that choose among options, such as `--recipe paper`."""
    members = [
        member.__struct_config__
        for field in msgspec.structs.fields(options)
        for member in tagged_members(field.type).values()
    ]
    return [(f"--{member.tag_field}", str(member.tag)) for member in members]


Members = Mapping[str, type[msgspec.Struct]]


def _choose(
    members: Members, words: list[str], content: Content
) -> tuple[list[str], type[msgspec.Struct]]:
    """The words without the option that names a member, and that member."""
    first = next(iter(members.values()))
    key = str(first.__struct_config__.tag_field)
    option, name, rest = f"--{key}", content.get(key), []
    remaining = iter(words)
    for word in remaining:
        if word == option:
            name = next(remaining, "")
        elif word.startswith(f"{option}="):
            name = word.removeprefix(f"{option}=")
        else:
            rest.append(word)
    if name is None:
        given = {word.partition("=")[0] for word in words}
        for one in members.values():
            others = (_options_of(other) for other in members.values() if other != one)
            if given & _options_of(one).difference(*others):  # it alone has an option
                return rest, one
        return rest, first
    if name not in members:
        raise InputError(
            f"{option}: expected one of {', '.join(members)}, got {name!r}"
        )
    return rest, members[str(name)]


def _options_of(member: type[msgspec.Struct]) -> set[str]:
    return {f"--{name.replace('_', '-')}" for name in member.__struct_fields__}


def _foreign(members: Members, chosen: type[msgspec.Struct]) -> dict[str, str]:
    """The advice for each option that other members have."""
    owners: dict[str, list[str]] = {}
    for name, one in members.items():
        for option in _options_of(one) - _options_of(chosen):
            owners.setdefault(option, []).append(name)
    key = chosen.__struct_config__.tag_field
    return {
        option: f"{option}: only the {key} {' or '.join(names)} uses it; drop it or "
        f"choose --{key} {names[-1]}"
        for option, names in owners.items()
    }


def _narrow(
    options: type[Options], name: str, member: type[msgspec.Struct]
) -> type[Options]:
    """The options whose field of that name is of one class."""
    narrow: Any = msgspec.defstruct(
        options.__name__,
        [(name, member, member())],
        bases=(options,),
        frozen=True,
        kw_only=True,
    )
    narrow.__doc__ = options.__doc__
    return narrow


def _one_line(box: str) -> str:
    """A boxed message without its title, its rules, its frame and its last advice."""
    lines = (line.strip("│╭╮╰╯├┤─ ") for line in box.splitlines()[1:])
    message = " ".join(line for line in lines if line)
    for advice in ("For full helptext", "Argument helptext"):
        message = message.partition(advice)[0]
    return message.strip().rstrip(".")


def _file_content(argv: Sequence[str]) -> Content:
    """The settings of `--config`; none where it is not given."""
    path = _config_path(argv)
    if path is None:
        return {}
    content = read_toml(path, f"--config {path}")
    content.pop(RUN_TABLE, None)
    return content


def _defaults(options: type[Options], argv: Sequence[str], content: Content) -> Content:
    """Keyword `default` of tyro: the settings of `--config`, where it is given."""
    path = _config_path(argv)
    fields = {field.name: field for field in msgspec.structs.fields(options)}
    if path is None or "config" not in fields:
        return {}
    try:
        from_file = _group(content, fields)
    except msgspec.ValidationError as error:
        raise InputError(f"--config {path}: {error}") from error
    required = {n: tyro.MISSING for n, field in fields.items() if field.required}
    return {"default": options(**required, **from_file)}


def _group(content: Content, fields: Content) -> Content:
    """Each group of settings from those entries of a file that are its own."""
    reading = content.pop("reading", {}) if "reading" in fields else None
    groups = {
        name: field.type
        for name, field in fields.items()
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct)
    }
    names = {
        name: {*kind.__struct_fields__, kind.__struct_config__.tag_field}
        for name, kind in groups.items()
    }
    known = set.union(*names.values())
    stated = {} if reading is None else {"reading": Reading.of_content(reading)}
    return stated | {
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


def plain_help() -> ConstructorRegistry:
    """Rules by which tyro describes the options of pinav."""
    registry = ConstructorRegistry()
    registry.struct_rule(_PlainStruct())
    registry.primitive_rule(_pairs)
    return registry


def _pairs(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """The words of names and what they stand for, such as x=X."""
    if info.type != Pairs | None:
        return None
    return PrimitiveConstructorSpec(
        nargs="*",
        metavar="[NAME=WORD [NAME=WORD ...]]",
        instance_from_str=_pairs_of,
        is_instance=lambda value: value is None or isinstance(value, dict),
        str_from_instance=lambda value: [f"{k}={v}" for k, v in (value or {}).items()],
    )


def _pairs_of(words: list[str]) -> Pairs:
    pairs = [word.partition("=") for word in words]
    for name, sign, value in pairs:
        if not (name and value):
            word = f"{name}{sign}{value}"
            raise InputError(f"expected words such as x=X, got {word!r}")
    return {name: value for name, _, value in pairs}


class _PlainStruct:
    """tyro's own rule for a struct, with its arguments described in plain words."""

    def __init__(self) -> None:
        self.asking_tyro = False

    def __call__(self, info: StructTypeInfo) -> StructConstructorSpec | None:
        if self.asking_tyro or not _is_struct(info.type):
            return None
        self.asking_tyro = True
        try:
            spec = ConstructorRegistry.get_struct_spec(info)
        finally:
            self.asking_tyro = False
        if not isinstance(spec, StructConstructorSpec):
            return None
        fields = tuple(_describe(field) for field in spec.fields)
        return dataclasses.replace(spec, fields=fields)


def _describe(field: StructFieldSpec) -> StructFieldSpec:
    """An argument with its default in words; groups of options stay as they are."""
    if _is_struct(field.type):
        return field
    words = tyro.conf.arg(help_behavior_hint=_default_in_words, metavar=_metavar(field))
    return dataclasses.replace(field, type=Annotated[field.type, words])


def _default_in_words(default: str) -> str:
    """The default behind a description; nothing for what is simply not given."""
    if default in ("", "''", "None", "True", "False"):
        return ""
    return f"(default: {default})"


def _metavar(field: StructFieldSpec) -> str | None:
    """A word given by its place is called by its name; others by their type."""
    markers = getattr(field.type, "__metadata__", ())
    kind = field.type.__origin__ if markers else field.type
    if tyro.conf.Positional not in markers or _has_choices(kind):
        return None
    name = field.name.upper()
    if typing.get_origin(kind) is tuple:
        return f"{name} [{name} ...]"
    may_be_left_out = field.default is None or isinstance(field.default, str)
    return f"[{name}]" if may_be_left_out else name


def _has_choices(kind: Any) -> bool:
    parts = (kind, *typing.get_args(kind))
    return any(typing.get_origin(part) is typing.Literal for part in parts)


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)
