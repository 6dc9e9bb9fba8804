"""Measurements of all contestants and seeds to rows, text and files."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.fit.contestants import BY_NAME, OURS, Contestant


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """What the process of a contestant says.

    Attributes:
        iterations: steps taken.
        fit_seconds: wall time of the fit [s].
        full_seconds: that of the whole recipe [s], where it was cut short.
        peak_mib: peak resident memory [MiB].
        note: what a reader should know.
    """

    iterations: int
    fit_seconds: float
    full_seconds: float | None
    peak_mib: float
    note: str


class Measurement(Measured, frozen=True, kw_only=True):
    """What is known of one contestant and seed.

    Attributes:
        seed: of the network or of the noise.
        cold_seconds: wall time of the process [s].
        rmse: of all states; none before it is scored.
        force: relative error on visited ground; none before it is scored.
    """

    seed: int
    cold_seconds: float
    rmse: float | None = None
    force: float | None = None


class Spread(NamedTuple):
    """Median over the seeds, best and worst."""

    median: float
    best: float
    worst: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        return cls(float(np.median(values)), min(values), max(values))

    def text(self, form: str) -> str:
        """The median; best and worst in brackets where they differ."""
        median, best, worst = (format(value, form) for value in self)
        return median if best == worst else f"{median} ({best} to {worst})"


class Row(NamedTuple):
    """One contestant, over its seeds.

    Attributes:
        contestant: who.
        rmse: total RMSE of what was run.
        force: relative error of the force on visited ground.
        iterations: steps taken.
        fit_seconds: wall time of the fit [s], compilation included.
        cold_seconds: wall time of the whole process [s].
        peak_mib: peak resident memory [MiB].
        extrapolated: whether the times are partly those of steps that were not run.
        notes: what a reader should know.
    """

    contestant: Contestant
    rmse: Spread
    force: Spread
    iterations: Spread
    fit_seconds: Spread
    cold_seconds: Spread
    peak_mib: Spread
    extrapolated: bool
    notes: tuple[str, ...]


def row(contestant: Contestant, measurements: Sequence[Measurement]) -> Row:
    """The row of a contestant from one measurement a seed."""

    def over_seeds(value) -> Spread:
        return Spread.of([value(m) for m in measurements])

    return Row(
        contestant,
        rmse=over_seeds(lambda m: m.rmse),
        force=over_seeds(lambda m: m.force),
        iterations=over_seeds(lambda m: m.iterations),
        fit_seconds=over_seeds(full_fit_seconds),
        cold_seconds=over_seeds(full_cold_seconds),
        peak_mib=over_seeds(lambda m: m.peak_mib),
        extrapolated=any(m.full_seconds is not None for m in measurements),
        notes=tuple(dict.fromkeys(m.note for m in measurements if m.note)),
    )


def full_fit_seconds(measurement: Measurement) -> float:
    """Wall time of the fit [s]; extrapolated where the recipe was cut short."""
    full = measurement.full_seconds
    return measurement.fit_seconds if full is None else full


def full_cold_seconds(measurement: Measurement) -> float:
    """Wall time of the process [s]; extrapolated where the recipe was cut short."""
    outside = measurement.cold_seconds - measurement.fit_seconds
    return outside + full_fit_seconds(measurement)


class Ratios(NamedTuple):
    """A row divided by another: how often its error and its time."""

    error: float
    time: float


def ratios(row: Row, ours: Row) -> Ratios:
    """Medians of a row over those of ours.

    The error is the RMSE on `paper`, and that of the force where data are noisy.
    """
    paper = row.contestant.scenario == "paper"
    errors = [r.rmse.median if paper else r.force.median for r in (row, ours)]
    return Ratios(
        errors[0] / errors[1], row.cold_seconds.median / ours.cold_seconds.median
    )


HEADER = (
    "recipe",
    "total RMSE",
    "force error, visited %",
    "iterations",
    "fit s",
    "cold process s",
    "peak MiB",
    "error / ours",
    "time / ours",
)


def cells(row: Row, ours: Row | None) -> list[str]:
    """What the table prints; `~` marks times that are extrapolated."""
    mark = "~" if row.extrapolated else ""
    percent = Spread(*(100 * value for value in row.force))
    compared = ["", ""]
    if ours is not None:
        error, time = ratios(row, ours)
        compared = [f"{error:.3g}", f"{mark}{time:.2g}"]
    return [
        row.contestant.label,
        row.rmse.text(".1e"),
        percent.text(".2g"),
        f"{row.iterations.median:.0f}",
        mark + row.fit_seconds.text(".1f"),
        mark + row.cold_seconds.text(".1f"),
        f"{row.peak_mib.median:.0f}",
        *compared,
    ]


def text(rows: Sequence[Row], absent: Mapping[str, str]) -> str:
    """The table, a block for each scenario, and the notes under it.

    Args:
        rows: contestants with results.
        absent: why the others have none, by name.
    """
    names = list(dict.fromkeys(c.scenario for c in BY_NAME.values()))
    return "\n\n".join(filter(None, (_block(name, rows, absent) for name in names)))


def _block(scenario, rows, absent) -> str:
    chosen = {r.contestant.name: r for r in rows if r.contestant.scenario == scenario}
    ours = chosen.get(OURS[scenario])
    grid: list[list[str]] = [list(HEADER)]
    reasons: list[str] = []
    for name, contestant in BY_NAME.items():
        if name in chosen:
            grid.append(cells(chosen[name], ours))
            reasons += [f"  {contestant.label}: {note}" for note in chosen[name].notes]
        elif name in absent and contestant.scenario == scenario:
            grid.append([contestant.label, absent[name]])
    if len(grid) == 1:
        return ""
    marked = any(row.extrapolated for row in chosen.values())
    legend = ["  ~ extrapolated from the steps that were run"] if marked else []
    return "\n".join([f"scenario {scenario}", *aligned(grid), *legend, *reasons])


def aligned(grid: Sequence[Sequence[str]]) -> list[str]:
    """Lines with columns as wide as their widest cell; short rows keep their text."""
    full = [line for line in grid if len(line) == len(grid[0])]
    widths = [max(len(line[i]) for line in full) for i in range(len(grid[0]))]
    widths[0] = max(len(line[0]) for line in grid)
    lines = []
    for line in grid:
        shown = line[1:]
        if len(line) == len(grid[0]):
            pairs = zip(line[1:], widths[1:], strict=True)
            shown = [cell.rjust(width) for cell, width in pairs]
        lines.append("  ".join([line[0].ljust(widths[0]), *shown]).rstrip())
    return lines


class Bar(NamedTuple):
    """What ours must gain over the paper's recipe in this package."""

    name: str
    faster: float
    more_accurate: float
    stretch: str


BARS = (
    Bar("ude", 3, 40, "8, 1000"),
    Bar("ude-kernel", 6, 1000, "12, 10000"),
)


def verdicts(rows: Sequence[Row]) -> list[str]:
    """One line for each bar: what was measured, and whether that is enough."""
    by_name = {row.contestant.name: row for row in rows}
    paper = by_name.get("paper-recipe")
    lines = []
    for bar in BARS:
        if paper is None or bar.name not in by_name:
            continue
        own = by_name[bar.name]
        error, time = ratios(paper, own)
        met = time >= bar.faster and error >= bar.more_accurate
        lines.append(
            f"{own.contestant.label} against the paper's recipe: {time:.1f} times "
            f"faster, {error:.0f} times more accurate; "
            f"{'meets' if met else 'MISSES'} {bar.faster:g} and {bar.more_accurate:g} "
            f"(stretch {bar.stretch})"
        )
    return lines


def as_csv(rows: Sequence[Row]) -> str:
    """Every figure of every row, unrounded."""
    spreads = [name for name in Row._fields if name not in _PLAIN]
    parts = Spread._fields
    columns = [f"{name}_{part}" for name in spreads for part in parts]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["name", "label", "scenario", *columns, "extrapolated", "notes"])
    for r in rows:
        c = r.contestant
        numbers = [repr(v) for name in spreads for v in getattr(r, name)]
        last = [str(r.extrapolated).lower(), "; ".join(r.notes)]
        writer.writerow([c.name, c.label, c.scenario, *numbers, *last])
    return stream.getvalue()


_PLAIN = ("contestant", "extrapolated", "notes")
