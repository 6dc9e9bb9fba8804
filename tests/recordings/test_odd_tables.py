"""Tables as spreadsheets, loggers and other programs leave them."""

import datetime
import pickle

import numpy as np
import pandas as pd
import pytest
from tests.recordings.synthetic import npy, workbook

from pinav.errors import InputError
from pinav.recordings import Reading
from pinav.recordings.table import example_of_columns

TXY = {"t": "t", "x": "x", "y": "y"}
UM = {"units": {"x": "um", "t": "s"}}
PLAIN = "t,x,y\n0,1,2\n0.5,2,3\n1,3,4\n"
SPACED = "t;x;y\n0;1 001,5;2\n0.5;1 002,5;3\n1;1 003,5;4\n"
ELAPSED = "t,x,y\n0:59.5,1,2\n1:00.0,2,3\n1:00.5,3,4\n"
WIDE = "t\tx\ty\r\n0\t1\t2\r\n0.5\t2\t3\r\n1\t3\t4\r\n"
ODD = {
    "a delimiter at the end of each row": PLAIN.replace("\n", ",\n").replace(
        "y,\n", "y\n"
    ),
    "UTF-16": WIDE.encode("utf-16"),
    "minutes and seconds": ELAPSED,
    "thousands with commas": 't,x,y\n0,"1,001.0",2\n0.5,"1,002.0",3\n1,"1,003.0",4\n',
    "thousands with apostrophes": "t;x;y\n0;1'001.0;2\n0.5;1'002.0;3\n1;1'003.0;4\n",
    "thousands with narrow spaces": SPACED.replace(" ", "\u202f").replace("0.5", "0,5"),
}


@pytest.mark.parametrize("content", ODD.values(), ids=ODD)
def test_an_odd_table_is_read(read, content):
    data = read(content, columns=TXY, **UM)
    piece = data.trajectory(0)
    np.testing.assert_allclose(piece.times - piece.times[0], [0, 0.5, 1])
    np.testing.assert_allclose(piece.states[:, 0] % 1000 // 1, [1, 2, 3])
    np.testing.assert_allclose(-piece.states[:, 1], [2, 3, 4])


def test_a_row_of_units_may_hold_some_that_are_not_known(read):
    text = "t,x,y,area\ns,mm,mm,cm²\n0,0.001,0.002,1\n0.5,0.002,0.003,1\n"
    data = read(text, columns=TXY)
    assert (data.units["x"], data.units["t"]) == ("um", "s")
    np.testing.assert_allclose(data.trajectory(0).states[:, 0], [1, 2])
    data = read("t;x;y\n0;1,001;2\n1;1,002;3\n", columns=TXY, **UM)
    np.testing.assert_allclose(data.trajectory(0).states[:, 0], [1.001, 1.002])
    text = '"t" "x" "y"\n"1" 0 1 2\n"2" 0.5 2 3\n"3" 1 3 4\n'
    data = read(text, columns=TXY, **UM)
    np.testing.assert_allclose(data.trajectory(0).states[:, 0], [1, 2, 3])


@pytest.mark.parametrize("word", ["-", "--", "?", "n.a.", "#N/A"])
def test_words_for_a_lost_position_are_known(read, word):
    row = f"0.5,{word},{word}"
    data = read(PLAIN.replace("0.5,2,3", row), columns=TXY, **UM)
    assert data.trajectory(0).observed.all(axis=1).tolist() == [True, False, True]


def test_a_file_of_another_make_is_refused_as_such(read):
    with pytest.raises(InputError, match=r"line 2, column 't': .* got '1:30'"):
        read("t,x,y\n1:30,1,2\n1:31,2,3\n", columns=TXY, **UM)
    with pytest.raises(InputError, match=r"not known \(JSON, whose layout"):
        read('{"tracks": []}', name="a.json")


def test_durations_of_a_workbook_are_times(read):
    half = datetime.timedelta(seconds=0.5)
    rows = [["t", "x", "y"], *([i * half, 1.0 + i, 2.0 + i] for i in range(3))]
    data = read(workbook({"a": rows}), name="a.xlsx", columns=TXY, **UM)
    np.testing.assert_allclose(data.trajectory(0).times, [0, 0.5, 1])


def test_columns_may_be_named_first_or_by_their_units(read):
    text = "t_ms,x_nm,y_nm,angle_deg,freq_rpm\n0,1000,2,90,60\n500,2000,3,90,120\n"
    columns = {
        **{"t": "t_ms", "x": "x_nm", "y": "y_nm"},
        **{"heading": "angle_deg", "frequency": "freq_rpm"},
    }
    data = read(text, columns=columns)
    piece = data.trajectory(0)
    assert (data.units["x"], data.units["t"]) == ("um", "s")
    np.testing.assert_allclose(piece.times, [0, 0.5])
    np.testing.assert_allclose(piece.states[:, 0], [1, 2])
    np.testing.assert_allclose(piece.commands["heading"][0], np.pi / 2)
    np.testing.assert_allclose(piece.commands["frequency"][0], 1)
    intervals = npy(np.array([[0.5, 1, 2], [0.5, 2, 3], [0.5, 3, 4]]))
    reversed_map = {"0": "dt", "1": "x", "2": "y"}
    data = read(intervals, name="a.npy", columns=reversed_map, **UM)
    np.testing.assert_allclose(data.trajectory(0).times, [0, 0.5, 1])


def test_a_table_of_trex_is_read(read):
    header = "frame,missing,time,X#wcentroid (cm),Y#wcentroid (cm)\n"
    rows = "0,0,0,0.0001,0.0002\n1,0,0.5,0.0002,0.0003\n2,0,1,0.0003,0.0004\n"
    data = read(header + rows)
    assert data.provenance["format"] == "trex-csv"
    np.testing.assert_allclose(data.trajectory(0).states, [[1, -2], [2, -3], [3, -4]])


def test_a_table_that_pinav_did_not_write_is_offered_as_a_recording(checked):
    with pytest.raises(InputError, match=r"; or read it as .*--columns 't=t \(s\)'"):
        checked("t (s),x (um),y (um)\n0,1,2\n0.5,-,-\n1,2,3\n", Reading())


def test_the_line_to_start_from_names_the_particles():
    line = example_of_columns(["", "Trajectory", "Frame", "x", "y", "m0"])
    assert line == "--columns frame=Frame x=x y=y particle=Trajectory"


def object_array(value):
    return npy(np.array(value, dtype=object))


PATHS = np.array([[[1, 2], [5, 6]], [[2, 3], [np.nan, np.nan]], [[3, 4], [7, 8.0]]])


def test_an_array_of_idtracker_is_read(read):
    said = {"trajectories": PATHS, "frames_per_second": 2, "stats": {"a": 0.9}}
    data = read(object_array(said), name="trajectories.npy", mpp=1.0)
    assert data.provenance["format"] == "idtracker.ai-npy"
    np.testing.assert_allclose(data.trajectory(0).times, [0, 0.5, 1])
    np.testing.assert_allclose(data.trajectory(0).states, [[1, -2], [2, -3], [3, -4]])
    assert data.trajectory(1).observed.all(axis=1).tolist() == [True, False, True]


class Shouts:
    """An object that would write a file if a reader made it."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_objects_in_an_array_of_idtracker_are_passed_over(read, tmp_path):
    said = {"trajectories": PATHS, "frames_per_second": 2}
    said["other"] = Shouts(tmp_path / "made")
    with pickle.loads(pickle.dumps(said["other"])) as file:
        assert file.name.endswith("made")
    (tmp_path / "made").unlink()
    said["table"] = pd.DataFrame({"a": [1]})
    assert len(read(object_array(said), name="a.npy", mpp=1.0)) == 2
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (object_array({"a": 1}), "expected trajectories by frame"),
        (object_array({"trajectories": PATHS})[:-40], "damaged array: .*csv"),
    ],
)
def test_arrays_that_are_none_of_idtracker_are_refused(read, content, message):
    with pytest.raises(InputError, match=message):
        read(content, name="a.npy")
