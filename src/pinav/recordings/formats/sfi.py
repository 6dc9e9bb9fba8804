"""CSV files of StochasticForceInference: comments, then `particle_id, frame, x, y`."""

import re
from typing import final

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import COMMAND_UNITS, Reading, Tracks
from pinav.recordings.source import Source

_PREFIX = re.compile(r"^(?:TG|TP|G|P)_")
"""Marks extra columns: global, of a time, of a particle, or of both."""


@final
class SFI(AbstractFormat):
    """`# dt: 0.01` above `particle_id, frame, x, y`, in units that nobody states.

    Time is frame times dt, y points as it is. An extra column with the name of a
    command, such as `TG_frequency`, is that command.

    References:
        Frishman and Ronceray, Phys. Rev. X 10, 021009 (2020).
    """

    name = "sfi"

    def suits(self, source: Source) -> bool:
        lines = (line for line in source.first_lines if not line.startswith("#"))
        return {"particle_id", "frame"} <= set(next(lines, "").split(","))

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        comments = _comments(source.text)
        table = source.read_text_table(skip=len(comments))
        facts = dict(_entry(line) for line in comments if ":" in line)
        frame = table.whole_numbers("frame", least=0)
        extras = {_PREFIX.sub("", name): name for name in table.columns}
        return Tracks(
            x=table.numbers("x", lost=True),
            y=table.numbers("y", lost=True),
            place=table.row,
            particle=table.labels("particle_id"),
            frame=frame,
            time=frame * _interval(facts["dt"]) if "dt" in facts else None,
            time_unit="?",
            length_unit="?",
            y_down=False,
            commands={
                name: table.numbers(extras[name], lost=True)
                for name in COMMAND_UNITS
                if name in extras
            },
            facts={"comments": facts},
        )


def _comments(text: str) -> list[str]:
    lines = text.splitlines()
    rest = (i for i, line in enumerate(lines) if not line.startswith("#"))
    return lines[: next(rest, len(lines))]


def _entry(line: str) -> tuple[str, str]:
    key, _, value = line.lstrip("# ").partition(":")
    return key.strip(), value.strip()


def _interval(word: str) -> float:
    """The time step of a comment `dt`."""
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise InputError(
            f"comment 'dt': expected a number > 0, got {word!r}; correct the comment"
        )
    return value
