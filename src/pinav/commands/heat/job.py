"""Run the tasks of `pinav heat`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pinav.commands import HEAT
from pinav.commands.command import CommandResult
from pinav.commands.heat import HeatOptions
from pinav.commands.results import keep
from pinav.runs import RunFolder
from pinav.thermal.case import Case, read_case
from pinav.thermal.heated_run import AbstractHeatResult, HeatedRun, simulate
from pinav.thermal.images import write_image
from pinav.thermal.learned_tissue import LearnedTissue, learn_tissue
from pinav.thermal.planned_run import PlannedRun, PlanTask
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
        folder.record(READINGS)
    heated = result.result if isinstance(result, PlannedRun) else result
    if isinstance(heated, HeatedRun):
        end = {"temperature": heated.temperature, "dose": heated.dose}
        folder.write_arrays(END, end)
    if setup.body.image is not None and setup.body.image.is_nifti:
        for name, values in _images(heated).items():
            write_image(folder.path / f"{name}.nii.gz", values, setup.body.image)
            folder.record(f"{name}.nii.gz")
    return keep(HEAT, folder, result)


def _images(result: AbstractHeatResult) -> dict[str, np.ndarray]:
    """Fields that are written as NIfTI, too, where the labels are."""
    if isinstance(result, LearnedTissue) and result.frames is not None:
        return {"reading": result.frames.read, "fit": result.frames.fitted}
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
