"""Ways to write a small file and read it."""

import pytest

from pinav.commands.data_file import read_data
from pinav.recordings import Reading, read_recording


@pytest.fixture
def read(tmp_path):
    """Reads content under a name as a recording, every bad row refused unless asked."""

    def write_and_read(content, name="tracks.csv", **reading):
        path = _written(tmp_path / name, content)
        return read_recording(path, Reading(**{"strict": True, **reading}))

    return write_and_read


@pytest.fixture
def checked(tmp_path):
    """Reads content as a fit does, which refuses doubts."""
    return lambda content, options: read_data(
        _written(tmp_path / "a.csv", content), options
    )


def _written(path, content):
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
