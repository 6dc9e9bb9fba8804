"""Whatever happens to a file of text: it is read, or refused with one line."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.recordings.formats.test_deeplabcut import LINES
from tests.recordings.formats.test_trackmate import GOOD
from tests.recordings.test_text_damage import SAMPLES

from pinav.errors import InputError
from pinav.recordings import Reading, read_recording

FILES = {
    **{name: sample.text(sample.lines()) for name, sample in SAMPLES.items()},
    "DeepLabCut": "\n".join(LINES),
    "TrackMate, XML": GOOD,
}
FORMATS = {
    **{name: sample.format for name, sample in SAMPLES.items()},
    "DeepLabCut": "deeplabcut",
    "TrackMate, XML": "trackmate-xml",
}


@st.composite
def damaged(draw, content):
    """The content with some bytes replaced, removed or doubled."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, max(len(data) - 1, 0)))
        stop = start + draw(st.integers(0, 12))
        piece = draw(
            st.sampled_from([b"", b"\n", b",", b'"', b"-", b"1e400", b"nan", b"\xff"])
            | st.binary(max_size=3)
            | st.just(bytes(data[start:stop]) * 2)
        )
        data[start:stop] = piece
    return bytes(data)


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=60)
@given(data=st.data())
def test_damaged_text_is_read_or_refused_with_one_line(tmp_path_factory, name, data):
    path = tmp_path_factory.mktemp("fuzz") / "a.csv"
    path.write_bytes(data.draw(damaged(FILES[name].encode())))
    reading = SAMPLES[name].reading if name in SAMPLES else {}
    format = data.draw(st.sampled_from([None, FORMATS[name]]))
    complaint = ""
    try:
        read_recording(path, Reading(format=format, **reading))
    except InputError as error:
        complaint = str(error)
    assert "\n" not in complaint
