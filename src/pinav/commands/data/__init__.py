"""Options of `pinav data`."""

from pathlib import Path
from typing import Literal

import tyro

from pinav.commands.settings import AsJson, Settings


class DataOptions(Settings, frozen=True, kw_only=True):
    """Tell where public recordings come from, and fetch one.

    Attributes:
        what: "list" prints the recordings with repository, licence and checksum;
            "fetch NAME" brings one into a folder of cases.
        name: Name of the recording to fetch, or of the only one to print.
        out: Folder below which it is put.
        source: The authors' file, where it is at hand; downloaded unless given.
        json: Print the recordings as JSON, for scripts, and nothing else.
    """

    what: tyro.conf.Positional[Literal["list", "fetch"]]
    name: tyro.conf.Positional[str] = ""
    out: Path = Path("truth")
    source: Path | None = None
    json: AsJson = False
