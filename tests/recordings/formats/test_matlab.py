"""MATLAB: [x y frame id] of Crocker and Grier, and cells [t x y] of msdanalyzer."""

import h5py
import numpy as np
from hypothesis import given, settings
from scipy.io import savemat
from tests.defects import defects, told
from tests.recordings.synthetic import EXAMPLE, check, packed, rows_of, tracks

from pinav.recordings import Reading, labels, read_recording


def matrix(truth):
    return np.array(
        [[x, y, frame, float(name)] for name, frame, x, y in rows_of(truth)]
    )


def saved(**variables):
    return packed(savemat, variables)


def cells(truth):
    found = np.empty((len(truth), 1), object)
    for index, track in enumerate(truth):
        found[index, 0] = np.stack([track.frames, track.xs, track.ys], axis=1)
    return found


@settings(max_examples=20)
@given(truth=tracks(names=("1", "2", "3")))
def test_matrix_and_cells_come_back_whole(tmp_path_factory, truth):
    path = tmp_path_factory.mktemp("matlab") / "tracks.mat"
    path.write_bytes(saved(tr=matrix(truth), fps=20.0, note="a"))
    check(read_recording(path, Reading(fps=20.0, mpp=0.1)), truth, fps=20.0, mpp=0.1)
    wide = np.insert(matrix(truth), 2, 7.0, axis=1)  # brightness, radius...
    path.write_bytes(saved(anything=wide))
    check(read_recording(path, Reading(fps=20.0)), truth, fps=20.0)
    path.write_bytes(saved(tracks=cells(truth)))
    data = read_recording(path, Reading(units={"x": "um", "t": "s"}))
    check(data, truth)
    assert data.units == {"x": "um", "y": "um", "t": "s"}
    with h5py.File(path, "w", userblock_size=512) as file:
        file["tr"] = matrix(truth).T
    content = bytearray(path.read_bytes())
    content[:10] = b"MATLAB 7.3"
    path.write_bytes(content)
    check(read_recording(path, Reading(fps=20.0)), truth, fps=20.0)


def test_variable_can_be_chosen(read):
    content = saved(a=matrix(EXAMPLE), b=matrix(EXAMPLE[1:]))
    data = read(content, columns={"variable": "b"})
    assert [label["particle"] for label in labels(data)] == ["1"]
    assert data.provenance["variable"] == "b"


def put(row, column, value):
    changed = matrix(EXAMPLE)
    changed[row, column] = value
    return saved(tr=changed)


def bad_cell(column, value):
    changed = cells(EXAMPLE)
    changed[0, 0][1, column] = value
    return saved(tracks=changed)


SOUND = saved(tr=matrix(EXAMPLE))
EXTRA = np.array([np.ones((3, 5)), np.ones((2, 5))], object)
TWO = {name: matrix(EXAMPLE) for name in "ab"}
BAD = [
    (b"", r"the file is empty"),
    (SOUND[:300], r"damaged MATLAB file: .*; save it again"),
    (SOUND[:128], r"expected one matrix .* got no variables"),
    (saved(), r"expected one matrix \[x y frame id\] .* no variables"),
    (saved(tr=np.ones((4, 3))), r"expected one matrix .* tr \(4, 3\)"),
    (saved(tr=np.ones(7)), r"the longest of 1 segments"),
    (saved(tr=["abcde"]), r"expected one matrix .*; name it by columns"),
    (saved(**TWO), r"a \(7, 4\), b \(7, 4\); name it by columns=\{'variable': 'tr'\}"),
    (saved(tracks=EXTRA), r"expected .* or one cell array of \[t x y\], got tracks"),
    (saved(tr=np.ones((0, 4))), r"variable 'tr': no rows|expected one"),
    (put(1, 0, np.inf), r"'tr', row 2, column 'x': .* got 'inf'"),
    (put(1, 2, np.nan), r"'tr', row 2, column 'frame': .* got 'nan'"),
    (put(0, 2, -1), r"'tr', row 1, column 'frame': .* got -1"),
    (put(1, 2, 2.0), r"'tr', row 3, .*: frame 2 of .0. stands in variable .tr"),
    (put(1, 3, 0.5), r"'tr', row 2, column 'id': .* number, got 0.5"),
    (put(slice(None), 0, np.nan), r"the longest of 0 segments"),
    (bad_cell(0, np.nan), r"'tracks', cell 1, row 2, column 't'"),
    (
        bad_cell(0, -1.0),
        r"row 2, column 't': time -1 is before .* 0 of variable 'track",
    ),
    (bad_cell(0, 0.0), r"cell 1, row 2, .*: time 0 repeats the time 0"),
    (bad_cell(1, np.inf), r"cell 1, row 2, column 'x': .* 'inf'"),
    (b"MATLAB 4.2 file" + b"\1" * 600, r"damaged MATLAB file"),
]


@defects("content, message", BAD)
def test_damage_is_named_with_its_place(read, content, message):
    with told(rf"a\.mat: .*{message}"):
        read(content, name="a.mat")


def test_wrong_choice_of_variable_is_named(read):
    content = saved(a=np.ones((4, 2)))
    for name, message in (("b", "no variable 'b'; got a"), ("a", r"'a': expected a")):
        with told(message):
            read(content, columns={"variable": name})
