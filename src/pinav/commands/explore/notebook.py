"""The page as a widget of a notebook, which Python reads and moves (anywidget)."""

import importlib
from importlib.resources import files
from typing import Any

from pinav.errors import InputError


def make_widget(page: str, height: int) -> Any:
    """A widget that shows a page and shares its conditions with Python.

    Its attributes follow the page, and `address` moves it when it is set:

    - `address`: the conditions, as the text after `#` in the page's address; empty as
      at first.
    - `path`: the path with its standard deviations, or the curves of bioheat, as CSV.

    Args:
        page: the HTML of the page.
        height: of its frame [pixels].

    Raises:
        InputError: anywidget is not installed.
    """
    try:
        anywidget = importlib.import_module("anywidget")
        traitlets = importlib.import_module("traitlets")
    except ImportError as error:
        raise InputError(
            "a widget of the explorer needs anywidget; install it with "
            "`pip install 'pinav[notebook]'`, or show pinav.explorer(run) itself"
        ) from error

    def shared(value: str) -> Any:
        return traitlets.Unicode(value).tag(sync=True)

    module = files("pinav.commands.explore").joinpath("widget.js")
    parts = {
        "_esm": module.read_text(encoding="utf-8"),
        "page": shared(page),
        "height": shared(f"{height}px"),
        "address": shared(""),
        "path": shared(""),
    }
    return type("ExplorerWidget", (anywidget.AnyWidget,), parts)()
