"""A tracker's table becomes lines of the protocol."""

import pytest

from pinav.live.loop import TableReader, header_places
from pinav.live.messages import Frame, Hello, Limits, decode

HEADER = b"frame,t_s,x_um,y_um,freq_hz,alpha_rad"


def messages(lines):
    reader, out = TableReader("table", Limits(frequency=5.0)), []
    for line in lines:
        reader, more = reader.after(line)
        out += more
    return out


def test_rows_become_a_hello_and_frames():
    lines = [HEADER, b"7,0.5,1,2,3,0.1", b"8,0.75,,nan,0,0", b"9,1.0,1,2,3,0.2"]
    hello, *frames = map(decode, messages(lines))
    assert hello == Hello(
        version=1, session="table", step=0.25, limits=Limits(frequency=5.0)
    )
    assert frames[0] == Frame(seq=7, t=0.5, x=1.0, y=2.0, frequency=3.0, heading=0.1)
    assert not frames[1].observed
    assert [frame.seq for frame in frames] == [7, 8, 9]
    lines = messages([b"t,x,y", b"0,1,1", b"1,1,1", b"2,1,1"])
    assert [decode(line).seq for line in lines[1:]] == [0, 1, 2]


@pytest.mark.parametrize("row", [b"1,2", b"1,x,1,1,1,1", b"-1,0,1,1,1,1", b",,,,,"])
def test_a_damaged_row_is_passed_on_to_be_refused(row):
    lines = [HEADER, b"0,0,1,1,1,1", b"1,1,1,1,1,1"]
    assert messages([*lines, row])[-1] == row


def test_columns_are_known_by_their_titles():
    assert header_places(b"y, x ,Time") == {"t": 2, "x": 1, "y": 0}
    assert header_places(b"0,1,2") is None
    assert messages([b"0,1,2"]) == [b"0,1,2"]
