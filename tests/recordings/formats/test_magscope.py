"""MagScope workbooks: three dialects, joined on the frame number."""

import io
import sys
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from tests.defects import defects, told
from tests.recordings.synthetic import EXAMPLE, check, tracks, workbook

from pinav.recordings import Reading, labels, read_recording

ACTIONS = ["Frame", "Bx", "By", "Bz", "Alpha", "Gamma", "Rolling Frequency", "Psi"]
LATER = ["Gradient?", "Acoustic Frequency", "Sensor Bx", "Sensor By", "Sensor Bz"]
UNITS = (
    dict.fromkeys(("Bx", "By", "Bz"), "%")
    | dict.fromkeys(("Alpha", "Gamma", "Psi"), "rad")
    | dict.fromkeys(("Rolling Frequency", "Acoustic Frequency"), "Hz")
)
ROBOT = {
    "2024": ["Frame", "Times", "Pos X", "Pos Y", "Vel X", "Blur", "Path X", "Path Y"],
    "2024-12": ["Frame", "Time(s)", "Pos X (px)", "Pos Y (px)", "Vel X (um/s)"],
    "2025": ["Frame", "Time(s)", "Pos X (um)", "Pos Y (um)", "Acc X (um/s2)"],
}


def action(frame):
    """The row of a frame: its commands tell its number."""
    return [frame, 0.5, 0, 0, frame / 10, 1.5, frame + 1, 1.5, 0, 0, 1, 2, 3]


def sheets(truth, dialect="2024"):
    """The cells of a sound workbook, by sheet; one frame takes 1/8 s."""
    header = [*ACTIONS, *LATER]
    if dialect == "2025":
        header = [f"{n} ({UNITS[n]})" if n in UNITS else n for n in header]
    last = max(track.frames[-1] for track in truth)
    content = {"Magnetic Field Actions": [header, *map(action, range(last + 1))]}
    for number, track in enumerate(truth, start=1):
        rows = [ROBOT[dialect]]
        steps = np.diff(track.frames, prepend=track.frames[0] - 1) / 8
        times = steps if dialect == "2024" else np.array(track.frames) / 8
        for time, frame, x, y in zip(
            times.tolist(), track.frames, track.xs, track.ys, strict=True
        ):
            rows.append([frame, time, x, y, 9.0, 100])
        content[f"Robot {number}"] = [row[: len(rows[0])] for row in rows]
    return content


@pytest.mark.parametrize("dialect", ROBOT)
@settings(max_examples=8)
@given(truth=tracks(names=("1", "2")))
def test_every_dialect_comes_back_whole(tmp_path_factory, dialect, truth):
    path = tmp_path_factory.mktemp("magscope") / "run.xlsx"
    path.write_bytes(workbook(sheets(truth, dialect)))
    mpp = None if dialect == "2025" else 0.345
    data = read_recording(path, Reading(mpp=mpp))
    if dialect == "2024":  # whose time starts with the robot
        starts = [track.frames[0] / 8 for track in truth]
    else:
        starts = [0.0] * len(truth)
    for piece, track, start in zip(data, truth, starts, strict=True):
        frames = np.array(track.frames)
        assert_array_equal(piece.times, frames / 8 - start)
        expected = np.stack([track.xs, -np.array(track.ys)], axis=1)
        scaled = (mpp or 1.0) * expected  # a workbook keeps 16 digits
        assert_allclose(piece.states, scaled, rtol=1e-15)
        assert_array_equal(piece.commands["frequency"], frames + 1)
        assert_allclose(piece.commands["heading"], frames / 10)
        field = 0.005 if dialect == "2025" else 0.5
        assert_allclose(piece.commands["field_x"], field)
    assert [label["particle"] for label in labels(data)] == [t.name for t in truth]
    assert set(data.units.values()) == {"um", "s", "Hz", "rad", "1"}


def test_commands_are_joined_on_the_frame_not_on_the_row(read):
    """Either sheet repeats and drops rows."""
    content = sheets(EXAMPLE)
    name = "Magnetic Field Actions"
    header, *rows = content[name]
    content[name] = [header, rows[0], rows[0], rows[1], rows[3], rows[2]]
    robot = content["Robot 1"]
    content["Robot 1"] = [*robot[:2], robot[1], *robot[2:], [None] * 6 + [3.0, 4.0]]
    data = read(workbook(content), name="a.xlsx")
    assert_array_equal(data.trajectory(0).commands["frequency"], [1, 2, 3, 3])
    note = "1 rows without an action of their frame keep the last one"
    assert data.provenance["notes"] == [note]
    assert data.provenance["rows without a command"] == 1


def test_scale_of_the_workbook_is_taken_unless_given(read):
    content = sheets(EXAMPLE, "2024-12")
    for number in "12":
        rows = content[f"Robot {number}"]
        rows[0] = [*rows[0], "pix2metric"]
        rows[1:] = [[*row, 2.5] for row in rows[1:]]
    data = read(workbook(content), name="a.xlsx")
    assert_allclose(data.states[0, 1], [0.8, -0.2])
    assert "scale 0.4 um/px from the column pix2metric" in data.provenance["notes"]
    given = read(workbook(content), name="a.xlsx", mpp=1.0)
    assert_allclose(given.states[0, 1], [2.0, -0.5])
    content["Robot 1"][1][-1] = 3.0
    with told(r"'pix2metric': expected one number > 0"):
        read(workbook(content), name="a.xlsx")


def test_workbook_without_actions_has_no_commands(read):
    content = sheets(EXAMPLE)
    del content["Magnetic Field Actions"]
    data = read(workbook(content), name="a.xlsx")
    assert data.commands == {}
    assert "the recording has no commands" in data.provenance["notes"][0]
    shifted = [t._replace(name=str(i)) for i, t in enumerate(EXAMPLE, start=1)]
    assert [label["particle"] for label in labels(data)] == [t.name for t in shifted]
    data = read(workbook(sheets(EXAMPLE)), name="a.xlsx", fps=4.0)
    check(data, [t._replace(name=str(i + 1)) for i, t in enumerate(EXAMPLE)], fps=4.0)


def cell(sheet, row, column, value):
    """A sound workbook, but for a cell; rows and columns as Excel counts them."""
    return lambda content: content[sheet][row - 1].__setitem__(column - 1, value)


def cut(rows, *sheets):
    return lambda content: [content[sheet].__delitem__(rows) for sheet in sheets]


R, S, A = "Robot 1", "Robot 2", "Magnetic Field Actions"
MICRONS = ["Pos X (um)", "Pos Y (um)"]
BAD = [
    (
        lambda content: [content.pop(robot) for robot in (R, S)],
        rf"sheets {A}: expected 'Robot 1' and so on",
    ),
    (cut(slice(0, None), R), r"sheet 'Robot 1', row 1: column 'Frame' is missing"),
    (cut(slice(0, None), A), r"Actions', row 1: column 'Frame' is missing; got"),
    (cut(slice(1, None), R), r"sheet 'Robot 1': no rows below the header"),
    (cut(slice(1, None), A), r"Actions': no rows below the header"),
    (cell(R, 1, 1, "Fr."), r"'Robot 1', row 1: column 'Frame' is missing"),
    (cell(R, 1, 2, "Clock"), r"sheet 'Robot 1': column 'Time' is missing"),
    (cell(R, 1, 3, "X"), r"sheet 'Robot 1': column 'Pos X' is missing; got Fr"),
    (cell(R, 1, 4, "Y"), r"sheet 'Robot 1': column 'Pos Y' is missing"),
    (cell(R, 1, 4, "Pos X"), r"row 1: column 'Pos X' stands twice"),
    (cell(A, 1, 5, "Alpha (mT)"), r"units: expected head"),
    (
        lambda content: content[R][0].__setitem__(slice(2, 4), MICRONS),
        r"positions in .* and .*; bring them to one unit",
    ),
    (cell(R, 3, 3, "lost"), r"'Robot 1', row 3, column 'Pos X': .*'lost'"),
    (cell(R, 3, 4, "inf"), r"row 3, column 'Pos Y': .* got 'inf'"),
    (cell(R, 3, 2, None), r"row 3, column 'Times': .* an empty cell"),
    (cell(R, 3, 2, -0.1), r"row 3, column 'Times': .* got -0.1"),
    (cell(R, 3, 1, None), r"row 3, column 'Frame': .* an empty cell"),
    (cell(R, 2, 1, -1), r"row 2, column 'Frame': .* >= 0, got -1"),
    (
        cell(R, 3, 1, 2),
        r"'Robot 1', row 4, .*: frame 2 of '1' stands in sheet 'Robot 1'",
    ),
    (cell(A, 3, 7, "fast"), r"Actions', row 3, column 'Rolling Fr.*': .* got 'fast'"),
    (cut(slice(2, None), R, S), r"the longest of 2 segments has a single position"),
]


@defects("change, message", BAD)
def test_damage_is_named_with_its_place(read, change, message):
    content = sheets(EXAMPLE)
    change(content)
    with told(rf"a\.xlsx: .*{message}"):
        read(workbook(content), name="a.xlsx")


def zipped(**files):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "/") + ".xml", content)
    return file.getvalue()


BAD_BYTES = [
    (workbook(sheets(EXAMPLE))[:-200], r"damaged workbook: .*; copy it"),
    (workbook(sheets(EXAMPLE))[:3000], r"damaged workbook|not known"),
    (zipped(a="<a/>"), r"the format is not known"),
    (zipped(xl__workbook="<a/>"), r"damaged workbook: .*; copy it"),
]


@defects("content, message", BAD_BYTES)
def test_truncated_workbook_is_refused(read, content, message):
    with told(rf"a\.xlsx: .*({message})"):
        read(content, name="a.xlsx")


@pytest.mark.slow
def test_a_real_workbook_reproduces_its_tidy_file(recording):
    """Positions within 5e-4 px, times within 5e-6 s, commands joined on the frame."""
    folder = "magscope_roller_circles"
    workbook = recording(f"{folder}/idle_action_data.xlsx")
    raw = read_recording(workbook, Reading(mpp=0.345))
    known = read_recording(recording(f"{folder}/idle_brownian.csv.gz"))
    runs = [label["run"] for label in labels(known)]
    known = known.select([i for i, run in enumerate(runs) if run == "idle_20240410"])
    assert len(raw) == len(known) == 4
    for own, other in zip(raw, known, strict=True):
        np.testing.assert_allclose(own.times, other.times, atol=5e-6)
        np.testing.assert_allclose(own.states, other.states, atol=5e-4 * 0.345)
        for name in ("frequency", "heading", "gamma"):
            one, two = own.commands[name], other.commands[name]
            np.testing.assert_allclose(one, two, atol=1e-3)


def test_missing_package_is_named_with_its_remedy(read, monkeypatch):
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    message = r"a\.xlsx: this format needs the package openpyxl; install pinav\[record"
    with told(message):
        read(zipped(xl__workbook="<a/>"), name="a.xlsx")
