"""Runs the cells of the benchmark and prints their table."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from benchmarks._sweep import measurements
from benchmarks.trainer.cells import (
    COLUMNS,
    FAILED,
    SEEDLESS,
    Measurement,
    cell_of,
)
from benchmarks.trainer.systems import DEVELOPMENT, JUDGED
from pinav.commands.parsing import parse
from pinav.commands.settings import Settings, WorkerSettings
from pinav.errors import InputError
from pinav.sweeps import Cell

USUAL = tuple(name for name, column in COLUMNS.items() if column.cause is None)
"""Columns of fits that should succeed."""


class Options(Settings, frozen=True):
    """Fit sixty systems that are drawn by key, by the default recipe and the paper's.

    Every finished cell (system, column, seed) is kept in --out and is not run again.
    """

    out: Annotated[Path, tyro.conf.arg(help="Folder of the results.")] = Path(
        "runs/bench-trainer"
    )
    half: Annotated[
        Literal["development", "judged"],
        tyro.conf.arg(help="Even keys, to try recipes on, or odd ones from 61."),
    ] = "development"
    keys: Annotated[
        tuple[int, ...],
        tyro.conf.arg(
            help="Keys of systems; those of --half if none. Odd ones below 60 "
            "were judged with earlier recipes."
        ),
    ] = ()
    columns: Annotated[
        tuple[str, ...], tyro.conf.arg(help="Any of: " + ", ".join(COLUMNS) + ".")
    ] = USUAL
    seeds: Annotated[tuple[int, ...], tyro.conf.arg(help="Seeds of networks.")] = (0,)
    workers: WorkerSettings = WorkerSettings()

    def check_together(self) -> None:
        for name in self.columns:
            if name not in COLUMNS:
                known = ", ".join(COLUMNS)
                raise InputError(
                    f"--columns: {name!r} is unknown; choose some of: {known}"
                )
        for key in self.keys:
            if key < 0:
                raise InputError(f"--keys: expected 0 or more, got {key}")
        if not self.seeds:
            raise InputError("--seeds: expected one or more")


def main(argv: Sequence[str]) -> None:
    options = parse(Options, argv, prog="python -m benchmarks trainer")
    if options is None:
        return
    options.check()
    several = measurements(cells(options), Measurement, options, "trainer")
    print("\n".join(map(line, several)))
    print("\n" + summary(several))


def cells(options: Options) -> list[Cell]:
    """The cells that the options ask for, system by system."""
    half = DEVELOPMENT if options.half == "development" else JUDGED
    return [
        cell_of(key, column, seed)
        for key in options.keys or half
        for column in options.columns
        for seed in (options.seeds[:1] if column in SEEDLESS else options.seeds)
    ]


def line(one: Measurement) -> str:
    """One measurement for a terminal."""
    name = f"{one.key:>3} {one.encounter:<6}{one.form:<9}{one.width:>5.2f}"
    fit = f"{one.column:<13}{one.seed:>3}{one.rmse:>10.1e}{one.seconds:>7.1f} s"
    fit += f"{one.processor_seconds:>7.1f} s"
    if one.samples is not None and one.near is not None:
        fit += f"  force {one.samples:.1e} {one.near:.1e}"
    return f"{name}  {fit}  {one.outcome} {one.cause}".rstrip()


def summary(measurements: Sequence[Measurement]) -> str:
    """Quantiles of the errors and times of each column, median errors of the force."""
    errors, times = ("median", "90 %", "95 %", "worst"), ("time", "worst time")
    head = ("column", "fits", *errors, *times, "processor", "force", "near")
    lines = [f"{head[0]:<13}" + "".join(f"{word:>11}" for word in head[1:])]
    for column in dict.fromkeys(one.column for one in measurements):
        chosen = [one for one in measurements if one.column == column]
        errors = np.quantile([one.rmse for one in chosen], (0.5, 0.9, 0.95, 1.0))
        times = np.quantile([one.seconds for one in chosen], (0.5, 1.0))
        cells = [f"{len(chosen):>11}", *(f"{error:>11.1e}" for error in errors)]
        spent = float(np.median([one.processor_seconds for one in chosen]))
        cells += [f"{seconds:>9.1f} s" for seconds in (*times, spent)]
        for force in ("samples", "near"):
            known = [e for one in chosen if (e := getattr(one, force)) is not None]
            cells += [f"{np.median(known):>11.1e}" if known else f"{'-':>11}"]
        lines.append(f"{column:<13}" + "".join(cells))
        lines += _causes(column, chosen)
    return "\n".join(lines)


def _causes(column: str, measurements: Sequence[Measurement]) -> list[str]:
    """How many fits failed, and how many of these named the cause that is true."""
    cause = COLUMNS[column].cause
    failed = [one for one in measurements if one.rmse > FAILED]
    if cause is None or not failed:
        return []
    told = sum(one.cause == cause.name.lower() for one in failed)
    word = cause.name.lower().replace("_", " ")
    return [f"  {len(failed)} above {FAILED:g}; {told} of these name it: {word}"]
