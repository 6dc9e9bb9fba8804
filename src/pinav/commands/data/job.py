"""`pinav data`: public recordings, whence they come, and one of them."""

import msgspec

from pinav.commands.command import CommandResult
from pinav.commands.data.settings import DataOptions
from pinav.recordings.public import PUBLIC, fetch_recording


class PublicRow(msgspec.Struct, frozen=True):
    """A public recording, for scripts.

    Attributes:
        name: of the recording.
        summary: what was recorded.
        address: of the authors' file.
        licence: as stated.
        sha256: checksum of that file.
        reference: where it was published.
    """

    name: str
    summary: str
    address: str
    licence: str
    sha256: str
    reference: str


class FetchMetrics(msgspec.Struct, frozen=True):
    """What was fetched.

    Attributes:
        file: that was written.
    """

    file: str


def run(options: DataOptions) -> CommandResult:
    """List the recordings, or fetch one."""
    if options.name:
        path = fetch_recording(options.name, options.out, options.source)
        text = (
            f"{path}: in a source checkout, python -m validation.truth {options.out} "
            "--out runs/truth judges it"
        )
        return CommandResult(FetchMetrics(str(path)), text)
    rows = [
        PublicRow(*(getattr(one, name) for name in PublicRow.__struct_fields__))
        for one in PUBLIC
    ]
    blocks = [
        f"{one.name}: {one.summary}\n  {one.reference}\n  "
        f"github.com/{one.repository} at {one.commit}\n  {one.path}\n  licence: "
        f"{one.licence}; sha256 {one.sha256}\n  by hand: {one.by_hand}"
        for one in PUBLIC
    ]
    return CommandResult(rows, "\n".join(blocks))
