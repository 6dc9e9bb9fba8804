"""`pinav explore`: write the page in which the model of a run is tried by hand."""

from pinav.commands.command import CommandResult
from pinav.commands.explore.document import document
from pinav.commands.explore.payload import payload_of
from pinav.commands.explore.settings import ExploreOptions
from pinav.commands.fitted_run import FittedRun

PAGE = "explore.html"


def run(options: ExploreOptions) -> CommandResult:
    """Write the page of a run, and the run's report, which links to it.

    Raises:
        InputError: the folder holds no run that the page can show.
    """
    fitted = FittedRun.open(options.run)
    page = document(payload_of(fitted))
    fitted.folder.write_text(PAGE, page)
    path = fitted.folder.path / PAGE
    metrics = {"page": str(path), "bytes": len(page.encode())}
    text = f"explorer: {path} ({metrics['bytes'] / 1e6:.2f} MB)"
    return CommandResult(metrics, text, fitted.folder)
