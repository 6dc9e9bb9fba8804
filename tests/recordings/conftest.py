"""A way to write a small file and read it, every bad row refused unless asked for."""

import pytest

from pinav.recordings import Reading, read_recording


@pytest.fixture
def read(tmp_path):
    """Writes content under a name and reads it as a recording."""

    def write_and_read(content, name="tracks.csv", **reading):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_recording(path, Reading(**{"strict": True, **reading}))

    return write_and_read
