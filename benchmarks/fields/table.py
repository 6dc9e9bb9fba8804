"""Runs the cells of the benchmark, prints their table and draws one figure."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from benchmarks._sweep import measurements
from benchmarks.fields.cells import (
    COLUMNS,
    DEFAULT_COLUMNS,
    REGIONS,
    Measurement,
    cell_of,
)
from benchmarks.fields.families import FAMILIES, INSIDE
from pinav.commands.parsing import parse
from pinav.commands.settings import Settings, WorkerSettings
from pinav.errors import InputError
from pinav.figures.images import save_figure
from pinav.figures.style import label_axes, new_figure, prepare_axes
from pinav.sweeps import Cell


class Options(Settings, frozen=True):
    """Fit fields of many families, from positions, and compare with their truth.

    Every finished cell (family, key, column) is kept in --out and is not run again.
    """

    out: Annotated[Path, tyro.conf.arg(help="Folder of the results.")] = Path(
        "runs/bench-fields"
    )
    half: Annotated[
        Literal["development", "judged"],
        tyro.conf.arg(help="Even keys, on which methods are tried, or odd ones."),
    ] = "development"
    draws: Annotated[int, tyro.conf.arg(help="Draws of each family.")] = 10
    keys: Annotated[
        tuple[int, ...],
        tyro.conf.arg(help="Keys of the draws; those of --half and --draws if none."),
    ] = ()
    families: Annotated[
        tuple[str, ...], tyro.conf.arg(help="Any of: " + ", ".join(FAMILIES) + ".")
    ] = INSIDE
    columns: Annotated[
        tuple[str, ...], tyro.conf.arg(help="Any of: " + ", ".join(COLUMNS) + ".")
    ] = DEFAULT_COLUMNS
    count: Annotated[int, tyro.conf.arg(help="Trajectories of each draw.")] = 16
    workers: WorkerSettings = WorkerSettings()

    def check_together(self) -> None:
        for option, known in (("columns", COLUMNS), ("families", FAMILIES)):
            for name in getattr(self, option):
                if name not in known:
                    raise InputError(
                        f"--{option}: {name!r} is unknown; choose some of: "
                        + ", ".join(known)
                    )
        if self.draws < 1 or self.count < 1:
            raise InputError("--draws and --count: expected one or more")
        for key in self.keys:
            if key < 0:
                raise InputError(f"--keys: expected 0 or more, got {key}")


def main(argv: Sequence[str]) -> None:
    options = parse(Options, argv, prog="python -m benchmarks fields")
    if options is None:
        return
    options.check()
    several = measurements(cells(options), Measurement, options, "fields")
    print("\n".join(map(line, several)))
    print("\n" + summary(several))
    draw(several, options.out)


def cells(options: Options) -> list[Cell]:
    """The cells that the options ask for, family by family."""
    first = 0 if options.half == "development" else 1
    return [
        cell_of(family, key, column, options.count)
        for family in options.families
        for key in options.keys or range(first, 2 * options.draws, 2)
        for column in options.columns
    ]


def line(one: Measurement) -> str:
    """One measurement for a terminal."""
    errors = " ".join(_percent(one.error.get(region)) for region in REGIONS)
    bands = " ".join(_percent(one.coverage.get(region)) for region in REGIONS)
    named = ", ".join(one.structure) or "-"
    if one.verdict:
        named += f": {' + '.join(one.laws) or one.verdict}"
    gain = "" if one.gain is None else f" ({one.gain:.0f} nats)"
    name = f"{one.family:<18}{one.key:>3} {one.column:<11}"
    return f"{name}{errors} |{bands} {one.seconds:>6.1f} s {one.outcome} {named}{gain}"


def summary(measurements: Sequence[Measurement]) -> str:
    """Medians and the worst of each family and column."""
    lines = [
        f"{'family':<18}{'column':<12}{'draws':>5}  error: visited, near, elsewhere; "
        "worst visited; coverage of each; time; named rightly"
    ]
    pairs = dict.fromkeys((one.family, one.column) for one in measurements)
    for family, column in pairs:
        group = [m for m in measurements if (m.family, m.column) == (family, column)]
        errors = [_percent(_median(group, "error", region)) for region in REGIONS]
        worst = max((m.error.get("visited") or np.nan for m in group), default=np.nan)
        bands = [_percent(_median(group, "coverage", region)) for region in REGIONS]
        seconds = float(np.median([m.seconds for m in group]))
        right = sum(map(COUNTS[column], group)) if column in COUNTS else 0
        lines.append(
            f"{family:<18}{column:<12}{len(group):>5} {' '.join(errors)};"
            f"{_percent(float(worst))}; {' '.join(bands)}; {seconds:>6.1f} s"
            + (f"; {right} of {len(group)}" if column in COUNTS else "")
        )
    return "\n".join(lines)


def _is_named_rightly(one: Measurement) -> bool:
    return one.is_named_rightly


COUNTS: dict[str, Callable[[Measurement], bool]] = {
    "structured": _is_named_rightly,
    "network": _is_named_rightly,
    "ude": _is_named_rightly,
    "neural-potential": _is_named_rightly,
    "discover": lambda one: one.has_right_laws,
}
"""What counts as named rightly, by column: the structure, or its laws."""


def draw(measurements: Sequence[Measurement], folder: Path) -> None:
    """Median errors of each family on visited ground, one mark for each column."""
    families = list(dict.fromkeys(one.family for one in measurements))
    figure = new_figure(6.5, 0.8 + 0.25 * len(families))
    ax = prepare_axes(figure.add_subplot())
    for column in dict.fromkeys(one.column for one in measurements):
        values = [
            _median(
                [m for m in measurements if (m.family, m.column) == (family, column)],
                "error",
                "visited",
            )
            for family in families
        ]
        ax.plot(
            [100 * v if v else np.nan for v in values],
            families,
            "o",
            ms=4,
            label=column,
        )
    ax.set_xscale("log")
    ax.legend(fontsize=7)
    label_axes(ax, "median error of the force on visited ground [%]", "")
    save_figure(figure, folder, "fields")


def _median(group: Sequence[Measurement], field: str, region: str) -> float | None:
    values = [getattr(one, field).get(region) for one in group]
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _percent(value: float | None) -> str:
    return f"{'-':>7}" if value is None or np.isnan(value) else f"{100 * value:>6.1f}%"
