"""`pinav evaluate`: scores that say where the models of a run can be trusted."""

from collections.abc import Iterator

from pinav.codec import Json, encode
from pinav.commands import EVALUATE
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.evaluate import EvaluateOptions
from pinav.commands.results import keep
from pinav.evaluation import Evaluation, Regions, evaluate
from pinav.learning.learned import Learned
from pinav.report import Cell
from pinav.runs import RunFolder

WORDS = {"nan": "", "inf": "diverged"}
"""Cells of numbers that are not finite."""


def run(options: EvaluateOptions) -> CommandResult:
    """Evaluate as the command line does.

    Raises:
        InputError: the run holds no model, or a file cannot be read or scored.
    """
    fit = Learned.open(options.run)
    further = options.calibrate
    evaluation = evaluate(
        fit,
        read_data(options.data, options.reading),
        calibration=further and read_data(further, options.reading),
        regions=None if options.regions is None else Regions(*options.regions),
        names=(options.data.name, further.name if further else ""),
    )
    write_numbers(fit.folder, evaluation)
    return keep(EVALUATE, fit.folder, evaluation)


def write_numbers(folder: RunFolder, evaluation: Evaluation) -> None:
    """Write every score as one long table, without the curves over time.

    The residuals stand by channel and test.
    """
    content = encode(evaluation).document
    content.pop("curves")
    if "whiteness" in content:
        parts = content["whiteness"]
        content["whiteness"] = {
            channel: {part: values[index] for part, values in parts.items()}
            for index, channel in enumerate(parts.pop("channels"))
        }
    folder.write_table("evaluation.csv", ("quantity", "value"), [*_rows(content)])


def _rows(content: Json, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Cell]]:
    if isinstance(content, dict | list):
        pairs = content.items() if isinstance(content, dict) else enumerate(content)
        for key, value in pairs:
            yield from _rows(value, (*path, str(key)))
    else:
        known = "" if content is None else WORDS.get(content, content)
        yield "/".join(path), known
