"""What files say of trajectories beside their numbers."""

import json
from typing import Any

import msgspec

from pinav.errors import InputError
from pinav.trajectories.trajectories import Trajectories

FORMAT = 1
"""Version of both formats; a newer one is refused."""


class Metadata(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the numbers do not say.

    Attributes:
        format: version of the file.
        channels: names of the components of the state.
        commands: names of the commands.
        units: of channels, commands and time `t`.
        provenance: where the data came from; None where the file does not say so.
    """

    format: int = FORMAT
    channels: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    units: dict[str, str] = {}
    provenance: dict[str, Any] | None = None


def metadata_text(trajectories: Trajectories) -> str:
    """The metadata of trajectories, as JSON."""
    metadata = Metadata(
        channels=trajectories.channels,
        commands=tuple(trajectories.commands),
        units=trajectories.units,
        provenance=trajectories.provenance,
    )
    return json.dumps(msgspec.structs.asdict(metadata))


def parse_metadata(place: str, text: str) -> Metadata:
    """Metadata from JSON.

    Raises:
        InputError: it is something else; the message begins with the place.
    """
    try:
        values = json.loads(text)
        version = values.get("format", FORMAT) if isinstance(values, dict) else FORMAT
        if version != FORMAT:
            raise InputError(
                f"{place}: format {version!r} is not known, expected {FORMAT}; "
                "read it with the version of pinav that wrote it"
            )
        return msgspec.convert(values, Metadata)
    except (json.JSONDecodeError, msgspec.ValidationError) as error:
        raise InputError(f"{place}: not the metadata of pinav: {error}") from error
