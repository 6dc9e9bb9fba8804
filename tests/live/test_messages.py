"""Lines become messages or are refused; nothing else happens to them."""

import contextlib
import itertools
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinav.live.messages import (
    GREATEST,
    LONGEST,
    Bye,
    Frame,
    Hello,
    Limits,
    RefusedLine,
    decode,
    encode,
    schema,
)
from pinav.live.sources import LineBuffer

SCHEMA = Path(__file__).parents[2] / "docs" / "live.schema.json"

reals = st.floats(-GREATEST, GREATEST)
sizes = st.floats(0, GREATEST)
frames = st.builds(
    Frame,
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
    assert decode(encode(frame).rstrip()) == frame


def test_unknown_fields_are_ignored():
    line = b'{"type":"frame","seq":1,"t":0,"x":1,"y":2,"gain":{"a":[1]}}'
    assert decode(line) == Frame(seq=1, t=0.0, x=1.0, y=2.0)


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
    "too long": (b'{"type":"bye"}' + b" " * LONGEST, "longer than 65536 bytes"),
}


@pytest.mark.parametrize(("line", "reason"), REFUSED.values(), ids=REFUSED)
def test_other_lines_are_refused_with_a_reason(line, reason):
    with pytest.raises(RefusedLine, match=reason):
        decode(line)


@given(st.binary(max_size=300))
def test_no_bytes_raise_anything_else(data):
    with contextlib.suppress(RefusedLine):
        assert isinstance(decode(data), Hello | Frame | Bye)


def test_the_schema_file_is_that_of_the_structs():
    assert SCHEMA.read_bytes() == schema()
    names = {"Hello", "Frame", "Bye", "Ready", "Command", "State", "Event"}
    assert names <= set(json.loads(schema())["$defs"])


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
        buffer, lines = buffer.after(b"x" * LONGEST)
        assert not lines
        assert len(buffer.half) <= LONGEST + 1
    buffer, (line, last) = buffer.after(b"\n{}\n")
    assert (len(line), last) == (LONGEST + 1, b"{}")


def test_a_hello_states_what_may_be_commanded():
    hello = Hello(version=1, session="a", step=0.1, limits=Limits(frequency=5.0))
    assert decode(encode(hello).rstrip()) == hello
    with pytest.raises(RefusedLine, match="> 0"):
        decode(encode(hello).replace(b"0.1", b"0.0").rstrip())
