"""Lines become messages or are refused; nothing else happens to them."""

import contextlib
import itertools
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinav.live import messages
from pinav.live.sources import LineBuffer

SCHEMA = Path(__file__).parents[2] / "docs" / "live.schema.json"

reals = st.floats(-messages.GREATEST, messages.GREATEST)
sizes = st.floats(0, messages.GREATEST)
frames = st.builds(
    messages.Frame,
    seq=st.integers(0, 2**53),
    t=reals,
    x=st.none() | reals,
    y=st.none() | reals,
    sd=st.none() | sizes,
    frequency=sizes,
    heading=reals,
)


@given(frames)
def test_a_frame_survives_its_line(frame):
    assert messages.decode(messages.encode(frame).rstrip()) == frame


def test_unknown_fields_are_ignored_and_limits_stated():
    line = b'{"type":"frame","seq":1,"t":0,"x":1,"y":2,"gain":{"a":[1]}}'
    assert messages.decode(line) == messages.Frame(seq=1, t=0.0, x=1.0, y=2.0)
    hello = messages.Hello(
        version=1, session="a", step=0.1, limits=messages.Limits(frequency=5.0)
    )
    assert messages.decode(messages.encode(hello).rstrip()) == hello
    with pytest.raises(messages.RefusedLine, match="> 0"):
        messages.decode(messages.encode(hello).replace(b"0.1", b"0.0").rstrip())


REFUSED = {
    "no JSON": (b"{", "truncated"),
    "not a number": (b'{"type":"frame","seq":1,"t":NaN,"x":1,"y":2}', "malformed"),
    "infinite": (b'{"type":"frame","seq":1,"t":1e999,"x":1,"y":2}', "out of range"),
    "too large": (b'{"type":"frame","seq":1,"t":1e13,"x":1,"y":2}', "<= 1000000000000"),
    "no time": (b'{"type":"frame","seq":1,"x":1,"y":2}', "missing required field"),
    "negative": (b'{"type":"frame","seq":-1,"t":0,"x":1,"y":2}', ">= 0"),
    "part of a frame": (b'{"type":"frame","seq":0.5,"t":0,"x":1,"y":2}', "int"),
    "another type": (b'{"type":"command","seq":1}', "Invalid value"),
    "no object": (b"3", "Expected `object`"),
    "deep": (b"[" * 60_000, "Expected|recursion|truncated"),
    "no UTF-8": (b'{"type":"bye","reason":"\xff"}', "."),
    "too long": (
        b'{"type":"bye"}' + b" " * messages.LONGEST,
        "longer than 65536 bytes",
    ),
}


@pytest.mark.parametrize(("line", "reason"), REFUSED.values(), ids=REFUSED)
def test_other_lines_are_refused_with_a_reason(line, reason):
    with pytest.raises(messages.RefusedLine, match=reason):
        messages.decode(line)


@given(st.binary(max_size=300))
def test_no_bytes_raise_anything_else(data):
    with contextlib.suppress(messages.RefusedLine):
        assert isinstance(
            messages.decode(data), messages.Hello | messages.Frame | messages.Bye
        )


def test_the_schema_file_is_that_of_the_structs():
    assert SCHEMA.read_bytes() == messages.schema()
    names = {"Hello", "Frame", "Bye", "Ready", "Command", "State", "Event"}
    assert names <= set(json.loads(messages.schema())["$defs"])


@given(st.lists(st.binary(max_size=20)), st.lists(st.integers(0, 200)))
def test_lines_do_not_depend_on_how_bytes_arrive(parts, cuts):
    data = b"\n".join(part.replace(b"\n", b"") for part in parts) + b"\n"
    buffer, lines = LineBuffer(), []
    ends = sorted({min(cut, len(data)) for cut in cuts} | {0, len(data)})
    for begin, end in itertools.pairwise(ends):
        buffer, more = buffer.after(data[begin:end])
        lines += more
    assert lines == LineBuffer().after(data)[1]
    assert buffer == LineBuffer()


def test_an_endless_line_takes_no_memory():
    buffer = LineBuffer()
    for _ in range(20):
        buffer, lines = buffer.after(b"x" * messages.LONGEST)
        assert not lines
        assert len(buffer.half) <= messages.LONGEST + 1
    buffer, (line, last) = buffer.after(b"\n{}\n")
    assert (len(line), last) == (messages.LONGEST + 1, b"{}")
