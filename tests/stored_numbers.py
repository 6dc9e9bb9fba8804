"""Numbers and texts of results, compared with summaries that are kept in tests/numbers.

What a command wrote and printed once, it must write and print again. A number that
ought to change is written anew, and the difference of the files shows what moved:

    python -m tests.stored_numbers [words of pytest, such as -k kernel]

A summary holds single numbers by the place where they stand. Of an array it holds the
shape, how many elements are finite, their mean, their root mean square and one
projection on fixed random weights, which sees exchanged axes and wrong signs. Numbers
in texts are compared to the digits that are printed.
"""

import dataclasses
import enum
import html
import json
import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from validation.same_numbers import (
    CLOCK,
    NUMBER,
    READERS,
    Numbers,
    numbers_of,
)

FOLDER = Path(__file__).parent / "numbers"
MODULES = ("tests/test_same_numbers.py", "tests/commands/test_every_command.py")

TOLERANCE = 3e-3
"""Relative difference up to which two numbers of a result are the same.

Without the flags of tests/conftest.py, with two threads, or with the instructions of
SSE4 alone, numbers of converged fits move by 1e-4 at most, most by less than 1e-6;
between two kinds of processors an error of a force against its truth moved by 1e-3.
"""

CLOSED = 1e-4
"""The same, of a small computation: they move by 1e-5 at most."""

LOOSE = {"analyse": 0.02}
"""Results that move more: influences are differences of what is nearly equal."""

NOTHING = 1e-9
"""Numbers up to this size are zeros."""

READ = {*READERS, ".npz", ".html", ".txt"}
"""Kinds of files that are compared."""

UNTOLD = re.compile(
    r"\.array$|:\.format$|\.csv:.*\.\d+$|(^|/)track-\d+\.json:|tracks\[\d+\]\.rows"
    r"|\.screened\[|\.computing\.|\.contradictions\["
)
"""Numbers that tell nothing new.

The shapes of arrays that are looked at themselves, numbers among the words of a table,
the tracks of an identification one by one; and the criterion of laws that do not fit.
"""

UNSTEADY = re.compile(
    r"\d[\d.]* × 10⁻¹[⁰¹²³⁴⁵⁶⁷⁸⁹]|\d[\d.]* ms, the first one \d[\d.]* s"
)
"""Numbers in texts that are zeros but for rounding, or that the machine decides."""

EMBEDDED = re.compile(r'(?s)<script type="application/json"[^>]*>(.*?)</script>')
"""Numbers that a page brings for its own scripts."""

WORD = re.compile(r"[a-z]{3}")
"""What a line of a page holds that is more than a number of a table."""

SECONDS = "fit (s)"
"""Heading of a column that the machine decides."""

LISTED = 10
"""Differences that a failure lists."""


class Summary(NamedTuple):
    """What is kept of a result.

    Attributes:
        numbers: a single number, or the list that stands for an array, by its path.
        lines: of texts.
    """

    numbers: dict[str, Any]
    lines: list[str]


def summarise(numbers: Numbers, text: str = "") -> Summary:
    """The summary of numbers and of what is printed with them."""
    kept = {**numbers.scalars, **{p: _moments(a) for p, a in numbers.arrays.items()}}
    kept = {path: kept[path] for path in sorted(kept) if not UNTOLD.search(path)}
    text = UNSTEADY.sub("0", text)
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    return Summary(_rounded(kept), lines)


def _moments(array: np.ndarray) -> list:
    finite = np.isfinite(array)
    values = np.where(finite, array, 0.0).ravel()
    weights = np.random.default_rng(0).uniform(-1, 1, values.size)
    count = max(int(finite.sum()), 1)
    size = math.sqrt(values @ values / count)
    projection = weights @ values / math.sqrt(count)
    return [
        list(array.shape),
        int(finite.sum()),
        values.sum() / count,
        size,
        projection,
    ]


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_rounded(part) for part in value]
    return value if isinstance(value, int) else float(f"{value:.9g}")


def numbers_in(value: Any, path: str = "") -> Numbers:
    """All numbers of a value: of arrays, and of structures that hold them."""
    found = Numbers({}, {})
    for name, leaf in _leaves(value, path):
        array = np.asarray(leaf)
        if array.size == 1:
            found.scalars[name] = float(array.ravel()[0])
        else:
            found.arrays[name] = array.astype(float)
    return found


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    parts: dict[str, Any] = {}
    if isinstance(value, dict):
        parts = {f".{key}": part for key, part in value.items()}
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        parts = {f".{key}": getattr(value, key) for key in value._fields}
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        parts = {f".{name}": getattr(value, name) for name in names}
    elif isinstance(value, list | tuple):
        parts = {f"[{index}]": part for index, part in enumerate(value)}
    elif not isinstance(value, str | enum.Enum) and value is not None:
        array = np.asarray(value) if not callable(value) else np.array("")
        if array.dtype.kind in "biuf" and array.size and not CLOCK.search(path):
            yield path, array
    for name, part in parts.items():
        yield from _leaves(part, path + name)


def contents(folders: Iterable[Path]) -> dict[Path, bytes]:
    """What all files of some folders hold, pictures left out."""
    files = [file for folder in folders for file in folder.rglob("*")]
    return {f: f.read_bytes() for f in files if f.is_file() and f.suffix in READ}


def result_of(
    files: Iterable[Path], folders: Sequence[Path], printed: str = ""
) -> Summary:
    """The summary of numbers and texts in the files of a run, and of what was printed.

    Args:
        files: that the command wrote.
        folders: of the files, whose names may stand in texts and differ each time.
        printed: by the command.
    """
    numbers = Numbers({}, {})
    texts = []
    for file in sorted(files):
        place = next(file.relative_to(f).parent for f in folders if f in file.parents)
        for kept, found in zip(numbers, numbers_of(file), strict=True):
            kept.update({str(place / path): value for path, value in found.items()})
        if file.suffix == ".txt":
            texts.append(file.read_text(encoding="utf-8"))
        if file.suffix == ".html":
            page = file.read_text(encoding="utf-8")
            texts.append(page_text(page))
            for embedded in EMBEDDED.findall(page):
                found = numbers_in(json.loads(embedded), f"{file.name}:")
                numbers.scalars.update(found.scalars)
                numbers.arrays.update(found.arrays)
    text = without_seconds("\n".join([*texts, printed]))
    for folder in folders:
        text = text.replace(str(folder), "FOLDER")
    return summarise(numbers, text)


def page_text(page: str) -> str:
    """The sentences of a page, up to its configuration and the versions."""
    page = re.sub(r"(?s)<(script|style|svg)\b.*?</\1>", "", page)
    text = html.unescape(re.sub(r"</?(b|i|em|strong|code|a|span)\b[^>]*>", "", page))
    lines = re.sub(r"\s*<[^>]*>\s*", "\n", text).rpartition("\nConfiguration\n")[0]
    return "\n".join(line for line in lines.splitlines() if WORD.search(line))


def without_seconds(text: str) -> str:
    """A text without the last column of tables where it tells how long a fit took."""
    end, lines = None, []
    for line in text.splitlines():
        if line.endswith(SECONDS):
            end = len(line.removesuffix(SECONDS).rstrip())
        elif not line or line.startswith("("):
            end = None
        lines.append(line[:end])
    return "\n".join(lines)


def differences(stored: Summary, found: Summary, tolerance: float) -> Iterator[str]:
    """What differs, one line each: where, the old number and the new one."""
    for path in sorted({*stored.numbers, *found.numbers}):
        old, new = stored.numbers.get(path), found.numbers.get(path)
        if old is None or new is None or not _same(old, new, tolerance):
            yield f"{path}: {old} -> {new}"
    for index in range(max(len(stored.lines), len(found.lines))):
        old, new = (
            s.lines[index] if index < len(s.lines) else "" for s in (stored, found)
        )
        if not _same_line(old, new, tolerance):
            yield f"line {index}: {old!r} -> {new!r}"


def _same(old: Any, new: Any, tolerance: float) -> bool:
    if isinstance(old, list) != isinstance(new, list):
        return False
    if not isinstance(old, list):
        return old == new or _close(old, new, tolerance * abs(old))
    shape, count, mean, size, projection = old
    return [shape, count] == new[:2] and all(
        _close(a, b, tolerance * size)
        for a, b in zip((mean, size, projection), new[2:], strict=True)
    )


def _close(old: float, new: float, room: float) -> bool:
    return abs(old - new) <= room + NOTHING or (math.isnan(old) and math.isnan(new))


def _same_line(old: str, new: str, tolerance: float) -> bool:
    if NUMBER.sub("#", old) != NUMBER.sub("#", new):
        return False
    pairs = zip(NUMBER.findall(old), NUMBER.findall(new), strict=True)
    return all(_same_word(a, b, tolerance) for a, b in pairs)


def _same_word(old: str, new: str, tolerance: float) -> bool:
    """Whether two printed numbers are one, but for the rounding of the last digit."""
    if old == new:
        return True
    digits, _, power = old.lower().partition("e")
    last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
    a, b = (float(word.replace("−", "-")) for word in (old, new))
    return "." in old and abs(a - b) <= 1.01 * last + tolerance * abs(a)


@dataclasses.dataclass(frozen=True)
class StoredNumbers:
    """The comparison with what is kept, or the writing of it.

    Attributes:
        renew: write what is found in place of comparing it.
    """

    renew: bool

    def check(self, name: str, found: Summary, tolerance: float = TOLERANCE) -> None:
        """Compare a summary with the one that is kept under a name."""
        file = FOLDER / f"{name}.json"
        if self.renew:
            file.parent.mkdir(exist_ok=True)
            file.write_text(_document(found))
            return
        stored = Summary(**json.loads(file.read_text()))
        lines = list(differences(stored, found, LOOSE.get(name, tolerance)))
        if lines:
            more = [f"and {len(lines) - LISTED} more"] * (len(lines) > LISTED)
            pytest.fail("\n".join([f"{name}:", *lines[:LISTED], *more]), pytrace=False)


def _document(summary: Summary) -> str:
    """JSON with one line for each number and each line of text."""
    numbers = [f"{json.dumps(k)}: {json.dumps(v)}" for k, v in summary.numbers.items()]
    lines = [json.dumps(line, ensure_ascii=False) for line in summary.lines]
    parts = '{"numbers": {\n', ",\n".join(numbers), '\n}, "lines": [\n'
    return "".join([*parts, ",\n".join(lines), "\n]}\n"])


if __name__ == "__main__":
    sys.exit(pytest.main([*MODULES, "--renew", *sys.argv[1:]]))
