"""`pinav truth`: fits of recordings, judged by what is known of them."""

import functools
from collections.abc import Callable

import numpy as np

from pinav.commands.command import CommandResult
from pinav.commands.start import start_run
from pinav.commands.truth import TRUTH
from pinav.commands.truth.cases import Case, Recording, find_cases
from pinav.commands.truth.judged import Curve, Judgement
from pinav.commands.truth.metrics import TruthCase, TruthMetrics, case_table
from pinav.commands.truth.ring import judge_ring
from pinav.commands.truth.settings import TruthOptions, TruthSettings
from pinav.commands.truth.traps import judge_dragged_trap, judge_trap
from pinav.commands.truth.wall import judge_wall
from pinav.errors import FitError, InputError
from pinav.report.text import as_text
from pinav.runs import RunFolder

Judge = Callable[[Case, Recording], Judgement]


def judges(settings: TruthSettings) -> dict[str, Judge]:
    """The judge of each kind of recording."""
    return {
        "trap": judge_trap,
        "dragged trap": judge_dragged_trap,
        "ring": functools.partial(judge_ring, peer=settings.peer),
        "wall": functools.partial(judge_wall, peer=settings.peer),
    }


def judge_all(
    cases: list[Case], settings: TruthSettings, folder: RunFolder
) -> TruthMetrics:
    """Judge each case, and keep the arrays of its figures.

    Raises:
        InputError: `only` names another case.
    """
    known = {case.name for case in cases}
    for name in settings.only:
        if name not in known:
            raise InputError(
                f"--only: {name!r} is no case; expected some of "
                f"{', '.join(sorted(known))}"
            )
    results = []
    for case in cases:
        result, curves = _judge(case, settings)
        for index, curve in enumerate(curves):
            folder.write_arrays(curve_file(case.name, index), _arrays(curve))
        results.append(result)
    metrics = TruthMetrics(tuple(results))
    folder.write_metrics("truth.json", metrics)
    folder.write_metrics("metrics.json", metrics)
    return metrics


def curve_file(name: str, index: int) -> str:
    """Where the arrays of a figure are kept."""
    return f"curve-{name}-{index}.npz"


def _arrays(curve: Curve) -> dict[str, np.ndarray]:
    texts = np.array([curve.title, *curve.labels])
    fields = {n: getattr(curve, n) for n in Curve._fields[2:]}
    return {"texts": texts, **fields}


def _judge(case: Case, settings: TruthSettings) -> tuple[TruthCase, tuple[Curve, ...]]:
    kind = case.description.kind
    if settings.only and case.name not in settings.only:
        return TruthCase(case.name, kind, "skipped", "not asked for"), ()
    if not case.path.is_file():
        reason = f"no {case.description.file} in {case.folder}"
        return TruthCase(case.name, kind, "absent", reason), ()
    known = judges(settings)
    try:
        judgement = known[kind](case, case.read())
    except (FitError, InputError) as error:
        return TruthCase(case.name, kind, "failed", str(error)), ()
    rows = (judgement.rows, judgement.notes)
    return (
        TruthCase(case.name, kind, "judged", "", judgement.seconds, *rows),
        judgement.curves,
    )


def run(options: TruthOptions) -> CommandResult:
    """Judge as the command line does."""
    cases = find_cases(options.folder)
    folder = start_run(TRUTH, options, options.settings)
    metrics = judge_all(cases, options.settings, folder)
    lines = [as_text(case_table(metrics.cases))]
    bars = [row.met for case in metrics.cases for row in case.rows if row.bar]
    lines.append(f"{sum(map(bool, bars))} of {len(bars)} bars met")
    lines += [f"missed: {text}" for text in metrics.failures]
    return CommandResult(metrics, "\n".join(lines), folder)
