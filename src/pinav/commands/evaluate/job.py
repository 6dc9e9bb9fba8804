"""`pinav evaluate`: scores that say where the models of a run can be trusted."""

from collections.abc import Callable, Iterator

from pinav.codec import Json, encode
from pinav.commands import EVALUATE
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.evaluate import EvaluateOptions
from pinav.commands.results import keep, open_fit
from pinav.evaluation import (
    BASELINE,
    START_SAMPLES,
    CalibratedBand,
    Evaluation,
    ParameterRecovery,
    Regions,
    Whiteness,
    evaluate,
)
from pinav.figures import evaluation_errors_figure, residuals_figure
from pinav.report import (
    AbstractBlock,
    Cell,
    Paragraph,
    Section,
    Table,
    capitalise,
    heading,
    percent,
    quantity,
)
from pinav.runs import RunFolder

WORDS = {"nan": "", "inf": "diverged"}
"""Cells of numbers that are not finite."""


def run(options: EvaluateOptions) -> CommandResult:
    """Evaluate as the command line does."""
    fit = open_fit(options.run)
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
        yield "/".join(path), WORDS.get(content, content)


BEYOND_DATA = (
    "In unvisited places a band rests on the assumed prior alone, which fades away "
    "from the data, while true forces need not: do not trust it there."
)
"""Limit of the bands."""

SHOWN_LAGS = (1, 2, 5, 10)
"""Lags whose autocorrelation the table shows."""


def sections(result: Evaluation) -> list[Section]:
    """Sentences, tables and figures of an evaluation."""
    blocks: list[AbstractBlock] = [Paragraph(purpose(result))]
    blocks += map(Paragraph, [f"{capitalise(_regions(result))}.", *result.notes])
    blocks += map(Paragraph, warnings(result))
    blocks += [_errors(result), _rollouts(result)]
    if result.force:
        blocks.append(_force(result))
    if result.coverage:
        blocks.append(_coverage(result.coverage))
    if result.whiteness is not None:
        blocks.append(_whiteness(result.whiteness))
    if result.constants:
        blocks.append(_constants(result.constants))
    if result.calibration is not None:
        blocks.append(_calibration(result.calibration, result.data))
    blocks.append(evaluation_errors_figure(result, error_name(result)))
    if result.whiteness is not None:
        blocks.append(residuals_figure(result.whiteness))
    return [Section("Evaluation", blocks)]


def error_name(result: Evaluation) -> str:
    """The name of the errors: of predictions, or of the fit itself."""
    if not result.num_training:
        return "held-out error"
    whole = result.num_training == result.trajectories
    return "training error" if whole else "error, in part on training data"


def purpose(result: Evaluation) -> str:
    """A sentence on what the scores say, by the data that were scored."""
    if not result.num_training:
        return (
            "The scores say where the fit can be trusted: the trajectories are "
            "none of those that it was fitted to."
        )
    if result.num_training == result.trajectories:
        return (
            "These are the training data: the scores are training errors and say "
            "how well the run describes what it was fitted to, not how well it "
            "predicts."
        )
    return (
        f"Of the {result.trajectories} trajectories the run was fitted to "
        f"{result.num_training}: the scores are in part training errors; score other "
        "trajectories to learn how well the run predicts."
    )


def warnings(result: Evaluation) -> list[str]:
    """A sentence for each model whose rollouts err more than the known physics."""
    unit = result.units.get("x", "")
    return [
        f"The learned force makes rollouts worse: {model} errs by "
        f"{quantity(result.median_error(model), unit)} in the median, the known "
        f"physics alone by {quantity(result.median_error(BASELINE), unit)}. Do not "
        "predict or steer with it: these data do not determine it, or another model "
        "suits it (pinav compare weighs several)."
        for model in result.worse_than_physics
    ]


def _regions(result: Evaluation) -> str:
    return result.regions.definition(result.units.get("x", ""))


def _errors(result: Evaluation) -> Table:
    units = {"position": result.units.get("x", "")} | result.units
    names = next(iter(result.rmse.values()))
    starts = (
        f"estimated from the first {START_SAMPLES} samples with the model fixed; "
        "only the samples after them are scored"
        if result.has_estimated_starts
        else "the first sample of each trajectory"
    )
    return Table(
        (
            f"RMSE, {error_name(result)}",
            *(heading(name, units.get(name, "")) for name in names),
        ),
        [(name, *errors.values()) for name, errors in result.rmse.items()],
        f"Rollouts over {result.data}, {result.trajectories} trajectories; "
        f"starts: {starts}.",
    )


def _rollouts(result: Evaluation) -> Table:
    rows = [
        (
            f"{model}, {source}, {part}",
            summary.median,
            summary.high,
            percent(summary.median_relative),
            percent(summary.high_relative),
            percent(summary.diverged),
            summary.trajectories,
        )
        for model, sources in result.rollouts.items()
        for source, parts in sources.items()
        for part, summary in parts.items()
    ]
    unit = result.units.get("x", "")
    header = ("position error of rollouts", heading("median", unit))
    header += (heading("90 %", unit),)
    header += ("median/path (%)", "90 %/path (%)", "diverged (%)", "trajectories")
    return Table(
        header,
        rows,
        "Root-mean-square position error of each trajectory: median and 90th "
        "percentile over trajectories, also over the length of the path. Diverged: not "
        f"finite, or farther off than the extent of the training data, "
        f"{quantity(result.domain, unit)}. The training horizon is "
        f"{quantity(result.horizon, result.units.get('t', ''))}. "
        "Clean starts are those of held-out trajectories of the system without "
        "observation noise.",
    )


def _force(result: Evaluation) -> Table:
    rows = [
        (
            f"{model}, {region}",
            percent(agreement.error),
            "–" if agreement.cosine != agreement.cosine else f"{agreement.cosine:.5f}",
            agreement.points,
        )
        for model, regions in result.force.items()
        for region, agreement in regions.items()
    ]
    return Table(
        ("force of", "relative L2 error (%)", "cosine", "grid points"),
        rows,
        "Against the truth of the system, on a grid around the training data, a "
        f"swimmer at rest. {capitalise(_regions(result))}.",
    )


def _coverage(coverage: dict[str, dict[str, float]]) -> Table:
    regions = ("visited", "near", "unvisited")
    return Table(
        ("inside nominal 95 % bands (%)", *regions),
        [
            (what, *(percent(row[region]) for region in regions))
            for what, row in coverage.items()
        ],
        "Observations count the noise that the fit found; rollouts from clean starts "
        "and the force are compared with the truth itself. Regions are those of the "
        f"force table. {BEYOND_DATA}",
    )


def _whiteness(test: Whiteness) -> Table:
    rows = [
        (
            name,
            test.counts[i],
            *(float(test.autocorrelation[i, lag - 1]) for lag in SHOWN_LAGS),
            float(test.statistic[i]),
            float(test.p_value[i]),
        )
        for i, name in enumerate(test.channels)
        if test.counts[i]
    ]
    lags = (f"lag {lag}" for lag in SHOWN_LAGS)
    return Table(
        ("residuals of", "count", *lags, "Ljung-Box Q", "p"),
        rows,
        "Autocorrelation of the residuals of the fit on the training data, and Ljung "
        "and Box's test over lags 1 to 10: a small p says that they are not white, so "
        "that the model misses something. Without noise in the data the residuals are "
        "integration error, which is never white.",
    )


def _constants(constants: tuple[ParameterRecovery, ...]) -> Table:
    columns: dict[str, Callable[[ParameterRecovery], Cell]] = {
        "constant": lambda one: one.name,
        "unit": lambda one: one.unit,
        "true": lambda one: one.true,
        "recovered": lambda one: one.value,
        "sd": lambda one: one.sd,
        "error (%)": lambda one: percent(one.relative_error),
        "z": lambda one: one.z,
    }
    return Table.of(
        constants,
        columns,
        "Constants trained beside the force, against the truth of the system: an error "
        "that the force could compensate shows here; |z| above 2 or 3 says that the "
        "interval is too narrow.",
    )


def _calibration(found: CalibratedBand, data: str) -> Table:
    band = found.band
    unit = (
        "standard deviations of the band"
        if found.has_posterior
        else "the unit of each channel"
    )
    return Table(
        ("conformal band", "radius", "trajectories", "data inside (%)"),
        [
            (
                found.data,
                band.radius if band.radius < float("inf") else "none",
                band.count,
                percent(found.covered),
            )
        ],
        f"Split-conformal, whole trajectories: {found.says}. The radius is in {unit}. "
        f"Inside: trajectories of {data} that stay within the band at every scored "
        "sample.",
    )
