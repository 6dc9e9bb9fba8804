"""Further wrong conventions that a file may have: refused, or said with the remedy."""

import re

import numpy as np
import pytest
from tests.defects import told
from tests.recordings.test_conventions import NO_FRAME, UM, driven, settings

from pinav.errors import InputError
from pinav.recordings import Reading
from pinav.recordings.conventions import remarks


def table(header, row, count=20):
    """Rows of a function of their number below a header."""
    return "\n".join([header, *(",".join(map(str, row(i))) for i in range(count))])


def each_row(change, text):
    """The rows of a driven robot, changed as numbers."""
    header, *rows = text.split("\n")
    numbers = (map(float, row.split(",")) for row in rows)
    return "\n".join([header, *(",".join(map(str, change(*n))) for n in numbers)])


def clock(i):
    return f"12:59:{50 + i}" if i < 10 else f"13:00:{i - 10:02d}"


def mapped(**columns):
    """Options of a table with a column for each quantity."""
    return Reading(columns=columns)


UP = {"y": "up", **UM}
COUNTED = table("t,x,y", lambda i: (2 * i, i, 1))
TWICE = table("t,x,y", lambda i: ((i % 10) / 10, i, 1))
FIELD = driven().replace("heading,f", "heading,B [mT]")
REVERSED = each_row(lambda t, x, y, h, f: (t, x, y, h, -f), driven())
REFUSED = {
    "milliseconds without a unit": (
        each_row(lambda t, *rest: (1000 * t, *rest), driven()),
        settings(y="up", units=("x=um",)),
        r"advance by 50 from row to row.*state --units t=ms",
    ),
    "every second frame for seconds": (COUNTED, NO_FRAME, r"advance by 2 from row"),
    "days since 1900": (
        table("t,x,y", lambda i: (45000 + i * 40 / 86.4e6, i, 1)),
        NO_FRAME,
        r"advance by 4.63e-07 from row to row",
    ),
    "stamps of twelve hours": (
        table("t,x,y", lambda i: (f"{clock(i)} PM", i, 1)),
        NO_FRAME,
        r"write stamps of a clock as 13:30:01.5",
    ),
    "days before months": (
        table("t,x,y", lambda i: (f"31.12.2024 {clock(i)}", i, 1)),
        NO_FRAME,
        r"write stamps of a clock as .*2024-05-01T13:30:01",
    ),
    "a field for a frequency": (
        FIELD,
        settings("t=t", "x=x", "y=y", "heading=heading", "frequency=B [mT]", **UP),
        r"the unit mT of 'B \[mT\]' is none of frequency: state --units frequency=Hz",
    ),
    "inches": (
        table("t [s],x [inch],y [inch]", lambda i: (i / 10, i, 1)),
        mapped(t="t [s]", x="x [inch]", y="y [inch]"),
        r"the unit inch of 'x \[inch\]' is none of x: state --units x=um",
    ),
    "axes of different units": (
        table("t [s],x [um],y [mm]", lambda i: (i / 10, i, 1)),
        mapped(t="t [s]", x="x [um]", y="y [mm]"),
        r"state x in um and y in mm; write both in one unit, or state .*--units x=um",
    ),
    "pixels beside micrometres": (
        table("t [s],x [px],y [um]", lambda i: (i / 10, i, 1)),
        mapped(t="t [s]", x="x [px]", y="y [um]"),
        r"state x in px and y in um",
    ),
    "negative frequencies": (REVERSED, settings(**UP), r"200 rows have a negative fr"),
    "runs below each other": (TWICE, NO_FRAME, r"name the column of runs or particles"),
    "millimetres read right, but apart": (
        table("t [s],x [mm],y [mm]", lambda i: (i / 10, i, 1)),
        mapped(t="t [s]", x="x [mm]", y="y [mm]"),
        r"check the unit of positions, or set --jump and --gap",
    ),
}


@pytest.mark.parametrize(
    ("content", "options", "message"), REFUSED.values(), ids=REFUSED
)
def test_a_wrong_convention_is_refused_with_its_remedy(
    checked, content, options, message
):
    with told(message):
        checked(content, options)


LOST = table("t,x,y", lambda i: (i / 10, *((-1, -1) if 5 < i < 9 else (i, 9))))
WIDE = table("t,x1,y1,x2,y2", lambda i: (i / 10, i, 1, i, 5))
SWAPPED = each_row(lambda t, x, y, h, f: (t, y, x, h, f), driven())
CLOCKWISE = each_row(lambda t, x, y, h, f: (t, x, y, -h, f), driven())
SAID = {
    "lost particles at a corner": (
        LOST,
        NO_FRAME,
        r"3 rows stand at exactly \(-1, -1\)",
    ),
    "one robot of several": (
        WIDE,
        mapped(t="t", x="x1", y="y1"),
        r"of x1, x2 only x1 is read: x=x\* y=y\* reads",
    ),
    "a column without its partner": (
        table("t,x1,y1,x2", lambda i: (i / 10, i, 1, i)),
        mapped(t="t", x="x*", y="y*"),
        r"2 columns like x\* and 1 like y\*: those without a partner are left out",
    ),
    "degrees that were stated as radians": (
        driven(degrees=True),
        settings(y="up", units=("x=um", "t=s", "heading=rad")),
        r"in radians explain \d+ % of the velocity, in degrees 100 %.*heading=deg",
    ),
    "headings that turn clockwise": (
        CLOCKWISE,
        settings(**UP),
        r"headings counted the other way 100 %; check --y",
    ),
    "x and y exchanged": (SWAPPED, settings(**UP), r"x and y are not exchanged"),
}


@pytest.mark.parametrize(("content", "options", "message"), SAID.values(), ids=SAID)
def test_what_looks_odd_is_said(checked, content, options, message):
    said = remarks(checked(content, options))
    assert [text for text in said if re.search(message, text)], said


def test_nothing_is_said_of_a_plain_recording(checked):
    assert len(remarks(checked(driven(), settings(**UP)))) == 1
    assert len(remarks(checked(driven(offset=0.3), settings(**UP)))) == 1


def test_stamps_of_a_clock_that_count_by_one_are_seconds(checked):
    data = checked(table("t,x,y", lambda i: (clock(i), i, 1)), NO_FRAME)
    assert data.units["t"] == "s"
    np.testing.assert_allclose(np.diff(data.times[0]), 1.0)


def test_headings_in_degrees_within_a_turn_are_found_by_the_motion(checked):
    """All headings lie within six degrees of zero, as radians would."""
    text = each_row(
        lambda t, x, y, h, f: (t, *_sway(t), 5 * np.sin(3 * t), 2), driven()
    )
    with pytest.raises(InputError, match=r"in degrees \d+ %: --units heading"):
        checked(text, settings(**UP))


def _sway(t):
    """A path along x whose heading swings by five degrees."""
    return 6 * t, -6 * np.radians(5) * (np.cos(3 * t) - 1) / 3
