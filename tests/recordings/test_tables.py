"""Tables: trackpy, ImageJ, StochasticForceInference, and any by a column map."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from tests.defects import defects, told
from tests.recordings.synthetic import EXAMPLE, check, packed, rows_of, tracks

from pinav.recordings import Reading, labels, read_recording
from pinav.recordings.table import Table


def trackpy_frame(truth):
    """What trackpy.link returns."""
    columns = ("particle", "frame", "x", "y")
    frame = pd.DataFrame(list(rows_of(truth)), columns=columns)
    frame["particle"] = frame["particle"].astype(int)
    frame["mass"] = 7.5
    return frame


@settings(max_examples=25)
@given(tracks())
def test_trackpy_comes_back_whole(tmp_path_factory, truth):
    frame = trackpy_frame(truth)
    folder = tmp_path_factory.mktemp("trackpy")
    shuffled = frame.sample(frac=1.0, random_state=1).sort_values("particle")
    (folder / "a.csv").write_text("# MyTracker 3\n% 20 a second\n" + shuffled.to_csv())
    (folder / "a.parquet").write_bytes(packed(frame.to_parquet))
    scale = {"fps": 20.0, "mpp": 0.345}
    for source in (folder / "a.csv", folder / "a.parquet", shuffled):
        check(read_recording(source, Reading(**scale)), truth, **scale)
        data = read_recording(source)
        check(data, truth)
        assert data.units == {"x": "px", "y": "px", "t": "frame"}
        assert data.provenance["format"] == "trackpy"
    assert data.provenance["source"] == "DataFrame"


FRAME = trackpy_frame(EXAMPLE)


def broken(row, column, value):
    """The frame with another number in a cell."""
    changed = FRAME.astype({column: float})
    changed.loc[row, column] = value
    return changed


BAD_FRAMES = [
    (FRAME.iloc[:0], r"the table has no rows"),
    (FRAME.drop(columns="particle"), r"link the features first"),
    (FRAME.drop(columns="x"), r"format is not known"),
    (
        FRAME.assign(x=["a", *map(str, FRAME["x"][1:])]),
        r"row 0, column 'x': .* got 'a'",
    ),
    (broken(1, "y", np.inf), r"row 1, column 'y': .*'inf'"),
    (broken(1, "y", 1e200), r"row 1, column 'y': .* below 1e\+100, got '1e\+200'"),
    (broken(3, "frame", 2), r"row 3, column 'frame': .* stands in row 2 already"),
    (broken(3, "frame", np.nan), r"row 3, column 'frame': expected a finite number"),
    (broken(0, "particle", np.nan), r"row 0, column 'particle': .* an empty cell"),
]


@defects("frame, message", BAD_FRAMES)
@pytest.mark.parametrize("kind", ["DataFrame", "parquet"])
def test_damaged_frame_is_named_with_its_place(read, kind, frame, message):
    make = {
        "DataFrame": read_recording,
        "parquet": lambda f: read(packed(f.to_parquet)),
    }
    with told(message):
        make[kind](frame)


@pytest.mark.parametrize("end", [8, 100, -1])
def test_parquet_cut_short_is_refused(read, end):
    with told(r"a\.parquet: damaged parquet file"):
        read(packed(trackpy_frame(EXAMPLE).to_parquet)[:end], name="a.parquet")


@settings(max_examples=25)
@given(tracks(names=("1", "2"), first_frame=1))
def test_imagej_comes_back_whole(tmp_path_factory, truth):
    path = tmp_path_factory.mktemp("imagej") / "Results.xls"
    lines = [" \tTrack n°\tSlice n°\tX\tY\tDistance\tVelocity\tPixel Value"]
    for index, (name, frame, x, y) in enumerate(rows_of(truth), start=1):
        lines.append(f"{index}\t{name}\t{frame}\t{x!r}\t{y!r}\t-1\t-1\t90")
    path.write_bytes("\n".join(lines).encode("latin-1"))
    data = read_recording(path, Reading(fps=10.0))
    check(data, truth, fps=10.0)
    assert data.units["x"] == "px"
    one = truth[:1]
    lines = [" ,Area,X,Y,XM,YM,Slice"]
    for index, (_, frame, x, y) in enumerate(rows_of(one), start=1):
        lines.append(f"{index},12,{x!r},{y!r},0,0,{frame}")
    path.write_text("\n".join(lines))
    data = read_recording(path, Reading(fps=10.0, mpp=2.0))
    check(data, [one[0]._replace(name="1")], mpp=2.0, fps=10.0)
    assert read_recording(path).units["x"] == "?"
    assert read_recording(path, Reading(units={"x": "um"})).units["x"] == "um"


def test_imagej_results_of_several_particles_need_tracks(read):
    with told(r"line 3, column 'Slice': frame 1 stands in l"):
        read("X,Y,Slice\n1,2,1\n5,6,1\n")


@settings(max_examples=25)
@given(tracks())
def test_sfi_comes_back_whole(tmp_path_factory, truth):
    path = tmp_path_factory.mktemp("sfi") / "trap.csv"
    lines = ["# dt: 0.125", "# description: a trap: synthetic"]
    lines += ["particle_id,frame,x,y,TG_frequency"]
    lines += [f"{n},{f},{x!r},{y!r},{f}" for n, f, x, y in rows_of(truth)]
    path.write_text("\n".join(lines))
    data = read_recording(path)
    check(data, truth, fps=8.0, up=True)
    for piece, track in zip(data, truth, strict=True):
        assert_array_equal(piece.commands["frequency"], track.frames)
    assert data.units == {"x": "?", "y": "?", "t": "?", "frequency": "Hz"}
    assert data.provenance["comments"]["description"] == "a trap: synthetic"


@pytest.mark.parametrize("word", ["fast", "0", "-0.1", "inf", ""])
def test_sfi_with_a_wrong_interval_is_refused(read, word):
    with told(r"comment 'dt': expected a number > 0, got"):
        read(f"# dt: {word}\nparticle_id,frame,x,y\n0,0,1,2\n0,1,1,2\n")


MAP = {
    "t": "Time [ms]",
    "x": "X",
    "y": "Y",
    "heading": "angle",
    "frequency": "drive",
    "field_x": "coil",
    "particle": "bot",
}
MAPPED = (
    "bot;Time [ms];X;Y;angle;drive;coil\n"
    "a;0;1;2;90;60;50\na;500;1.5;2.5;180;120;50\na;1000;2;3;180;120;50\n"
)


def test_any_table_by_its_columns_and_units(read):
    units = {"t": "ms", "x": "mm", "heading": "deg", "frequency": "rpm", "field_x": "%"}
    data = read(MAPPED, columns=MAP, units=units, jump=1e4)
    assert_allclose(data.times[0], [0, 0.5, 1])
    assert_allclose(data.states[0], [[1000, -2000], [1500, -2500], [2000, -3000]])
    assert_allclose(data.commands["heading"][0] / np.pi, [0.5, 1, 1])
    assert_allclose(data.commands["frequency"], [[1, 2, 2]])
    assert_allclose(data.commands["field_x"], [[0.5, 0.5, 0.5]])
    assert data.units["x"] == "um"
    assert data.units["t"] == "s"
    assert labels(data)[0]["particle"] == "a"
    assert data.provenance["columns"] == MAP
    assert read(MAPPED, columns=MAP, y="up").states[0, 0].tolist() == [1, 2]


BAD_MAPS = [
    ({"speed": "v"}, {}, r"columns: 'speed' is no quantity; exp"),
    ({"t": "T"}, {}, r"columns: x, y not named; expected columns such"),
    ({"x": "X", "y": "Y"}, {}, r"columns: t or frame not named"),
    (
        {"t": "T", "x": "X", "y": "Y"},
        {},
        r"header: column 'T' is missing; got a; add it, or name another",
    ),
    (MAP, {"speed": "m"}, r"units: 'speed' is no quantity"),
    (MAP, {"x": "ms"}, r"units: expected x in one of um, .*got 'ms'"),
    (MAP, {"t": "px"}, r"units: expected t in one of s, .*got 'px'"),
    (MAP, {"heading": "Hz"}, r"units: expected heading in one of rad"),
]


@defects("columns, units, message", BAD_MAPS)
def test_wrong_map_is_named(read, columns, units, message):
    text = MAPPED if columns is MAP else "a\n1\n2\n"
    with told(message):
        read(text, columns=columns, units=units)


def test_times_and_delays_need_the_rate_of_the_film(read):
    text = "frame,t_s,x_px,y_px\n0,0,0,0\n1,0.1,0,0\n2,0.2,0,0\n"
    notes = read(text, fps=20.0).provenance["notes"]
    assert notes == ["fps 20 was given, the times of the file say 10"]
    assert read(text, fps=10.0).provenance["notes"] == []
    text = "t,x,y,f\n0,0,0,1\n1,0,0,1\n"
    columns = {"frame": "t", "x": "x", "y": "y", "frequency": "f"}
    with told("delay: times are in frames; give fps too"):
        read(text, columns=columns, delay=0.1)
    assert read(text, columns=columns, delay=0.1, fps=5.0).units["t"] == "s"


COLUMNS = {"particle": "0", "frame": "1", "x": "2", "y": "3"}


@settings(max_examples=15)
@given(tracks())
def test_text_of_numpy_comes_back_whole(tmp_path_factory, truth):
    """`numpy.savetxt`: spaces between the cells, and a header that is a comment."""
    rows = trackpy_frame(truth)[["particle", "frame", "x", "y"]].to_numpy(float)
    folder = tmp_path_factory.mktemp("text")
    for delimiter in " ,":
        np.savetxt(folder / "a.txt", rows, "%.17g", delimiter)
        check(read_recording(folder / "a.txt", Reading(columns=COLUMNS)), truth)
        header = delimiter.join(["Robot", "Frame", "Centroid_x", "Centroid_y"])
        np.savetxt(folder / "b.txt", rows, "%.17g", delimiter, header=header)
        names = dict(zip(COLUMNS, header.split(delimiter), strict=True))
        check(read_recording(folder / "b.txt", Reading(columns=names)), truth)


@pytest.mark.parametrize(
    ("header", "line"),
    [
        (
            "Particle ID,Frame,Centroid X (px),Centroid Y (px),Field freq (Hz),"
            "Field heading (deg),Magnetic field x",
            "--columns frame=Frame 'x=Centroid X (px)' 'y=Centroid Y (px)' "
            "'particle=Particle ID' 'frequency=Field freq (Hz)' "
            "'heading=Field heading (deg)' 'field_x=Magnetic field x'",
        ),
        ("1,0,0.5,0.25", "--columns t=0 x=1 y=2"),
    ],
)
def test_an_unknown_table_gets_the_option_that_reads_it(tmp_path, header, line):
    file = tmp_path / "a.csv"
    count = len(header.split(","))
    file.write_text(header + "\n" + ",".join(["1"] * count) + "\n")
    with told("say what its columns") as error:
        read_recording(file)
    assert line in str(error.value)


def test_a_clock_that_passes_midnight_goes_on():
    cells = ["23:59:58", "23:59:59.5", "00:00:01", "00:00:02.5"]
    seconds, unit = Table({"t": cells}, np.arange(4)).times("t")
    np.testing.assert_allclose(seconds, [0.0, 1.5, 3.0, 4.5])
    assert unit == "s"
