"""Bytes become lines, however they arrive."""

import dataclasses

from pinav.live.messages import LONGEST


@dataclasses.dataclass(frozen=True)
class LineBuffer:
    """The half line that waits for its newline.

    Of a line that grows beyond the longest one only its first bytes are kept, so that
    memory is bounded; it is returned when it ends and refused for its length.

    Attributes:
        half: what came since the last newline.
    """

    half: bytes = b""

    def after(self, data: bytes) -> tuple["LineBuffer", list[bytes]]:
        """The buffer and the lines that are complete after more bytes."""
        *lines, half = (self.half + data).split(b"\n")
        lines = [line[: LONGEST + 1].rstrip(b"\r") for line in lines]
        return LineBuffer(half[: LONGEST + 1]), [line for line in lines if line]
