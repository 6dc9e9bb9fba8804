"""DeepLabCut, as CSV and as HDF5 that pandas wrote."""

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from tests.defects import defects, told
from tests.recordings.synthetic import EXAMPLE, check, tracks

from pinav.recordings import Reading, labels, read_recording

SCORER = "DLC_resnet50_robots"


def table(truth, *, likelihood=0.9, owner=None):
    """What DeepLabCut writes: rows are frames, lost ones of low likelihood."""
    count = max(track.frames[-1] for track in truth) + 1
    columns = {}
    for track in truth:
        name = (SCORER, *([owner] if owner else []), f"part {track.name}")
        rows = np.full((count, 3), [5.0, 5.0, 0.1])
        rows[track.frames] = np.stack(
            [track.xs, track.ys, np.full(len(track.xs), likelihood)], axis=1
        )
        for coord, values in zip(("x", "y", "likelihood"), rows.T, strict=True):
            columns[(*name, coord)] = values
    frame = pd.DataFrame(columns)
    levels = ["scorer", *(["individuals"] if owner else []), "bodyparts", "coords"]
    frame.columns = frame.columns.set_names(levels)
    return frame


def serialised(names):
    """The list of tuples as protocol 0 writes it, with its memory of words."""
    known, parts = {}, [b"(lp0\n"]
    for words in names:
        parts.append(b"(")
        for word in words:
            if word in known:
                parts.append(b"g%d\n" % known[word])
            else:
                known[word] = 3 * len(known) + 1
                parts.append(b"V%s\np%d\n" % (word.encode(), known[word]))
        parts.append(b"tp%d\na" % (10_000 + len(parts)))
    return b"".join([*parts, b"."])


def to_hdf5(frame, path):
    """The layout of pandas' table format, by which DeepLabCut writes its tables."""
    kinds = [("index", "<i8"), ("values_block_0", "<f8", (frame.shape[1],))]
    rows = np.zeros(len(frame), kinds)
    rows["index"], rows["values_block_0"] = frame.index, frame.to_numpy()
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = np.bytes_(b"frame_table")
        table = group.create_dataset("table", data=rows, maxshape=(None,))
        table.attrs["values_block_0_kind"] = np.bytes_(serialised(list(frame.columns)))


def compared(data, truth, prefix="part "):
    """Lost frames are rows without observation."""
    assert [label["particle"] for label in labels(data)] == [
        f"{prefix}{track.name}" for track in truth
    ]
    for piece, track in zip(data, truth, strict=True):
        frames = np.arange(track.frames[0], track.frames[-1] + 1)
        np.testing.assert_array_equal(piece.times, frames / 10)
        seen = np.isin(frames, track.frames)
        np.testing.assert_array_equal(piece.observed, np.stack([seen, seen], axis=1))
        expected = np.stack([track.xs, -np.array(track.ys)], axis=1)
        np.testing.assert_array_equal(piece.states[seen], expected)


@pytest.mark.parametrize("owner", [None, "robot1"])
@settings(max_examples=10)
@given(truth=tracks())
def test_csv_and_hdf5_come_back_whole(tmp_path_factory, owner, truth):
    folder = tmp_path_factory.mktemp("dlc")
    frame = table(truth, owner=owner)
    prefix = f"{owner} part " if owner else "part "
    frame.to_csv(folder / "a.csv")
    compared(read_recording(folder / "a.csv", Reading(fps=10.0)), truth, prefix)
    to_hdf5(frame, folder / "a.h5")
    compared(read_recording(folder / "a.h5", Reading(fps=10.0)), truth, prefix)


def test_likelihood_decides_what_is_lost(tmp_path):
    frame = table(EXAMPLE, likelihood=0.5)
    frame.to_csv(tmp_path / "a.csv")
    with told("the longest of 0 segments"):
        read_recording(tmp_path / "a.csv")
    data = read_recording(tmp_path / "a.csv", Reading(likelihood=0.5))
    assert "3 positions of likelihood < 0.5 are lost" in data.provenance["notes"]
    whole = [track for track in EXAMPLE if track.name == "1"]
    check(data.select([1]), [whole[0]._replace(name="part 1")])


LINES = [
    "scorer,D,D,D",
    "bodyparts,nose,nose,nose",
    "coords,x,y,likelihood",
    "0,1.0,2.0,0.9",
    "1,1.5,2.5,0.9",
    "2,2.0,3.0,0.9",
]


def changed(line, text):
    """The file with another text in a line, or without it."""
    lines = [*LINES]
    lines[line - 1 : line] = [] if text is None else [text]
    return "\n".join(lines)


BAD = [
    ("\n".join(LINES[:3]), r"line \d: the header is all there is"),
    (changed(1, None), r"line 1: expected the header row 'scorer', got 'b"),
    (changed(2, None), r"line 2: .* 'bodyparts', got 'coords'; export"),
    (changed(3, None), r"line 3: .* row 'coords', got '0'"),
    (changed(2, "bodyparts,nose"), r"line 3: expected 1 cells, got"),
    (changed(3, "coords"), r"line 3: expected 3 cells, got 0; is the"),
    (changed(3, "coords,z,y,likelihood"), r"column 'x' of 'nose' is mis"),
    (changed(3, "coords,x,y,p"), r"column 'likelihood' of 'nose'"),
    (changed(3, "coords,x,x,likelihood"), r"header: 'nose' has 'x' twice"),
    (changed(5, "1,a,2.5,0.9"), r"'nose', line 5, column 'x': .* got 'a'"),
    (changed(5, "1,1.5,inf,0.9"), r"'nose', line 5, column 'y': .* 'inf'"),
    (
        changed(6, "2,2.0,3.0,90"),
        r"'nose', line 6, column 'likelihood': expected from 0 to 1, got 90; are the",
    ),
    (changed(6, "2,2.0,3.0,-1"), r"line 6, .* to 1, got -1"),
    (changed(5, "img1,1,2,0.9"), r"line 5, column 'frame': .* 'img1'"),
    (
        changed(6, "1,1,2,0.9"),
        r"'nose', line 6, column 'frame': frame 1 of 'nose' stands in 'nose', line 5",
    ),
    (changed(6, "2,2.0"), r"line 6: expected 4 cells, .* got 2"),
    ("\n".join(LINES).replace(",", "|"), r"line 1: .* 'scorer'"),
]


@defects("content, message", BAD)
def test_damaged_csv_is_named_with_its_place(read, content, message):
    content = content.encode("utf-8", "surrogateescape")
    with told(rf"tracks\.csv: .*{message}"):
        read(content, format="deeplabcut")


@pytest.fixture
def hdf5(tmp_path):
    """A sound file, and a function that reads it after a change to it."""
    path = tmp_path / "a.h5"
    to_hdf5(table(EXAMPLE), path)

    def change_and_read(change):
        with h5py.File(path, "r+") as file:
            change(file)
        return read_recording(path)

    return change_and_read


KEY, NAMES = "df_with_missing", "values_block_0_kind"


def name_columns(content):
    return lambda file: file[KEY]["table"].attrs.update({NAMES: np.bytes_(content)})


def set_cells(field, row, value):
    def change(file):
        rows = file[KEY]["table"][...]
        rows[field][row] = value
        file[KEY]["table"][...] = rows

    return change


def bare_array(file):
    del file[KEY]
    file["x"] = np.ones(3)


CALL = b"cos\nsystem\n(S'echo'\ntR."
"""Serialised objects may hold calls; nothing of a file is ever called."""
BAD_HDF5 = [
    (name_columns(CALL), r"cannot be read \(unexpected name os.system"),
    (name_columns(b"I3\n."), r"expected columns named by sc"),
    (name_columns(b"Va\n."), r"expected columns named by sc"),
    (name_columns(b"(lp0\n(Va"), r"names of columns cannot be read"),
    (name_columns(b"(lp0\n."), r"0 names for 6 columns"),
    (name_columns(b"(l(Va\nVb\nta."), r"expected columns named by scorer"),
    (name_columns(b"g7\n."), r"names of columns cannot be read"),
    (lambda file: file[KEY]["table"].attrs.pop(NAMES), r"damaged HDF5 file"),
    (lambda file: file.pop(KEY), r"keys none: expected one table of pandas"),
    (lambda file: file.copy(KEY, "again"), r"keys again, df_with_missing: exp"),
    (bare_array, r"keys x: expected one table of pandas"),
    (
        lambda file: file[KEY]["table"].resize((0,)),
        r"table: expected one block of numbers with rows, got 1 bl",
    ),
    (set_cells("index", 1, -1), r"row 1, column 'frame': .* got -1"),
    (set_cells("index", 2, 1), r"row 2, column 'frame': frame 1 of"),
    (set_cells("values_block_0", 1, np.inf), r"'part 0', row 1, .*'inf'"),
    (set_cells("values_block_0", 1, 5.0), r"row 1, .* from 0 to 1, got 5"),
    (set_cells("values_block_0", slice(None), np.nan), r"longest of 0 seg"),
]


@defects("change, message", BAD_HDF5)
def test_damaged_hdf5_is_named(hdf5, change, message):
    with told(rf"a\.h5: .*{message}"):
        hdf5(change)


@pytest.mark.parametrize("end", [9, 600, 3000])
def test_hdf5_cut_short_is_refused(hdf5, tmp_path, end):
    path = tmp_path / "a.h5"
    path.write_bytes(path.read_bytes()[:end])
    with told(r"a\.h5: damaged HDF5 file"):
        read_recording(path)
