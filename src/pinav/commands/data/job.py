"""`pinav data`: public recordings, whence they come, and one of them."""

from pinav.commands.command import CommandResult
from pinav.commands.data import DataOptions
from pinav.recordings.public import PUBLIC, fetch_recording, public_recording

TOLD = ("name", "summary", "address", "licence", "sha256", "reference")
"""The facts of a recording that scripts are told."""


def run(options: DataOptions) -> CommandResult:
    """List the recordings, or fetch one."""
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
