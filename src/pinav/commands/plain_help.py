"""Help in plain words: what an argument is, and a default only where there is one."""

import dataclasses
import typing
from typing import Annotated, Any

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
from pinav.reading import Pairs


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
