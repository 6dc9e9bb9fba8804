"""Conventions that a file has wrong, and damage: refused, or said; never in silence."""

import re

import numpy as np
import pytest
from tests.defects import told
from tests.recordings.formats.test_magscope import sheets
from tests.recordings.synthetic import EXAMPLE, npy, workbook

from pinav.recordings import Reading
from pinav.recordings.conventions import doubts, heading_remark, remarks

MAP = ("t=t", "x=x", "y=y", "heading=heading", "frequency=f")


def driven(*, mirror=False, offset=0.0, degrees=False, heading="heading", rows=200):
    """A robot that follows its heading at 3 um a cycle, y up, as a table."""
    t = np.arange(rows) / 20
    angle = 1.3 * np.sin(0.7 * t) + 0.4 * t
    frequency = 2 + np.sin(0.3 * t)
    step = 3.0 * frequency * np.exp(1j * (angle + offset)) / 20
    path = np.concatenate([[0], np.cumsum(step)[:-1]])
    angle = np.angle(np.exp(1j * angle))
    y = -path.imag if mirror else path.imag
    shown = np.degrees(angle) if degrees else angle
    lines = [f"t,x,y,{heading},f"]
    table = zip(t, path.real, y, shown, frequency, strict=True)
    lines += [",".join(f"{value:.6g}" for value in row) for row in table]
    return "\n".join(lines)


def settings(*columns, **options):
    """How a table is read, with names and units as words such as x=X."""
    units = dict(word.split("=") for word in options.pop("units", ()))
    named = dict(word.split("=") for word in columns or MAP)
    return Reading(columns=named, units=units or None, **options)


def plain(**options):
    """Columns by the names t, x and y."""
    return settings("t=t", "x=x", "y=y", **options)


UM = {"units": ("x=um", "t=s")}


def far_frames():
    content = sheets(EXAMPLE)
    for row in content["Magnetic Field Actions"][1:]:
        row[0] += 1000
    return workbook(content)


PLAIN = "t,x,y\n0,1,2\n0.1,2,3\n0.2,3,4\n"
NO_FRAME = plain()
HOLES = "t,x,y,f,heading\n0,1,2,,\n0.1,2,3,,\n0.2,3,4,,\n"
TWO = "p,t,x,y,f\n1,0,0,0,1\n1,1,0,0,1\n2,0,0,0,\n2,1.5,0,0,\n"
TWO_SHEETS = workbook(
    {"Sheet": [["t", "x", "y"], [0, 1, 2], [0.1, 2, 3]], "notes": [["anything"]]}
)


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
SHEET = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100)
UNCALIBRATED = "TRACK_ID,POSITION_X,POSITION_Y,POSITION_T,FRAME\n0,1,1,0,0\n0,2,2,1,1\n"
LOST_CLOCK = "t,x,y\n12:00:00,1,2\n12:00:99,2,3\n12:00:02,3,4\n"
STEP = r"advance by {} from row to row"
WRONG_PLAIN = {
    "whole numbers for seconds": (
        "t,x,y\n0,1,2\n1,2,3\n2,3,4\n",
        r"count by one, as frames.*--units t=s",
    ),
    "several sheets": (TWO_SHEETS, r"sheets 'Sheet', 'notes': give one of them"),
    "array of one axis": (npy(np.ones(4)), r"rows and columns, got shape"),
    "damaged clock": (
        LOST_CLOCK,
        r"line 3, column 't': expected a time of day .* got '12:00:99'",
    ),
    "many bad rows": (
        "t,x,y\n0,a,2\n1,b,3\n2,3,4\n3.5,4,4\n",
        r"line 2, column 'x': expected a finite number, got 'a'",
    ),
    "every second frame for seconds": (COUNTED, STEP.format(2)),
    "days since 1900": (
        table("t,x,y", lambda i: (45000 + i * 40 / 86.4e6, i, 1)),
        STEP.format("4.63e-07"),
    ),
    "stamps of twelve hours": (
        table("t,x,y", lambda i: (f"{clock(i)} PM", i, 1)),
        r"write stamps of a clock as 13:30:01.5",
    ),
    "days before months": (
        table("t,x,y", lambda i: (f"31.12.2024 {clock(i)}", i, 1)),
        r"write stamps of a clock as .*2024-05-01T13:30:01",
    ),
    "runs below each other": (TWICE, r"name the column of runs or particles"),
}
WRONG_UNKNOWN = {
    "frames without a rate": (
        "frame,particle,x,y\n0,1,1,2\n1,1,2,3\n",
        r"numbers of frames: give --fps",
    ),
    "TrackMate never calibrated": (UNCALIBRATED, r"numbers of frames: give --fps"),
    "frames that never meet": (far_frames(), r"meet none of the"),
    "log alone": ("t_s,angle_rad\n0,1\n1,2\n", r"a log of commands alone is no"),
    "unknown names": (
        "Zeit;Lage\n0;1\n1;2\n",
        r"columns Zeit, Lage are: start from --columns t=Zeit x=Lage y=\?",
    ),
    "old workbook": (SHEET, r"Excel before 2007: save it as \.xlsx"),
    "array of unnamed columns": (
        npy(np.ones((4, 3))),
        r"columns 0, 1, 2 are: start from --columns t=0 x=1 y=2",
    ),
}
WRONG_DRIVEN = {
    "degrees without a unit": (
        driven(degrees=True),
        r"headings reach 1\d\d.*--units heading=deg",
    ),
    "negative frequencies": (REVERSED, r"200 rows have a negative fr"),
}
LOOSE = PLAIN + "".join(f"{t / 10},1,1\n" for t in range(3, 40)) + "9,wall,1\n"
WRONG = {
    **{name: (text, NO_FRAME, said) for name, (text, said) in WRONG_PLAIN.items()},
    **{name: (text, Reading(), said) for name, (text, said) in WRONG_UNKNOWN.items()},
    **{n: (text, settings(**UP), said) for n, (text, said) in WRONG_DRIVEN.items()},
    "y flipped by default": (
        driven(),
        settings(**UM),
        r"mirrors.*give --y up, or --y down where y is",
    ),
    "one particle without commands": (
        TWO,
        settings("t=t", "x=x", "y=y", "frequency=f", "particle=p"),
        r"particle 2: no row has a frequency, which does not mean .* off",
    ),
    "no such sheet": (
        TWO_SHEETS,
        plain(sheet="Robot"),
        r"sheet: expected one of 'Sheet', 'notes'; got 'Robot'",
    ),
    "no such run": (PLAIN, plain(runs=("b",)), r"runs: expected some of a; got 'b'"),
    "no such particle": (
        PLAIN,
        plain(particles=("7",)),
        r"expected some of 1; got '7'",
    ),
    "stars in x alone": (
        "t,x1,y1\n0,1,2\n1,2,3\n",
        settings("t=t", "x=x*", "y=y1"),
        r"a star stands for the particles in x and y both",
    ),
    "stars without match": (
        PLAIN,
        settings("t=t", "x=pos*", "y=pot*"),
        r"no columns like pos\* and pot\*; got t, x, y",
    ),
    "array of objects": (
        npy(np.array([{}], object)),
        Reading(format="table"),
        r"damaged array: .*without objects|columns: x",
    ),
    "bad row, strict": (
        LOOSE,
        plain(strict=True),
        r"line 42, column 'x': .* got 'wall'",
    ),
    "options with a file of pinav": (
        PLAIN,
        Reading(sheet="a"),
        r"sheet: .* holds trajectories of pinav",
    ),
    "sheet of a text file": (PLAIN, plain(skip=9), r"skip|line 10: expected the names"),
    "milliseconds without a unit": (
        each_row(lambda t, *rest: (1000 * t, *rest), driven()),
        settings(y="up", units=("x=um",)),
        STEP.format(50) + r".*state --units t=ms",
    ),
    "a field for a frequency": (
        FIELD,
        settings("t=t", "x=x", "y=y", "heading=heading", "frequency=B [mT]", **UP),
        r"the unit mT of 'B \[mT\]' is none of frequency: state --units frequency=Hz",
    ),
}
LENGTHS = {
    ("inch", "inch"): r"the unit inch of 'x \[inch\]' is none of x: state --units x=um",
    (
        "um",
        "mm",
    ): r"x in um and y in mm; write both in one unit, or state .*--units x=um",
    ("px", "um"): r"state x in px and y in um",
    ("mm", "mm"): r"check the unit of positions, or set --jump and --gap",
}
for (along, across), said in LENGTHS.items():
    names = {"t": "t [s]", "x": f"x [{along}]", "y": f"y [{across}]"}
    text = table(",".join(names.values()), lambda i: (i / 10, i, 1))
    WRONG[f"x in {along}, y in {across}"] = (text, mapped(**names), said)


@pytest.mark.parametrize(("content", "options", "message"), WRONG.values(), ids=WRONG)
def test_no_wrong_convention_is_accepted_in_silence(checked, content, options, message):
    """Where options are named, those of other commands than inspect are told, too."""
    with told(message) as caught:
        checked(content, options)
    said, elsewhere, _ = str(caught.value).partition("; such options are those of")
    assert bool(elsewhere) == bool(re.search("--[a-z]", said))


def test_the_right_option_settles_each_doubt(checked):
    deg = settings(y="up", units=("x=um", "t=s", "heading=deg"))
    data = checked(driven(degrees=True), deg)
    np.testing.assert_allclose(data.commands["heading"][0, 1], 0.0653, atol=1e-3)
    assert doubts(checked(driven(), settings(y="up", **UM))) == []
    assert doubts(checked(driven(mirror=True), settings(**UM))) == []
    down = checked(driven(), settings(y="down", **UM))  # as the user says
    assert down.provenance["positions"]["y flipped"]
    text = driven(degrees=True, heading="heading [deg]").replace(
        "t,x,y", "t/ms,x (mm),y"
    )
    data = checked(text, settings(*MAP[:4], y="up", jump=1e4))
    assert data.units["x"] == "um"
    assert data.units["t"] == "s"
    np.testing.assert_allclose(data.times[0, 1], 5e-5)
    np.testing.assert_allclose(data.commands["heading"][0, 1], 0.0653, atol=1e-3)


def test_an_axis_in_place_of_a_heading_is_said_and_nothing_else(checked):
    options = settings(y="up", **UM)
    turned = checked(driven(offset=np.pi / 2), options)
    assert "--heading-offset 1.5708 makes it" in heading_remark(turned)
    assert heading_remark(checked(driven(), options)) == ""
    lines = remarks(turned)
    assert lines[0] == "read as: positions in um, y as it is; times in s"
    assert len(remarks(checked(driven(), settings(**UP)))) == 1
    assert len(remarks(checked(driven(offset=0.3), settings(**UP)))) == 1


def test_the_rate_that_is_given_is_not_asked_for(read):
    for fps in (None, 9.0):
        notes = read(UNCALIBRATED, fps=fps).provenance["notes"]
        assert any("give fps" in note for note in notes) == (fps is None)


def test_bad_rows_are_left_out_and_counted(read):
    rows = [f"{t / 10},{t},1" for t in range(40)]
    rows[7], rows[9], rows[20] = "0.7,wall,1", "0.2,1,1", "2.0,1"
    text = "\n".join(["t,x,y", *rows])
    data = read(text, strict=False, columns={n: n for n in "txy"})
    faults = data.provenance["bad rows left out"]
    places = [re.match(r"line \d+", fault)[0] for fault in faults]
    assert places == ["line 22", "line 9", "line 11"]
    assert data.lengths.tolist() == [37]


def test_a_swap_in_a_workbook_costs_one_row(read):
    """One bad row does not block the workbook and its other robot."""
    content = sheets(EXAMPLE)
    header, *rows = content["Robot 1"]
    many = [[i, 0.04, 1.0, 2.0, *rows[0][4:]] for i in range(30)]
    content["Robot 1"] = [header, *many, [12, 0.04, 300.0, 9.0, *rows[0][4:]]]
    data = read(workbook(content), name="a.xlsx", strict=False)
    assert len(data) == 2
    assert "frame 12 of '1' stands in" in data.provenance["bad rows left out"][0]
    with told("frame 12 of '1' stands in"):
        read(workbook(content), name="a.xlsx")


def test_times_that_hold_intervals_are_added_up(read):
    content = sheets(EXAMPLE, "2024-12")
    for name in ("Robot 1", "Robot 2"):
        for row in content[name][1:]:
            row[1] = 0.05
    data = read(workbook(content), name="a.xlsx")
    np.testing.assert_allclose(np.diff(data.times[0])[:3], 0.05)
    assert "intervals: they were added up" in data.provenance["notes"][-1]


def test_tables_without_units_are_split_at_jumps(read):
    steps = np.random.default_rng(0).normal(size=60)
    steps[30] = 700.0
    lines = [f"{t / 10},{x},0" for t, x in enumerate(np.cumsum(steps))]
    data = read("t,x,y\n" + "\n".join(lines), columns={n: n for n in "txy"})
    assert data.lengths.tolist() == [30, 30]
    whole = read("t,x,y\n" + "\n".join(lines[:30]), columns={n: n for n in "txy"})
    assert len(whole) == 1


def test_an_empty_command_is_no_command(read):
    columns = {"t": "t", "x": "x", "y": "y", "frequency": "f", "heading": "heading"}
    data = read(HOLES, columns=columns)
    assert data.commands == {}
    assert "the column of frequency is empty" in data.provenance["notes"][0]


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


def test_stamps_of_a_clock_that_count_by_one_are_seconds(checked):
    data = checked(table("t,x,y", lambda i: (clock(i), i, 1)), NO_FRAME)
    assert data.units["t"] == "s"
    np.testing.assert_allclose(np.diff(data.times[0]), 1.0)


def test_headings_in_degrees_within_a_turn_are_found_by_the_motion(checked):
    """All headings lie within six degrees of zero, as radians would."""
    text = each_row(
        lambda t, x, y, h, f: (t, *_sway(t), 5 * np.sin(3 * t), 2), driven()
    )
    with told(r"in degrees \d+ %: --units heading"):
        checked(text, settings(**UP))


def _sway(t):
    """A path along x whose heading swings by five degrees."""
    return 6 * t, -6 * np.radians(5) * (np.cos(3 * t) - 1) / 3
