"""Results as a document of JSON and named arrays, and back, by their annotations.

A record (a dataclass, a module of equinox, a named tuple, a struct of msgspec) becomes
an object with a key for each field. Up to `SHORT` numbers of an array stand in the
document; a longer one leaves its shape there and goes to the arrays, under the path of
its field. Where an abstract family is annotated the object says its `kind`. Properties
that a class names in `DERIVED` are written for scripts, and not read. Nothing is
pickled, no list names the classes, and reading is strict.
"""

import dataclasses
import enum
import functools
import inspect
import math
import re
import types
import typing
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import msgspec
import numpy as np
from jaxtyping import jaxtyped

from pinav.arguments import on_device
from pinav.errors import InputError

SHORT = 100
"""Numbers of an array, at most, that stand in the document."""

Json = Any
"""What JSON holds: text, numbers, truth values, null, lists and objects."""

Arrays = dict[str, np.ndarray]
"""Arrays by the path of their field, such as `split/gradient`."""


class Encoded(typing.NamedTuple):
    """A value as files hold it.

    Attributes:
        arrays: what it only mentions, by path.
    """

    document: Json
    arrays: Arrays


def kebab(cls: type) -> str:
    """The `kind` of a class: `gaussian-barrier` of `GaussianBarrier`."""
    return re.sub(
        r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "-", cls.__name__
    ).lower()


def members(family: type) -> dict[str, type]:
    """The concrete public classes of a family that pinav has imported, by kind."""
    return {
        kebab(cls): cls
        for cls in _descendants(family)
        if cls.__module__.startswith("pinav.")
        and not inspect.isabstract(cls)
        and not cls.__name__.startswith("_")
    }


def _descendants(family: type) -> Iterator[type]:
    yield family
    for child in family.__subclasses__():
        yield from _descendants(child)


def encode(value: Any) -> Encoded:
    """A value as files hold it.

    Raises:
        TypeError: it holds what has no form there, such as a function: a fault of the
            program, not of its user.
    """
    arrays: Arrays = {}
    return Encoded(_encode("", type(value), value, arrays), arrays)


def decode(wanted: Any, document: Json, arrays: Mapping[str, np.ndarray]) -> Any:
    """The value of that type which `encode` gave this form."""
    left = dict(arrays)
    value = _decode("", wanted, document, left)
    if left:
        raise InputError(f"array {min(left)}: no field has this name")
    return value


def decode_blank(wanted: Any, document: Json) -> Any:
    """The value of that type with zeros for all numbers that `encode` gave no form."""
    return decode(wanted, document, dict(_blanks("", document)))


def _blanks(path: str, document: Json) -> Iterator[tuple[str, np.ndarray]]:
    """Zeros for each array that a document only mentions, by path."""
    if isinstance(document, dict) and document.keys() == {"array"}:
        yield path, np.zeros(document["array"])
        return
    parts = enumerate(document) if isinstance(document, list) else ()
    parts = document.items() if isinstance(document, dict) else parts
    for name, part in parts:
        yield from _blanks(_join(path, name), part)


def _encode(path: str, wanted: Any, value: Any, arrays: Arrays) -> Json:
    wanted = _of_option(wanted)
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, enum.Enum):
        return _word(value)
    if isinstance(value, msgspec.Struct):
        return msgspec.to_builtins(value)
    if dataclasses.is_dataclass(value) or hasattr(value, "_fields"):
        return _encode_record(path, wanted, value, arrays)
    if isinstance(value, dict):
        _, part = typing.get_args(wanted) or (str, Any)
        return {k: _encode(_join(path, k), part, v, arrays) for k, v in value.items()}
    if isinstance(value, tuple | list):
        parts = zip(parts_of(wanted, len(value)), value, strict=True)
        return [_encode(_join(path, i), p, v, arrays) for i, (p, v) in enumerate(parts)]
    if isinstance(value, np.ndarray | jax.Array):
        array = np.asarray(value)
        return (
            _number(array.item())
            if wanted is float
            else _encode_array(path, array, arrays)
        )
    if isinstance(value, int | float | np.generic):
        return _number(value)
    raise TypeError(f"{path}: a file cannot hold a {type(value).__name__}")


def _encode_record(path: str, wanted: Any, value: Any, arrays: Arrays) -> Json:
    cls = type(value)
    content: dict[str, Json] = {}
    if cls is not wanted:
        content["kind"] = kebab(cls)
        if members(wanted).get(content["kind"]) is not cls:
            raise TypeError(f"{path}: {cls.__name__} is no {wanted} that can be read")
    defaults = _fields(cls)
    if "kind" in defaults:  # reading would take it for the name of the class
        raise TypeError(f"{path}: {cls.__name__}.kind needs another name in a file")
    for name, hint in _hints(cls).items():
        part = getattr(value, name)
        empty = isinstance(part, tuple) and not part and defaults[name] == ()
        if not empty and not (part is None and defaults[name] is None):
            content[name] = _encode(_join(path, name), hint, part, arrays)
    for name in _derived(cls):
        content[name] = _encode(_join(path, name), Any, getattr(value, name), arrays)
    return content


def _derived(cls: type) -> tuple[str, ...]:
    """The properties that are written and not read."""
    return getattr(cls, "DERIVED", ())


def _encode_array(path: str, array: np.ndarray, arrays: Arrays) -> Json:
    plain = array.dtype in (np.dtype(float), np.dtype(int), np.dtype(bool))
    if not 0 < array.size <= SHORT or not plain:
        arrays[path] = array
        return {"array": list(array.shape)}
    return _map(_number, array.tolist())


def _number(value: Any) -> Json:
    """A number; JSON has no word for those that are not finite."""
    value = value.item() if isinstance(value, np.generic) else value
    return value if math.isfinite(value) else str(value)


def _decode(path: str, wanted: Any, found: Json, left: Arrays) -> Any:
    if wanted is Any:
        return found
    if found is None and type(None) in typing.get_args(wanted):
        return None
    wanted = _of_option(wanted)
    origin, arguments = typing.get_origin(wanted), typing.get_args(wanted)
    if hasattr(wanted, "dim_str") or wanted is np.ndarray:
        return _decode_array(path, wanted, found, left)
    if origin in (tuple, list):
        found = require_type(path, list, found)
        parts = parts_of(wanted, len(found))
        if len(parts) != len(found):
            raise InputError(f"{path}: expected {len(parts)} values, got {len(found)}")
        both = enumerate(zip(parts, found, strict=True))
        return origin(_decode(_join(path, i), p, v, left) for i, (p, v) in both)
    if origin in (dict, Mapping):
        items = require_type(path, dict, found).items()
        return {k: _decode(_join(path, k), arguments[1], v, left) for k, v in items}
    if issubclass(wanted, enum.Enum):
        words = {_word(member): member for member in wanted}
        if not isinstance(found, str) or found not in words:
            raise InputError(f"{path}: expected one of {', '.join(words)}")
        return words[found]
    if issubclass(wanted, msgspec.Struct):
        return construct(path, lambda: msgspec.convert(found, wanted))
    if not issubclass(wanted, bool | int | float | str):
        return _decode_record(path, wanted, require_type(path, dict, found), left)
    if wanted is float:
        return _decode_number(path, found)
    return require_type(path, wanted, found)


def _decode_record(path: str, wanted: type, found: dict, left: Arrays) -> Any:
    cls = wanted
    if "kind" in found:
        known, kind = members(wanted), found["kind"]
        if not isinstance(kind, str) or kind not in known:
            raise InputError(f"{_join(path, 'kind')}: {kind!r} is unknown")
        cls = known[kind]
    hints, defaults = _hints(cls), _fields(cls)
    keys = found.keys() - {"kind", *_derived(cls)}
    needed = {name for name in hints if defaults[name] is inspect.Parameter.empty}
    if odd := sorted((keys - hints.keys()) | (needed - keys)):
        state = "is missing" if odd[0] in hints else "is unknown"
        raise InputError(f"{_join(path, odd[0])}: this key {state}")
    parts = {
        name: _decode(_join(path, name), hints[name], found[name], left)
        for name in hints
        if name in found
    }
    _check_shapes(path, hints, parts)
    return construct(path, lambda: cls(**parts))


def _check_shapes(
    path: str, hints: Mapping[str, Any], parts: Mapping[str, Any]
) -> None:
    """Require that the arrays of a record agree on the lengths that they name."""
    with jaxtyped("context"):
        for name, value in parts.items():
            hint = _of_option(hints[name])
            if value is None or not hasattr(hint, "dim_str"):
                continue
            if not isinstance(value, hint):
                raise InputError(
                    f"{_join(path, name)}: expected the shape ({hint.dim_str}), got "
                    f"{value.dtype} {value.shape}"
                )


def _decode_array(path: str, wanted: Any, found: Json, left: Arrays) -> Any:
    if isinstance(found, dict) and found.keys() == {"array"}:
        if path not in left:
            raise InputError(f"array {path}: is missing")
        array = left.pop(path)
        if list(array.shape) != found["array"]:
            raise InputError(f"array {path}: expected {found['array']}")
    else:
        numbers = _map(lambda one: _decode_number(path, one, whole=True), found)
        array = construct(path, lambda: np.asarray(numbers))
    if array.dtype.kind not in "fiub":
        raise InputError(f"{path}: expected numbers")
    kinds = getattr(wanted, "dtypes", ())
    if array.dtype.kind == "i" and "float64" in kinds:
        array = array.astype(float)
    return (
        on_device(array) if getattr(wanted, "array_type", None) is jax.Array else array
    )


def _decode_number(path: str, found: Json, *, whole: bool = False) -> Any:
    """A number of JSON, or the word of one that is not finite."""
    if found in ("nan", "inf", "-inf"):
        return float(found)
    if whole and isinstance(found, bool | int):
        return found
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise InputError(f"{path}: expected a number, got {shorten(found)}")
    return construct(path, lambda: float(found))


def require_type(path: str, wanted: type, found: Json) -> Any:
    """Require that a part of a document is of a type, and return it.

    Raises:
        InputError: it is of another.
    """
    if isinstance(found, wanted) and (wanted is bool or not isinstance(found, bool)):
        return found
    words = {list: "a list [...]", dict: "a table", int: "a whole number"}
    words |= {str: "text in quotes", bool: "true or false"}
    expected = words.get(wanted, wanted.__name__)
    raise InputError(f"{path}: expected {expected}, got {shorten(found)}")


def construct(path: str, make: Any) -> Any:
    """Call a constructor; its complaint becomes one line."""
    try:
        return make()
    except Exception as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from error


@functools.cache
def _hints(cls: type) -> Mapping[str, Any]:
    """The annotation of each field that the constructor takes."""
    hints = typing.get_type_hints(cls)
    return {name: hints[name] for name in _fields(cls)}


@functools.cache
def _fields(cls: type) -> Mapping[str, Any]:
    """The default of each field that the constructor takes, or `empty`."""
    parameters = inspect.signature(cls).parameters
    return {name: one.default for name, one in parameters.items()}


def _of_option(wanted: Any) -> Any:
    """The annotation without `| None`."""
    if isinstance(wanted, types.UnionType) or typing.get_origin(wanted) is typing.Union:
        real = [one for one in typing.get_args(wanted) if one is not type(None)]
        if len(real) == 1:
            return real[0]
        if float in real:  # a Scalar: a plain number, or an array without axes
            return float
        shared = [set(getattr(kind, "__mro__", ())) for kind in real]
        common = set.intersection(*shared)
        family = next((c for c in getattr(real[0], "__mro__", ()) if c in common), None)
        if not dataclasses.is_dataclass(family):
            raise TypeError(f"{wanted}: what a file holds must be of one kind or null")
        return family
    return wanted


def parts_of(wanted: Any, count: int) -> tuple[Any, ...]:
    """The annotation of each of so many items."""
    parts = typing.get_args(wanted)
    if typing.get_origin(wanted) is list or (parts and parts[-1] is Ellipsis):
        return (parts[0],) * count
    return parts or (Any,) * count


def _word(member: enum.Enum) -> str:
    return member.value if isinstance(member.value, str) else str(member)


def _map(function: Any, content: Any) -> Any:
    if isinstance(content, list):
        return [_map(function, part) for part in content]
    return function(content)


def _join(path: str, name: str | int) -> str:
    return f"{path}/{name}" if path else str(name)


def shorten(value: Any) -> str:
    """A value as messages show it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
