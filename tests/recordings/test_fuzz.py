"""Whatever happens to a file of text: it is read, or refused with one line."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.damage import damaged
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


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=60)
@given(key=st.integers(0, 2**32), hits=st.integers(1, 4), known=st.booleans())
def test_damaged_text_is_read_or_refused_with_one_line(
    tmp_path_factory, name, key, hits, known
):
    rng, content = random.Random(key), FILES[name].encode()
    for _ in range(hits):
        content = damaged(content, rng)
    path = tmp_path_factory.mktemp("fuzz") / "a.csv"
    path.write_bytes(content)
    reading = SAMPLES[name].reading if name in SAMPLES else {}
    format = FORMATS[name] if known else None
    complaint = ""
    try:
        read_recording(path, Reading(format=format, **reading))
    except InputError as error:
        complaint = str(error)
    assert "\n" not in complaint
