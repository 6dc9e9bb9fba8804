"""`pinav explore`: write the page in which the model of a run is tried by hand."""

from pinav.commands.command import CommandResult
from pinav.commands.explore.document import document
from pinav.commands.explore.payload import payload_of
from pinav.commands.explore.plan import fit_of_plan, is_plan, plan_of
from pinav.commands.explore.settings import ExploreOptions
from pinav.commands.fitted_run import FittedRun
from pinav.errors import InputError
from pinav.runs import RunFolder

PAGE = "explore.html"


def run(options: ExploreOptions) -> CommandResult:
    """Write the page of a run, and the run's report, which links to it.

    Raises:
        InputError: the folder holds no run that the page can show.
    """
    folder = RunFolder.open(options.run)
    plans = is_plan(folder)
    if options.fit is not None and not plans:
        raise InputError(f"--fit: {options.run} holds a model itself; drop the option")
    fitted = FittedRun.open(fit_of_plan(folder, options.fit) if plans else options.run)
    page = document(payload_of(fitted, plan_of(folder) if plans else None))
    folder.write_text(PAGE, page)
    path = folder.path / PAGE
    metrics = {"page": str(path), "bytes": len(page.encode())}
    text = f"explorer: {path} ({metrics['bytes'] / 1e6:.2f} MB)"
    return CommandResult(metrics, text, folder)
