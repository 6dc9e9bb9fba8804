"""`pinav heat`: the tasks on a case of bioheat, and what each of them found."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pinav.commands import HEAT
from pinav.commands.command import CommandResult
from pinav.commands.heat import HeatOptions
from pinav.commands.results import keep
from pinav.figures.heat import fields_figure, probes_figure, protocol_figure
from pinav.figures.learned_tissue import (
    curves_figure,
    forecast_figure,
    last_frame_figure,
    laws_figure,
)
from pinav.report import Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.thermal.case import Case, read_case
from pinav.thermal.heated_run import AbstractHeatResult, HeatedRun, simulate
from pinav.thermal.images import write_image
from pinav.thermal.learned_tissue import Forecast, LearnedTissue, learn_tissue
from pinav.thermal.planned_run import Judgement, PlannedRun, PlanTask
from pinav.thermal.protocols import require
from pinav.thermal.readings import Readings, save_probes
from pinav.thermal.setup import Setup
from pinav.thermal.tissue_fit import TissueFit

READINGS = "probes.csv"
"""File of the readings of probes."""

END = "results.npz"
"""File of temperature and dose at the end, from which another run can start."""

Task = Callable[[], tuple[AbstractHeatResult, Readings | None]]
"""Computes a result, and the readings of the probes of the case if there are any."""


def run(options: HeatOptions) -> CommandResult:
    """Run a task of bioheat as the command line does.

    Everything that can be refused is refused before the folder is made.
    """
    case, content = read_case(options.case)
    setup = Setup.of(case, options.case.parent)
    compute = TASKS[options.task](case, setup, options.case.parent)
    config = {"run": {"command": HEAT.name, "task": options.task}, "case": content}
    folder = RunFolder.create(
        options.out, config, overwrite=options.overwrite, resumable=False
    )
    result, readings = compute()
    if readings is not None:
        save_probes(readings, folder.path / READINGS, overwrite=True)
        folder.manifest.record(READINGS)
    heated = result.result if isinstance(result, PlannedRun) else result
    if isinstance(heated, HeatedRun):
        end = {"temperature": heated.temperature, "dose": heated.dose}
        folder.write_arrays(END, end)
    image = setup.body.image
    if image is not None and image.affine is not None:
        for name, values in _images(heated).items():
            write_image(folder.path / f"{name}.nii.gz", values, image)
            folder.manifest.record(f"{name}.nii.gz")
    return keep(HEAT, folder, result)


def _images(result: AbstractHeatResult) -> dict[str, np.ndarray]:
    """Fields that are written as NIfTI, too, where the labels are."""
    if isinstance(result, LearnedTissue) and result.frame is not None:
        return {"reading": result.frame.read, "fit": result.frame.fitted}
    if not isinstance(result, HeatedRun):
        return {}
    dead = {} if result.dead is None else {"dead": result.dead}
    return {"temperature": result.temperature, "dose": result.dose, **dead}


def _simulate(case: Case, setup: Setup, folder: Path) -> Task:
    require(setup.protocol, *setup.limits)

    def compute() -> tuple[HeatedRun, Readings | None]:
        probes = setup.readings() if len(setup.points) else None
        return simulate(setup), probes

    return compute


def _learn(case: Case, setup: Setup, folder: Path) -> Task:
    task = TissueFit.of(case, setup, folder)

    def compute() -> tuple[LearnedTissue, Readings | None]:
        if task.fitted is not None:
            return learn_tissue(task, task.fitted), None
        readings = setup.readings(task.settings.noise, task.settings.seed)
        return learn_tissue(task, readings), readings

    return compute


def _optimise(case: Case, setup: Setup, folder: Path) -> Task:
    task = PlanTask.of(case, setup, folder)
    return lambda: (task.run(), None)


TASKS = {"simulate": _simulate, "learn": _learn, "optimise": _optimise}
"""By name; each checks a case first, whose folder is not made if it is refused."""


Rows = list[tuple[str, str | float]]

SYNTHETIC = "Synthetic data of a research code."

CAUTION = Paragraph(
    "Research code. The tissue, its readings and its perfusion are synthetic; nothing "
    "here is medical advice or treatment planning."
)


def sections(found: AbstractHeatResult) -> list[Section]:
    """Sections on a run, on a learned tissue or on a plan."""
    if isinstance(found, LearnedTissue):
        return _fit_sections(found)
    if isinstance(found, PlannedRun):
        result, *others = _run_sections(found.result, found.max_temperature)
        return [result, _constraints(found), *others]
    assert isinstance(found, HeatedRun)
    return _run_sections(found)


def _run_sections(run: HeatedRun, bound: float | None = None) -> list[Section]:
    warnings = [Paragraph(f"Warning: {line}.") for line in run.warnings]
    parts = [
        Section("Result", [CAUTION, run_table(run), *warnings]),
        Section("Field", [protocol_figure(run, bound)]),
        Section("Temperature and dose", [fields_figure(run)]),
    ]
    if run.probes is not None:
        parts.append(Section("Probes", [probes_figure(run)]))
    return parts


def _constraints(found: PlannedRun) -> Section:
    line = (
        f"D90 {found.result.D90:.3g} min, from {found.start_D90:.3g} min at the flat "
        f"start; {found.outcome}."
    )
    judged = [] if found.judged is None else [judgement_table(found.judged)]
    blocks = [constraint_table(found), *judged, Paragraph(line)]
    return Section("Constraints", blocks)


def _fit_sections(found: LearnedTissue) -> list[Section]:
    parts = [Section("The fit", [CAUTION, fit_table(found)])]
    if found.laws:
        parts.append(Section("Learned perfusion", [laws_figure(found)]))
    if found.frame is None:
        parts.append(Section("Probes", [curves_figure(found)]))
    else:
        last = last_frame_figure(found.title, found.frame)
        parts.append(Section("Frames", [curves_figure(found), last]))
    if found.forecast is not None:
        figure = forecast_figure(found.title, found.forecast)
        parts.append(Section("Prediction", [figure]))
    return parts


def run_table(run: HeatedRun) -> Table:
    """Temperatures and doses of a run."""
    reached = run.time_to_therapy
    rows: Rows = [
        ("highest temperature [°C]", run.T_max),
        ("end of heating [min]", run.heated / 60),
        ("T10 of the tumour at the end of heating [°C]", run.T10),
        ("T50 of the tumour at the end of heating [°C]", run.T50),
        ("T90 of the tumour at the end of heating [°C]", run.T90),
        ("fraction of the tumour above 43 °C then", run.V43),
        ("D90 of the tumour [CEM43 min]", run.D90),
        (
            "D90 reaches 10 CEM43 min after [min]",
            "never" if reached is None else reached / 60,
        ),
        ("CEM43 T90 of the tumour [min]", run.CEM43T90),
        ("largest dose outside the tumour [CEM43 min]", run.healthy_dose),
        ("largest product Hf [A/(m s)]", run.Hf),
        ("relative error of the energy balance", run.imbalance),
    ]
    if run.dead_target is not None and run.dead_outside is not None:
        rows.append(("dead fraction of the tumour (Arrhenius)", run.dead_target))
        name = "largest dead fraction outside the tumour (Arrhenius)"
        rows.append((name, run.dead_outside))
    return Table(("quantity", "value"), rows, SYNTHETIC)


def constraint_table(found: PlannedRun) -> Table:
    """The constraints of an optimisation."""
    return Table.of(
        found.constraints,
        {
            "constraint": lambda one: f"{one.name} [{one.unit}]",
            "value": lambda one: one.value,
            "bound": lambda one: one.bound,
            "at the optimum": lambda one: "active" if one.active else "not reached",
        },
    )


def judgement_table(judged: Judgement) -> Table:
    """A plan on the true tissue."""
    rows: Rows = [
        ("D90 of the tumour [CEM43 min]", judged.D90),
        ("D90 of a plan made with the truth [CEM43 min]", judged.best_D90),
        ("highest temperature [°C]", judged.T_max),
    ]
    return Table(("the plan on the true tissue", "value"), rows)


def fit_table(found: LearnedTissue) -> Table:
    """Table of the residuals and the numbers of a fit."""
    unit = "of its map" if found.relative else "[K]"
    rows: Rows = [
        (f"residual, root mean square {unit}", found.residual),
        (f"noise, estimated {unit}", found.noise),
        ("steps", found.iterations),
    ]
    for name, law in found.laws.items():
        low, high = law.visited
        rows.append((f"perfusion of {name}: visited [°C]", f"{low:.1f} to {high:.1f}"))
        if law.covered is not None:
            label = f"perfusion of {name}: coverage of the 95 % band"
            rows.append((label, law.covered))
    if not found.quantities:
        for name, one in found.constants.items():
            rows.append((name, f"{one.value:.5g} ± {one.sd:.2g}"))
    for name, one in found.quantities.items():
        true = f"; true {found.true[name]:.5g}" if name in found.true else ""
        rows.append((name, f"{one.value:.5g} ± {one.sd:.2g}{true}"))
    if found.laws:
        name = f"residual of the best constant perfusion {unit}"
        rows.append((name, found.constant_residual))
    if found.forecast is not None:
        rows += _forecast_rows(found.forecast, unit)
    for row in found.held_out:
        name = f"largest error at power {row.power:g}, not fitted [K]"
        rows.append((name, row.learned))
        rows.append((f"{name}, constant perfusion", row.constant))
    return Table(("quantity", "value"), rows, SYNTHETIC)


def _forecast_rows(forecast: Forecast, unit: str) -> Rows:
    rows: Rows = [
        ("fitted until [min]", forecast.fitted_until / 60),
        ("later: largest standard deviation of the target [K]", forecast.largest_sd),
    ]
    if forecast.residual is not None:
        rows.append((f"later: residual {unit}", forecast.residual))
    if forecast.error is not None and forecast.covered is not None:
        rows.append(("later: largest error of the target [K]", forecast.error))
        rows.append(("later: truth in the 95 % band", forecast.covered))
    return rows
