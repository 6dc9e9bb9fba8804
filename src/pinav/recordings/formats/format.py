"""What a format of recordings is to pinav."""

import abc

from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source


class AbstractFormat(abc.ABC):
    """A format: how it is known, and how it is read.

    Attributes:
        name: what the user calls it.
    """

    name: str

    @abc.abstractmethod
    def suits(self, source: Source) -> bool:
        """Whether the content looks like this format; cheap, and never raises."""

    @abc.abstractmethod
    def tracks(self, source: Source, reading: Reading) -> Tracks:
        """The rows of the file.

        Args:
            source: the file.
            reading: what the user says of it.

        Raises:
            InputError: the file is damaged; the message names the row and the column,
                but not the file.
        """
