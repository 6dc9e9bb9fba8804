"""Run the tasks of `pinav heat`."""

from pathlib import Path

import numpy as np

from pinav.commands.command import CommandResult
from pinav.commands.heat import HEAT
from pinav.commands.heat.case import Case, read_case
from pinav.commands.heat.learn import LearnTask
from pinav.commands.heat.optimise import OptimiseTask
from pinav.commands.heat.settings import HeatOptions
from pinav.commands.heat.simulate import SimulateTask
from pinav.commands.heat.tables import text
from pinav.commands.heat.task import IMAGES, READINGS, RESULTS, AbstractTask
from pinav.runs import RunFolder
from pinav.thermal.images import Image, write_image
from pinav.thermal.probes import save_probes


def run(options: HeatOptions) -> CommandResult:
    """Run a task of bioheat as the command line does."""
    case, content = read_case(options.case)
    task = _task(options.task, case, options.case)
    config = {"run": {"command": HEAT.name, "task": options.task}, "case": content}
    folder = RunFolder.create(
        options.out, config, overwrite=options.overwrite, resumable=False
    )
    result = task.run()
    folder.write_arrays(RESULTS, result.arrays)
    if result.readings is not None:
        save_probes(result.readings, folder.path / READINGS, overwrite=True)
        folder.record(READINGS)
    if result.image is not None and result.image.is_nifti:
        _write_images(folder, result.arrays, result.image)
    folder.write_metrics("metrics.json", result.metrics)
    return CommandResult(result.metrics, text(result.metrics), folder)


def _write_images(
    folder: RunFolder, arrays: dict[str, np.ndarray], image: Image
) -> None:
    """NIfTI files of the end of a run or of a fit, where the labels are."""
    for name in IMAGES:
        if name in arrays:
            file = f"{name.rpartition('/')[2]}.nii.gz"
            write_image(folder.path / file, arrays[name], image)
            folder.record(file)


def _task(name: str, case: Case, path: Path) -> AbstractTask:
    if name == "learn":
        return LearnTask(case, path)
    if name == "optimise":
        return OptimiseTask(case, path)
    return SimulateTask(case, path)
