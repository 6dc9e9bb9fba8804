"""Modules as tables of a TOML file and back, by their annotations.

A table holds `kind`, the class's name in kebab case, and one key for each field. A
class may also be stated by the parameters of its classmethod `of`. Whatever concrete
class stands in a module of the packages below is known by that: no list names it. A
user's own Python file defines further ones, named `file.py:name`.
"""

import dataclasses
import difflib
import importlib
import importlib.util
import inspect
import math
import pkgutil
import sys
import traceback
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import pinav.forces
import pinav.systems
from pinav.codec import construct, kebab, members, parts_of, require_type, shorten
from pinav.errors import InputError
from pinav.forces.landscapes import NAMED
from pinav.forces.law_force import LawForce

TOML = dict[str, Any]


class Context(typing.NamedTuple):
    """Dimension of the vectors that are read, and the folder of Python files.

    Attributes:
        folder: base of relative names of Python files; None refuses to run any.
    """

    dim: int
    folder: Path | None


def kinds(family: type) -> dict[str, Callable]:
    """The concrete classes of a family that pinav defines, by their kind.

    Laws with names of their own are known by the functions that make them.
    """
    for package in (pinav.forces, pinav.systems):
        for module in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"{package.__name__}.{module.name}")
    laws = {make.__name__.replace("_", "-"): make for make in NAMED}
    return members(family) | (laws if issubclass(LawForce, family) else {})


def encode(key: str, value: Any) -> Any:
    """A value as TOML holds it; `key` names it in messages."""
    if isinstance(value, eqx.Module):
        return _encode_module(key, value)
    if isinstance(value, tuple | list):
        return [encode(f"{key}[{i}]", part) for i, part in enumerate(value)]
    if isinstance(value, bool | str | int):
        return value
    if isinstance(value, float) or hasattr(value, "__array__"):
        numbers = np.asarray(value)
        if numbers.dtype.kind in "fiu" and np.isfinite(numbers).all():
            return numbers.tolist()
        raise InputError(f"{key}: expected finite numbers, got {value}")
    raise InputError(
        f"{key}: a file cannot state a {type(value).__name__}; keep the system in "
        "Python and name it by module.py:name"
    )


def _encode_module(key: str, value: eqx.Module) -> TOML:
    cls = type(value)
    is_ours = cls.__module__.startswith("pinav.")
    kind = kebab(cls) if is_ours else python_reference(key, cls)
    fields = _friendly(value) or {
        field.name: getattr(value, field.name)
        for field in dataclasses.fields(cls)
        if not _is_default(field, getattr(value, field.name))
    }
    table = {name: encode(f"{key}.{name}", part) for name, part in fields.items()}
    return {"kind": kind, **table}


def _friendly(value: Any) -> TOML | None:
    """Parameters of `of` that give exactly this value, or none."""
    if not hasattr(type(value), "of"):
        return None
    names = inspect.signature(type(value).of).parameters
    try:
        parameters = {name: getattr(value, name) for name in names}
    except AttributeError:
        return None
    same = eqx.tree_equal(type(value).of(**parameters), value)
    return parameters if same else None


def _is_default(field: dataclasses.Field, value: Any) -> bool:
    if field.default is dataclasses.MISSING:
        return False
    return value is field.default or bool(eqx.tree_equal(value, field.default))


def decode(key: str, wanted: Any, value: Any, context: Context) -> Any:
    """A value of a file as an annotation asks for it; `key` names it in messages."""
    if wanted is Any:
        return value
    if isinstance(wanted, types.UnionType) or typing.get_origin(wanted) is typing.Union:
        options = typing.get_args(wanted)
        if float in options:  # a Scalar: a plain number, or an array without axes
            return number(key, value)
        real = next(option for option in options if option is not type(None))
        return decode(key, real, value, context)
    if typing.get_origin(wanted) is typing.Literal:
        words = typing.get_args(wanted)
        if value not in words:
            raise InputError(
                f"{key}: expected one of {', '.join(words)}; got {value!r}"
            )
        return value
    if typing.get_origin(wanted) is tuple:
        parts = parts_of(wanted, len(require_type(key, list, value)))
        if len(parts) != len(value):
            raise InputError(f"{key}: expected {len(parts)} values, got {len(value)}")
        pairs = enumerate(zip(parts, value, strict=True))
        return tuple(decode(f"{key}[{i}]", p, v, context) for i, (p, v) in pairs)
    if hasattr(wanted, "dim_str"):
        return _decode_array(key, wanted.dim_str.split(), value, context)
    if isinstance(wanted, type) and issubclass(wanted, eqx.Module):
        return decode_module(key, wanted, value, context)
    if wanted is float:
        return number(key, value)
    return require_type(key, wanted, value)


def number(key: str, value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{key}: expected a number, got {shorten(value)}")
    if not math.isfinite(value):
        raise InputError(f"{key}: expected a finite number, got {value}")
    return float(value)


def _decode_array(key: str, axes: list[str], value: Any, context: Context) -> Any:
    try:
        numbers = np.asarray(value)
    except ValueError as error:
        raise InputError(f"{key}: expected rows of equal length") from error
    if numbers.dtype.kind not in "fiu" or not np.isfinite(numbers).all():
        raise InputError(f"{key}: expected finite numbers, got {shorten(value)}")
    named = {"dim": context.dim}
    sizes = [int(a) if a.isdigit() else named.get(a) for a in axes]
    fits = axes == ["..."] or (
        len(sizes) == numbers.ndim
        and all(
            size in (None, actual)
            for size, actual in zip(sizes, numbers.shape, strict=True)
        )
    )
    if not fits:
        shape = " by ".join(
            str(s) if s else a for s, a in zip(sizes, axes, strict=True)
        )
        raise InputError(
            f"{key}: expected {shape or 'one'} numbers, as the dimension "
            f"{context.dim} asks for, got {shorten(value)}"
        )
    return jnp.asarray(numbers, float)


def decode_module(key: str, family: type, value: Any, context: Context) -> Any:
    """The module of a table."""
    if not isinstance(value, dict):
        raise InputError(
            f"{key}: expected a table with the key kind, got {shorten(value)}"
        )
    cls = _class_of(key, family, value, context)
    table = {name: part for name, part in value.items() if name != "kind"}
    make, annotations, needed = _constructor(cls, table)
    check_keys(key, table, annotations, needed)
    parts = {}
    for name, part in table.items():
        wanted, convert = annotations[name]
        place = f"{key}.{name}"
        takes_number = convert and not isinstance(part, dict | list)
        parts[name] = (
            number(place, part)
            if takes_number
            else decode(place, wanted, part, context)
        )
    return construct(key, lambda: make(**parts))


def _class_of(key: str, family: type, value: TOML, context: Context) -> Callable:
    usual = USUAL.get(family) if inspect.isabstract(family) else kebab(family)
    kind = value.get("kind", usual)
    known = kinds(family)
    if isinstance(kind, str) and ".py:" in kind:
        cls = load_name(f"{key}.kind", kind, context.folder)
        if isinstance(cls, type) and issubclass(cls, family):
            return cls
        raise InputError(f"{key}.kind: expected a {family.__name__}, got {kind!r}")
    if kind not in known:
        got = "nothing" if kind is None else repr(kind)
        raise InputError(
            f"{key}.kind: expected one of {', '.join(sorted(known))}, or "
            f"file.py:Class; got {got}{_guess(kind, known)}"
        )
    return known[kind]


USUAL: dict[type, str] = {pinav.forces.AbstractSurface: "plane"}
"""Kinds that tables of abstract families state without saying so."""


def _constructor(
    cls: Any, table: TOML
) -> tuple[Callable, dict[str, tuple[Any, bool]], list[str]]:
    """Callable for an instance: annotations with converters, and required keys."""
    if not isinstance(cls, type):
        return cls, *_parameters(cls)
    fields = [field for field in dataclasses.fields(cls) if field.init]
    names = {field.name for field in fields}
    if hasattr(cls, "of") and not set(table) <= names:
        annotations, needed = _parameters(cls.of)
        if set(table) & (set(annotations) - names):
            return cls.of, annotations, needed
    annotations = {f.name: (f.type, "converter" in f.metadata) for f in fields}
    needed = [
        f.name
        for f in fields
        if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
    ]
    return cls, annotations, needed


def _parameters(
    make: Callable,
) -> tuple[dict[str, tuple[Any, bool]], list[str]]:
    parameters = inspect.signature(make).parameters
    annotations = {name: (p.annotation, False) for name, p in parameters.items()}
    return annotations, [n for n, p in parameters.items() if p.default is p.empty]


def check_keys(
    key: str, table: TOML, known: Mapping[str, Any], needed: Iterable[str] = ()
) -> None:
    """Refuse keys that nobody reads, and miss those that are needed."""
    before = f"{key}." if key else ""
    for name in table:
        if name not in known:
            raise InputError(
                f"{before}{name}: this key is unknown; expected some of "
                f"{', '.join(known)}{_guess(name, known)}"
            )
    for name in needed:
        if name not in table:
            raise InputError(
                f"{before}{name}: this key is missing; expected the keys "
                f"{', '.join(needed)}"
            )


def _guess(name: Any, known: Any) -> str:
    close = difflib.get_close_matches(str(name), list(known), 1)
    return f"; did you mean {close[0]!r}?" if close else ""


ORIGIN = "pinav_own_"
"""Begins the names of the modules that are loaded here."""


def load_name(key: str, reference: str, folder: Path | None) -> Any:
    """The value `file.py:name`, for which the file is run; `key` is for messages.

    Args:
        folder: base of relative file names; None refuses to run the file.
    """
    if folder is None:
        raise InputError(
            f"{key}: {reference!r} names Python code, which is not run from a data "
            "file; give the system by --system"
        )
    place, _, name = reference.rpartition(":")
    module = _load((folder / Path(place).expanduser()).resolve())
    if not hasattr(module, name):
        names = [n for n in vars(module) if not n.startswith("_")]
        raise InputError(
            f"{place}: defines no {name!r}; choose one of {', '.join(names) or 'none'}"
        )
    return getattr(module, name)


def python_reference(key: str, cls: type) -> str:
    """Reference by which a file names a class of a user's own."""
    module = sys.modules.get(cls.__module__)
    if module is None or not cls.__module__.startswith(ORIGIN):
        raise InputError(
            f"{key}: {cls.__name__} of the module {cls.__module__} cannot be named "
            "in a file; put the class into a file and name the system file.py:name"
        )
    return f"{module.__file__}:{cls.__qualname__}"


def _load(path: Path) -> types.ModuleType:
    name = ORIGIN + path.as_posix().replace(".", "_")
    if name in sys.modules:
        return sys.modules[name]
    if not path.is_file():
        raise InputError(
            f"{path}: there is no such file; name a Python file as it lies"
        )
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise InputError(f"{path}: {_failure(path, error)}") from error
    return module


def _failure(path: Path, error: BaseException) -> str:
    """The error of a user's code in one line, with the line of the file."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    if isinstance(error, SyntaxError):
        lines = [error.lineno]
    where = f"line {lines[-1]}: " if lines else ""
    return f"{where}{type(error).__name__}: {' '.join(str(error).split())}; correct it"
