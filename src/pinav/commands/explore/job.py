"""`pinav explore`: write the page in which the model of a run is tried by hand."""

import dataclasses
import html
import importlib
from importlib.resources import files
from pathlib import Path
from typing import Any

import jax

from pinav.commands import HEAT
from pinav.commands.command import CommandResult
from pinav.commands.explore import ExploreOptions
from pinav.commands.explore.document import PAGE, document
from pinav.commands.explore.payload import fit_of_plan, payload_of, plan_of
from pinav.commands.explore.printing import Tree
from pinav.commands.explore.warmth import heat_payload
from pinav.commands.results import open_fit
from pinav.errors import InputError
from pinav.runs import RunFolder


@dataclasses.dataclass(frozen=True)
class Explorer:
    """The page of a run, as a notebook shows it.

    Attributes:
        page: its HTML.
        height: of the frame [pixels].
    """

    page: str
    height: int = 900

    def _repr_html_(self) -> str:
        """A frame that holds the page; it needs no kernel and no extension."""
        size = f'width="100%" height="{self.height}" style="border: 0"'
        return f'<iframe srcdoc="{html.escape(self.page)}" {size}></iframe>'

    def widget(self) -> Any:
        """The page as a widget, which shares its conditions with Python.

        Its attributes follow the page, and `address` moves it when it is set:

        - `address`: the conditions, as the text after `#` in the page's address; empty
          as at first.
        - `path`: the path with its standard deviations, or the curves of bioheat, as
          CSV.

        Raises:
            InputError: anywidget is not installed.
        """
        try:
            anywidget = importlib.import_module("anywidget")
            traitlets = importlib.import_module("traitlets")
        except ImportError as error:
            raise InputError(
                "a widget of the explorer needs anywidget; install it with `pip "
                "install 'pinav[notebook]'`, or show pinav.explorer(run) itself"
            ) from error

        def shared(value: str) -> Any:
            return traitlets.Unicode(value).tag(sync=True)

        module = files("pinav.commands.explore").joinpath("widget.js")
        parts = {
            "_esm": module.read_text(encoding="utf-8"),
            "page": shared(self.page),
            "height": shared(f"{self.height}px"),
            "address": shared(""),
            "path": shared(""),
        }
        return type("ExplorerWidget", (anywidget.AnyWidget,), parts)()


def explorer(run: str | Path, *, fit: str | Path | None = None) -> Explorer:
    """The page of `pinav explore`, to be shown in a notebook.

    Args:
        run: folder of a fit, of a plan, or of bioheat.
        fit: run of the model that a plan was made with, where it does not lie beside
            that of the plan.

    Raises:
        InputError: the folder holds no run that the page can show.
    """
    options = ExploreOptions(Path(run), None if fit is None else Path(fit))
    # A notebook may not have asked for float64, in which models are fitted and kept.
    with jax.enable_x64(new_val=True):
        return Explorer(document(_payload(RunFolder.open(options.run), options)))


def run(options: ExploreOptions) -> CommandResult:
    """Write the page of a run, and the run's report, which links to it.

    Raises:
        InputError: the folder holds no run that the page can show.
    """
    folder = RunFolder.open(options.run)
    page = document(_payload(folder, options))
    folder.write_text(PAGE, page)
    path = folder.path / PAGE
    metrics = {"page": str(path), "bytes": len(page.encode())}
    text = f"explorer: {path} ({metrics['bytes'] / 1e6:.2f} MB)"
    return CommandResult(metrics, text, folder)


def _payload(folder: RunFolder, options: ExploreOptions) -> Tree:
    """What the page knows of a fit, of a plan on one, or of a run of bioheat."""
    plans = not folder.models() and bool(folder.identity().get("fitted"))
    if options.fit is not None and not plans:
        raise InputError(f"--fit: {options.run} is no plan on another run; drop it")
    if plans:
        fit = open_fit(fit_of_plan(folder, options.fit))
        return payload_of(fit, plan_of(folder))
    if folder.command == HEAT.name:
        return heat_payload(folder)
    return payload_of(open_fit(options.run))
