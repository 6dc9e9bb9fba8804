"""Fits of recordings, judged by what is known of them."""

import functools
from collections.abc import Callable

from validation.truth import TRUTH
from validation.truth.cases import Case, Recording, find_cases
from validation.truth.metrics import Judgement, Truth, TruthCase
from validation.truth.ring import judge_ring
from validation.truth.settings import TruthOptions, TruthSettings
from validation.truth.trap import judge_dragged_trap, judge_trap
from validation.truth.wall import judge_wall

from pinav.commands.command import CommandResult
from pinav.commands.results import keep, start_run
from pinav.errors import FitError, InputError

Judge = Callable[[Case, Recording], Judgement]


def judges(settings: TruthSettings) -> dict[str, Judge]:
    """The judge of each kind of recording."""
    return {
        "trap": judge_trap,
        "dragged trap": judge_dragged_trap,
        "ring": functools.partial(judge_ring, peer=settings.peer),
        "wall": functools.partial(judge_wall, peer=settings.peer),
    }


def judge_all(cases: list[Case], settings: TruthSettings) -> Truth:
    """Judge each case.

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
    return Truth(tuple(_judge(case, settings) for case in cases))


def _judge(case: Case, settings: TruthSettings) -> TruthCase:
    kind = case.description.kind
    if settings.only and case.name not in settings.only:
        return TruthCase(case.name, kind, "skipped", "not asked for")
    if not case.path.is_file():
        reason = f"no {case.description.file} in {case.folder}"
        return TruthCase(case.name, kind, "absent", reason)
    known = judges(settings)
    try:
        judgement = known[kind](case, case.read())
    except (FitError, InputError) as error:
        return TruthCase(case.name, kind, "failed", str(error))
    return TruthCase(
        case.name,
        kind,
        "judged",
        seconds=judgement.seconds,
        rows=judgement.rows,
        notes=judgement.notes,
        curves=judgement.curves,
    )


def run(options: TruthOptions) -> CommandResult:
    """Judge as the command line does."""
    cases = find_cases(options.folder)
    folder = start_run(TRUTH, options, options.settings)
    return keep(TRUTH, folder, judge_all(cases, options.settings))
