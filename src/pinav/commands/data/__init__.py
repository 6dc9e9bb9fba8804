"""`pinav data`: public recordings, whence they come, and one of them."""

from pathlib import Path
from typing import Literal

import tyro

from pinav.commands.command import CommandResult
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


TOLD = ("name", "summary", "address", "licence", "sha256", "reference")
"""The facts of a recording that scripts are told."""


def run(options: DataOptions) -> CommandResult:
    """List the recordings, or fetch one."""
    from pinav.recordings.public import PUBLIC, fetch_recording, public_recording

    if options.what == "fetch":
        path = fetch_recording(options.name, options.out, options.source)
        text = (
            f"{path}: in a source checkout, python -m validation.truth {options.out} "
            "--out runs/truth judges it"
        )
        return CommandResult({"file": str(path)}, text)
    several = [public_recording(options.name)] if options.name else PUBLIC
    rows = [{name: getattr(one, name) for name in TOLD} for one in several]
    blocks = [
        f"{one.name}: {one.summary}\n  {one.reference}\n  "
        f"github.com/{one.repository} at {one.commit}\n  {one.path}\n  licence: "
        f"{one.licence}; sha256 {one.sha256}\n  by hand: {one.by_hand}"
        for one in several
    ]
    return CommandResult(rows, "\n".join(blocks))
