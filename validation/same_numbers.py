"""Whether two versions of pinav compute the same numbers.

    python -m validation.same_numbers collect BEFORE --source OLD_CHECKOUT --old
    python -m validation.same_numbers collect AFTER
    python -m validation.same_numbers compare BEFORE AFTER

`collect` runs `STEPS` by the command line of a checkout, each in a process of its own,
and keeps what the runs hold; steps that are done are not repeated. `compare` looks for
every number that the files of BEFORE hold: under the same name, else in another array
or document of the same run, to 1e-6 relative, and lists what it does not find. Seconds
do not count. Recordings come from the folder that PINAV_RECORDINGS names, or from
../shared/data beside the checkout.
"""

import argparse
import csv
import gzip
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
RECORDINGS = Path(os.environ.get("PINAV_RECORDINGS") or ROOT.parent / "shared" / "data")

TOLERANCE = 1e-6
"""Relative difference up to which two numbers are the same."""

SMALL = 1e-9
"""The same, relative to the largest number of an array: of its zeros."""

SLICED = 64
"""Slices of an array at most that are sought one by one."""

POOLED = 1000
"""Numbers of an array at most whose elements may stand for a number of a document."""

SHORT = ("--thrust", "1", "--time-limit", "8", "--step", "0.5", "--seeds", "2")
COARSE = ("--arena=0,0,10,10", "--tolerance", "0.5", "--designs", "grid")
RAW = ("--reading", "heading_offset=1.5708")

STEPS: dict[str, tuple[str, ...]] = {
    "exact": ("simulate", "barrier-crossings", "--count", "3"),
    "noisy": ("simulate", "barrier-crossings", "--count", "3", "--noise", "0.02"),
    "judge": ("simulate", "barrier-crossings", "--count", "2", "--seed", "5"),
    "one": ("simulate", "paper"),
    "thermal": ("simulate", "brownian", "--count", "3"),
    "space": ("simulate", "box", "--count", "2"),
    "reproduce": ("reproduce", "--seeds", "42", "--max-steps", "6"),
    "reproduce-paper": (
        *("reproduce", "--recipe", "paper", "--seeds", "42"),
        *("--adam-steps", "100", "--lbfgs-steps", "10"),
    ),
    "fit-exact": ("fit", "exact.npz"),
    "fit-noisy": ("fit", "noisy.npz", "--train", "damping"),
    "fit-thermal": ("fit", "thermal.npz"),
    "fit-space": ("fit", "space.npz"),
    "fit-network": (
        *("fit", "noisy.npz", "--model", "neural-potential"),
        *("--width", "8", "--structure", "free"),
    ),
    "fit-ude": ("fit", "one.npz", "--model", "ude", "--max-steps", "4"),
    "identify-cellbot": ("identify", "cellbot.csv", *RAW),
    "identify-circles": ("identify", "circles.csv", "--candidates", "all"),
    "identify-roller": ("identify", "roller.csv"),
    "identify-idle": ("identify", "idle.csv"),
    "fit-recording": (
        *("fit", "cellbot.csv", *RAW, "--structure", "free"),
        *("--system", "identify-cellbot/system.toml"),
    ),
    "evaluate": ("evaluate", "fit-noisy", "judge.npz"),
    "analyse": ("analyse", "fit-noisy", "--points", "15", "--samples", "8"),
    "discover": ("discover", "fit-noisy", "--refits", "1"),
    "compare": (
        *("compare", "noisy.npz", "--models", "physics-only", "kernel-potential"),
    ),
    "study": ("study", "noise", "--models", "physics-only", "--count", "1"),
    "design": ("design", "shear", "--from=1,5", "--to=9,5", *COARSE, *SHORT),
    "navigate": ("navigate", "fit-noisy", "--from=1,1", "--to=3,2", *SHORT),
    "navigate-online": (
        *("navigate", "--learn-online", "barrier-weak"),
        *("--seeds", "1", "--visits", "1", "--time-limit", "10"),
    ),
    "heat-learn": ("heat", "learn", "learn.toml"),
    "heat-optimise": ("heat", "optimise", "optimise.toml"),
}
"""The words of each step, in the version of today; `--out NAME` is added."""

WITHIN = {"evaluate": "fit-noisy", "analyse": "fit-noisy", "discover": "fit-noisy"}
"""Steps that add to the run of another one."""

OLD_WORDS: dict[str, tuple[str, ...]] = {
    "identify-cellbot": ("identify", "cellbot.csv", "--heading-offset", "1.5708"),
    "fit-recording": (
        *("fit", "cellbot.csv", "--heading-offset", "1.5708", "--structure", "free"),
        *("--system", "identify-cellbot/system.toml"),
    ),
    "navigate-online": (
        *("navigate", "--learn-online", "--task", "barrier-weak"),
        *("--seeds", "1", "--visits", "1", "--time-limit", "10"),
    ),
}
"""Words of steps in the version before, where they were others."""

EXTRACTS = {
    "cellbot": ("magscope_cellbot_sessions/sessions", "datasetGP__20240510", 900),
    "circles": ("magscope_roller_circles/control_circles", "", 1200),
    "roller": ("magscope_speed_vs_freq/20um_roller", "", 1500),
    "idle": ("magscope_roller_circles/idle_brownian", "", 440),
}
"""Recordings: the file, how the names of its runs begin, and rows that are read."""

LEFT_OUT = ("environment.json", "manifest.json", "config.toml")

CLOCK = re.compile(r"second|elapsed|duration|(^|[./_])wall")
"""Names of numbers that the machine decides."""

NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.]*\w)")


def collect(out: Path, source: Path, *, old: bool) -> None:
    """Run all steps that are not done yet, in a folder."""
    out.mkdir(parents=True, exist_ok=True)
    write_inputs(out)
    for name, words in STEPS.items():
        terminal = out / f"{name}.txt"
        if terminal.exists():
            continue
        words = OLD_WORDS.get(name, words) if old else words
        code, text = run_step(name, words, out, source)
        print(f"{name}: exit {code}", flush=True)
        if code:
            print(text, flush=True)
        else:
            terminal.write_text(text)


def run_step(
    name: str, words: tuple[str, ...], out: Path, source: Path
) -> tuple[int, str]:
    """Exit code and output of `pinav WORDS`, run in the folder `out`."""
    target = f"{name}.npz" if words[0] == "simulate" else name
    destination = () if name in WITHIN else ("--out", target, "--overwrite")
    path = os.pathsep.join(map(str, (source / "src", source)))
    done = subprocess.run(
        [sys.executable, "-m", "pinav", *words, *destination],
        cwd=out,
        env=os.environ | {"PYTHONPATH": path, "COLUMNS": "200"},
        text=True,
        capture_output=True,
    )
    return done.returncode, done.stdout + (done.stderr if done.returncode else "")


def write_inputs(out: Path) -> None:
    """Write short recordings, and cases of heat on coarse grids."""
    for name, (file, run, rows) in EXTRACTS.items():
        with gzip.open(RECORDINGS / f"{file}.csv.gz", "rt") as lines:
            header = next(lines)
            kept = [line for line in lines if line.startswith(run)][:rows]
        (out / f"{name}.csv").write_text(header + "".join(kept))
    for name in ("learn", "optimise"):
        text = (ROOT / "examples" / "heat" / f"{name}.toml").read_text()
        coarse = re.sub(r"cells = \d+", "cells = 30", text)
        (out / f"{name}.toml").write_text("step = 10.0\n" + coarse)


class Pieces(NamedTuple):
    """Arrays of one size and slices of arrays, one in a row.

    Attributes:
        labels: where each of them stands.
        values: their elements.
        sums: of the absolute values of each.
    """

    labels: list[str]
    values: np.ndarray
    sums: np.ndarray


class Numbers(NamedTuple):
    """Numbers of a run, by the file and the path in it where they stand.

    Attributes:
        scalars: single numbers of documents.
        arrays: columns of tables, lists of documents, arrays, leaves of models.
    """

    scalars: dict[str, float]
    arrays: dict[str, np.ndarray]

    def pool(self) -> np.ndarray:
        """All single numbers and elements of short arrays, sorted."""
        short = [a.ravel() for a in self.arrays.values() if a.size <= POOLED]
        values = np.concatenate([list(self.scalars.values()), *short, [0.0]])
        return np.unique(values[np.isfinite(values)])

    def pieces(self) -> dict[int, Pieces]:
        """Arrays, and slices of them along the first and the last axis, by size."""
        by_size: dict[int, dict[str, np.ndarray]] = {}
        for name, array in self.arrays.items():
            for label, piece in _slices(name, array):
                by_size.setdefault(piece.size, {})[label] = piece.ravel()
        made = {}
        for size, several in by_size.items():
            values = np.stack(list(several.values()))
            sums = np.nansum(np.abs(values), axis=1)
            made[size] = Pieces(list(several), values, sums)
        return made


def _slices(name: str, array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    yield name, array
    if array.ndim > 1:
        for index in range(array.shape[0]):
            yield f"{name}[{index}]", array[index]
        for index in range(array.shape[-1]):
            yield f"{name}[..., {index}]", array[..., index]


def numbers_of(run: Path) -> Numbers:
    """All numbers that the files of a run hold; of a file, its own."""
    found = Numbers({}, {})
    files = [run] if run.is_file() else sorted(run.rglob("*"))
    for file in files:
        if file.name in LEFT_OUT or file.name.startswith("checkpoint"):
            continue
        name = file.name if run.is_file() else str(file.relative_to(run))
        if file.suffix == ".npz":
            with np.load(file, allow_pickle=False) as arrays:
                for key in arrays:
                    _add(f"{name}:{key}", arrays[key], found)
        elif file.suffix in READERS:
            for key, value in READERS[file.suffix](file):
                _add(f"{name}:{key}", value, found)
    return found


def _add(path: str, value: Any, found: Numbers) -> None:
    if CLOCK.search(path):
        return
    if isinstance(value, dict):
        for key, part in value.items():
            _add(f"{path}.{key}", part, found)
        return
    if isinstance(value, list | tuple):
        array = _as_array(value)
        if array is None:
            for index, part in enumerate(value):
                _add(f"{path}[{index}]", part, found)
            return
        value = array
    if isinstance(value, np.ndarray) and value.dtype.kind in "bifu":
        if value.size == 1:
            found.scalars[path] = float(value.ravel()[0])
        else:
            found.arrays[path] = value.astype(float)
    elif (number := _as_number(value)) is not None:
        found.scalars[path] = number


def _as_array(value: list | tuple) -> np.ndarray | None:
    """A list of numbers, or of lists of them, as an array; nan and inf may be words."""
    try:
        array = np.array(value)
        array = array.astype(float) if array.dtype.kind in "bifuU" else None
    except ValueError:
        return None
    return array if array is not None and array.size else None


def _as_number(value: Any) -> float | None:
    if isinstance(value, bool | None):
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        return None


def read_document(file: Path) -> Iterator[tuple[str, Any]]:
    """The content of a JSON or TOML file, and of each line of a JSON lines file."""
    text = file.read_text()
    if file.suffix == ".toml":
        yield "", tomllib.loads(text)
    elif file.suffix == ".json":
        yield "", json.loads(text)
    else:
        yield "", [json.loads(line) for line in text.splitlines()]


def read_table(file: Path) -> Iterator[tuple[str, Any]]:
    """The columns of a table that hold nothing but numbers; other cells one by one."""
    with file.open(newline="") as lines:
        rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    if len(rows) < 2 or any(len(row) != len(rows[0]) for row in rows):
        return
    for heading, *cells in zip(*rows, strict=True):
        numbers = [_as_number(cell or "nan") for cell in cells]
        if None not in numbers:
            yield heading, np.array(numbers, float)
        else:
            yield heading, dict(zip(map(str, range(len(cells))), cells, strict=True))


def read_leaves(file: Path) -> Iterator[tuple[str, Any]]:
    """The leaves of a model, which follow a line of JSON."""
    with file.open("rb") as stream:
        stream.readline()
        index = 0
        while stream.peek(1):
            yield str(index), np.load(stream, allow_pickle=False)
            index += 1


READERS = {
    **dict.fromkeys((".json", ".toml", ".jsonl"), read_document),
    ".csv": read_table,
    ".eqx": read_leaves,
}


class Differences(NamedTuple):
    """What a run of the version before holds, and whether it is still there.

    Attributes:
        same: how many numbers and arrays stand under the same name.
        elsewhere: those that stand under another one: old name, and the new one.
        missing: lines that say what was not found.
    """

    same: list[str]
    elsewhere: list[str]
    missing: list[str]


def differences(before: Numbers, after: Numbers) -> Differences:
    """Look for all numbers of a run in another one."""
    result = Differences([], [], [])
    pool, pieces = after.pool(), after.pieces()
    for name, value in before.scalars.items():
        if _equal(value, after.scalars.get(name)):
            result.same.append(name)
        elif not np.isfinite(value) or _in_pool(value, pool).all():
            result.elsewhere.append(name)
        else:
            result.missing.append(f"{name} = {value:.9g}; {_nearest(value, pool)}")
    for name, array in before.arrays.items():
        if _equal(array, after.arrays.get(name)):
            result.same.append(name)
        elif place := _place(name, array, pieces):
            result.elsewhere.append(f"{name} -> {place}")
        elif array.size <= POOLED and _in_pool(array, pool).all():
            result.elsewhere.append(f"{name} -> single numbers")
        else:
            result.missing.append(_missing(name, array, after, pool))
    return result


def _equal(a: Any, b: Any) -> bool:
    if b is None or np.size(a) != np.size(b):
        return False
    a, b = np.ravel(a), np.ravel(b)
    scale = np.max(np.abs(a[np.isfinite(a)]), initial=0.0)
    return bool(np.allclose(b, a, rtol=TOLERANCE, atol=SMALL * scale, equal_nan=True))


def _place(name: str, array: np.ndarray, pieces: dict[int, Pieces]) -> str:
    """Where an array stands, whole, or each of its slices along an axis; else empty."""
    if same_size := pieces.get(array.size):
        total = np.nansum(np.abs(array))
        ratios = same_size.sums / total if total else np.ones(len(same_size.sums))
        likely = np.isclose(ratios[:, None], [1.0, 100.0, 0.01], rtol=1e-5).any(axis=1)
        for index in np.flatnonzero(likely):
            label, piece = same_size.labels[index], same_size.values[index]
            if _equal(array, piece):
                return label
            if _equal(np.sort(array, axis=None), np.sort(piece)):
                return f"{label}, in another order"
            if _equal(100 * array, piece) or _equal(array, 100 * piece):
                return f"{label}, in %"
    if array.ndim < 2:
        return ""
    for axis in (-1, 0):
        parts = np.moveaxis(array, axis, 0)
        if len(parts) > SLICED:
            continue
        places = [_place(name, part, pieces) for part in parts]
        if all(places):
            return ", ".join(places[:3])
    return ""


def _in_pool(values: Any, pool: np.ndarray) -> np.ndarray:
    """Whether numbers, or what they are in %, are among those of a sorted array."""
    values = np.ravel(values)
    values = values[np.isfinite(values)]
    close = np.zeros(len(values), bool)
    for factor in (1.0, 100.0, 0.01):
        wanted = factor * values
        close |= np.abs(_closest(wanted, pool) - wanted) <= TOLERANCE * np.abs(wanted)
    return close


def _closest(values: np.ndarray, pool: np.ndarray) -> np.ndarray:
    after = np.clip(np.searchsorted(pool, values), 1, max(len(pool) - 1, 1))
    low, high = pool[after - 1], pool[np.minimum(after, len(pool) - 1)]
    return np.where(np.abs(values - low) < np.abs(high - values), low, high)


def _nearest(value: float, pool: np.ndarray) -> str:
    close = _closest(np.array([value]), pool)[0]
    return f"nearest {close:.9g} ({abs(close / value - 1):.1e})"


def _missing(name: str, array: np.ndarray, after: Numbers, pool: np.ndarray) -> str:
    there = after.arrays.get(name)
    text = f"{name} {array.shape}"
    if there is None:
        known = _in_pool(array, pool)
        return f"{text}: {known.sum()} of {known.size} numbers are elsewhere"
    if there.shape != array.shape:
        return f"{text} has the shape {there.shape}"
    scale = np.nanmax(np.abs(array))
    largest = np.nanmax(np.abs(there - array))
    return f"{text} differs by {largest / scale:.1e} of {scale:.3g}"


def terminal_differences(before: str, after: str) -> list[str]:
    """Numbers that a command printed before and does not print now."""
    said = set(NUMBER.findall(after))
    return [word for word in NUMBER.findall(before) if word not in said]


def compare(before: Path, after: Path, *, verbose: bool) -> bool:
    """Print what differs between two collections; True where all was found."""
    all_found = True
    for name in STEPS:
        if not (before / f"{name}.txt").exists():
            continue
        if not (after / f"{name}.txt").exists():
            print(f"{name}: no result")
            all_found = False
            continue
        words = terminal_differences(
            *((folder / f"{name}.txt").read_text() for folder in (before, after))
        )
        print(f"{name}: {len(words)} printed numbers differ: {' '.join(words[:12])}")
        if name in WITHIN:
            continue
        run = f"{name}.npz" if STEPS[name][0] == "simulate" else name
        found = differences(numbers_of(before / run), numbers_of(after / run))
        same, elsewhere, missing = map(len, found)
        print(f"  {same} the same, {elsewhere} under another name, {missing} not found")
        for line in found.missing + (found.elsewhere if verbose else []):
            print(f"    {line}")
        all_found &= not found.missing
    return all_found


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description="Same numbers?")
    tasks = parser.add_subparsers(dest="task", required=True)
    task = tasks.add_parser("collect", help="run all steps in a folder")
    task.add_argument("out", type=Path)
    task.add_argument("--source", type=Path, default=ROOT, help="checkout to run")
    task.add_argument("--old", action="store_true", help="words of the version before")
    task = tasks.add_parser("compare", help="look for the numbers of a collection")
    task.add_argument("before", type=Path)
    task.add_argument("after", type=Path)
    task.add_argument("--verbose", action="store_true", help="list new names, too")
    options = parser.parse_args()
    if options.task == "collect":
        collect(options.out, options.source.resolve(), old=options.old)
        return 0
    return not compare(options.before, options.after, verbose=options.verbose)


if __name__ == "__main__":
    sys.exit(main())
