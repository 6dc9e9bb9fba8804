"""What a terminal shows."""

import io
import json

import msgspec

from pinav.live.messages import Event, EventKind, Mode, State
from pinav.live.page import EventPrinter, status_line

STATE = State(
    seq=1,
    t=12.34,
    mode=Mode.STEERING,
    x=1.0,
    y=2.0,
    sd=0.1,
    delay=0.3,
    gain=9.0,
    gain_sd=0.5,
    offset=1.4,
    drift=(0.1, 0.2),
    force=(0.3, 0.4),
    time_to_go=7.5,
)


def test_lines_for_people_come_once_a_second_and_events_at_once():
    stream = io.StringIO()
    printer = EventPrinter(stream.write, people=True)
    for step in range(25):
        printer.show(msgspec.structs.replace(STATE, t=0.1 * step))
    printer.show(Event(t=2.5, kind=EventKind.LOST, text="the robot is not seen"))
    lines = stream.getvalue().splitlines()
    assert len(lines) == 4
    assert lines[-1].endswith("! lost: the robot is not seen")
    programs = io.StringIO()
    EventPrinter(programs.write).show(STATE)
    assert json.loads(programs.getvalue())["type"] == "state"


def test_a_line_leaves_out_what_is_not_known():
    text = status_line(STATE)
    for part in ("12.3s", "steering", "(1, 2) ± 0.1", "gain 9 ± 0.5", "7.5 s to go"):
        assert part in text
    assert status_line(State(seq=0, t=0.0, mode=Mode.WAITING)).split() == [
        "0.0s",
        "waiting",
    ]
