"""Twenty layouts of files as programs and laboratories write them, small and made here.

Every file holds one or two particles of four frames; docs/recordings.md lists them.
"""

import io

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from tests.defects import defects
from tests.recordings.synthetic import npy, packed, workbook

from pinav.errors import InputError
from pinav.recordings import labels, read_recording

FRAMES = np.arange(4)
X, Y, Z = FRAMES + 1.0, 2 * FRAMES + 1.0, 3 * FRAMES + 1.0
"""Of the first particle, in the unit of the file, y down."""


def lines(*rows):
    return "\n".join(rows) + "\n"


def table(header, row, *above):
    return lines(*above, header, *(row(*p) for p in zip(FRAMES, X, Y, Z, strict=True)))


def project():
    spots = "".join(
        f'<SpotsInFrame frame="{f}"><Spot ID="{f}" FRAME="{f}" POSITION_X="{x}" '
        f'POSITION_Y="{y}" POSITION_Z="0.0"/></SpotsInFrame>'
        for f, x, y in zip(FRAMES, X, Y, strict=True)
    )
    edges = "".join(
        f'<Edge SPOT_SOURCE_ID="{f}" SPOT_TARGET_ID="{f + 1}"/>' for f in range(3)
    )
    return (
        '<?xml version="1.0"?><TrackMate version="7"><Model spatialunits="micron" '
        f'timeunits="sec"><AllSpots>{spots}<SpotsInFrame frame="9"><Spot ID="99" '
        'FRAME="9" POSITION_X="0" POSITION_Y="0" POSITION_Z="0"/></SpotsInFrame>'
        f'</AllSpots><AllTracks><Track TRACK_ID="5">{edges}</Track><Track '
        'TRACK_ID="6"><Edge SPOT_SOURCE_ID="99" SPOT_TARGET_ID="99"/></Track>'
        '</AllTracks><FilteredTracks><TrackID TRACK_ID="5"/></FilteredTracks></Model>'
        '<Settings><ImageData timeinterval="0.25"/></Settings></TrackMate>'
    )


def icy():
    spots = "".join(
        f'<detection t="{f}" x="{x}" y="{y}" z="{z}" type="1"/>'
        for f, x, y, z in zip(FRAMES, X, Y, Z, strict=True)
    )
    return (
        '<?xml version="1.0"?><root><trackfile version="1"/><trackgroup description="">'
        f'<track id="7">{spots}</track></trackgroup></root>'
    )


def sleap():
    file = io.BytesIO()
    with h5py.File(file, "w") as book:
        book["tracks"] = np.stack([X, Y])[None, :, None, :]
        book["node_names"] = [b"body"]
        book["track_names"] = [b"a"]
        book["point_scores"] = np.array([[[0.9, 0.9, 0.1, 0.9]]])
    return file.getvalue()


def trex():
    far = np.where(FRAMES == 2, np.inf, X * 1e-4)
    arrays = {"X#wcentroid": far, "Y#wcentroid": Y * 1e-4, "time": FRAMES / 4}
    return packed(np.savez, **arrays, frame=FRAMES, missing=(FRAMES == 2) * 1.0)


def utrack():
    row = np.stack([X, Y, 0 * X, X, X, X, X, X], axis=1).reshape(1, -1)
    track = {"tracksCoordAmpCG": row, "seqOfEvents": [[3, 1, 1, np.nan], [6, 2, 1, 0]]}
    kind = [("tracksCoordAmpCG", object), ("seqOfEvents", object)]
    cells = np.zeros((1, 1), kind)
    cells[0, 0] = (track["tracksCoordAmpCG"], np.array(track["seqOfEvents"], float))
    return packed(savemat, {"tracksFinal": cells})


SHEET = [[f / 4, x, y] for f, x, y in zip(FRAMES.tolist(), X, Y, strict=True)]
TXY = {"t": "t", "x": "x", "y": "y"}
UM = {"units": {"x": "um", "t": "s"}}
POINTS = [
    f"Point {f + 1} {x} {y} {z} {f + 1}.0 1.0"
    for f, x, y, z in zip(FRAMES, X, Y, Z, strict=True)
]
LAYOUTS = {
    "TrackMate project": ("a.xml", project(), {}, "trackmate-project"),
    "Icy": ("a.xml", icy(), {"fps": 4.0, "mpp": 1.0}, "icy"),
    "SLEAP": ("a.h5", sleap(), {"fps": 4.0, "mpp": 1.0}, "sleap"),
    "TRex": ("a.npz", trex(), {}, "trex"),
    "u-track": ("a.mat", utrack(), {"fps": 4.0, "mpp": 1.0}, "u-track"),
    "MTrackJ": (
        "a.mdf",
        lines("MTrackJ 1.5.1 Data File", "Assembly 1", "Cluster 1", "Track 1", *POINTS),
        {"fps": 4.0, "units": {"x": "um"}},
        "mtrackj",
    ),
    "Imaris": (
        "Position.csv",
        table(
            "Position X,Position Y,Position Z,Unit,Category,Collection,"
            "Time,TrackID,ID,",
            lambda f, x, y, z: f"{x},{y},{z},um,Spot,Position,{f + 1},100,{f},",
            "",
            "Position",
            "====================",
        ),
        {"fps": 4.0},
        "imaris",
    ),
    "CellProfiler": (
        "Objects.csv",
        table(
            "ImageNumber,ObjectNumber,Location_Center_X,Location_Center_Y,"
            "TrackObjects_Label_50",
            lambda f, x, y, z: f"{f + 1},1,{x},{y},3",
        ),
        {"fps": 4.0, "mpp": 1.0},
        "cellprofiler",
    ),
    "btrack with z": (
        "a.csv",
        table("ID,t,x,y,z", lambda f, x, y, z: f"1,{f},{x},{y},{z}"),
        {"fps": 4.0, "mpp": 1.0},
        "napari",
    ),
    "napari without z": (
        "a.csv",
        table("track_id,t,y,x", lambda f, x, y, z: f"1,{f},{y},{x}"),
        {"fps": 4.0, "mpp": 1.0},
        "napari-plane",
    ),
    "idtracker.ai": (
        "trajectories.csv",
        table("seconds,x1,y1", lambda f, x, y, z: f"{f / 4},{x},{y}"),
        {"mpp": 1.0},
        "idtracker.ai",
    ),
    "workbook with titles": (
        "a.xlsx",
        workbook({"Tracking": [["Experiment 7"], [], ["t", "x", "y"], *SHEET]}),
        {"columns": TXY, **UM},
        "table",
    ),
    "workbook with a row of units": (
        "a.xlsx",
        workbook({"Tracking": [["t", "x", "y"], ["s", "um", "um"], *SHEET]}),
        {"columns": TXY},
        "table",
    ),
    "decimal commas": (
        "a.csv",
        table(
            "Zeit [s];x [µm];y [µm]",
            lambda f, x, y, z: f"{f / 4};{x};{y}".replace(".", ","),
        ),
        {"columns": {"t": "Zeit", "x": "x", "y": "y"}},
        "table",
    ),
    "stamps of a clock": (
        "a.csv",
        table("t,x,y", lambda f, x, y, z: f"23:59:{59 + f // 4}.{f * 25:02d},{x},{y}"),
        {"columns": TXY, "units": {"x": "um"}},
        "table",
    ),
    "wide table": (
        "a.csv",
        table("t,x1,y1,x2,y2", lambda f, x, y, z: f"{f / 4},{x},{y},{x},{y}"),
        {"columns": {"t": "t", "x": "x*", "y": "y*"}, "particles": ["1"], **UM},
        "table",
    ),
    "title rows": (
        "a.csv",
        table(
            "t,x,y",
            lambda f, x, y, z: f"{f / 4},{x},{y}",
            "My tracker 2.1",
            "operator: me",
        ),
        {"columns": TXY, **UM},
        "table",
    ),
    "intervals": (
        "a.csv",
        table("dt,x,y", lambda f, x, y, z: f"0.25,{x},{y}"),
        {"columns": {"dt": "dt", "x": "x", "y": "y"}, **UM},
        "table",
    ),
    "array": (
        "a.npy",
        npy(np.stack([FRAMES / 4, X, Y], axis=1)),
        {"columns": {"t": "0", "x": "1", "y": "2"}, **UM},
        "table",
    ),
    "array with fields": (
        "a.npy",
        npy(np.array([tuple(row) for row in SHEET], [(n, float) for n in "txy"])),
        {"columns": TXY, **UM},
        "table",
    ),
}


@pytest.mark.parametrize(
    ("name", "content", "reading", "format"), LAYOUTS.values(), ids=LAYOUTS
)
def test_twenty_layouts_are_read(read, name, content, reading, format):
    data = read(content, name=name, **reading)
    assert data.provenance["format"] == format
    assert len(data) == 1
    assert data.units["x"] == "um"
    assert data.units["t"] == "s"
    piece = data.trajectory(0)
    np.testing.assert_allclose(piece.times - piece.times[0], FRAMES / 4)
    seen = piece.observed.all(axis=1)
    assert seen.sum() >= 3
    np.testing.assert_allclose(piece.states[seen, 0], X[seen], rtol=1e-6)
    np.testing.assert_allclose(piece.states[seen, 1], -Y[seen], rtol=1e-6)
    if "z" in data.channels:
        np.testing.assert_allclose(piece.states[seen, 2], Z[seen])


def test_the_height_is_kept(read):
    for name in ("Icy", "MTrackJ", "Imaris", "btrack with z"):
        path, content, reading, _ = LAYOUTS[name]
        assert read(content, name=path, **reading).channels == ("x", "y", "z")


def test_tracks_that_the_filters_dropped_are_left_out(read):
    data = read(project(), name="a.xml")
    assert [label["particle"] for label in labels(data)] == ["5"]


def test_a_wide_table_holds_several_particles(read):
    name, content, reading, _ = LAYOUTS["wide table"]
    data = read(content, name=name, **{**reading, "particles": []})
    assert [label["particle"] for label in labels(data)] == ["1", "2"]


DAMAGED = [
    ("a.xml", "<TrackMate><Model/></TrackMate>", r"no spot belongs to a track"),
    ("a.xml", "<TrackMate><a/></TrackMate>", r"no <Model>"),
    ("a.xml", "<root><trackgroup/></root>", r"element <trackgroup>: no <detection>"),
    (
        "a.xml",
        icy().replace('x="1.0"', 'x="wall"'),
        r"track 7, detection 1, attribute 'x': .* got 'wall'",
    ),
    ("a.mdf", "MTrackJ 1.5.1\n", r"no line begins with Point"),
    (
        "a.mdf",
        "MTrackJ 1.5.1\nPoint 1 2 3\n",
        r"line 2: expected Point index x y z frame, got 'Point 1 2 3'",
    ),
    (
        "a.mdf",
        "MTrackJ 1.5.1\nPoint 1 a 3 1 1 1\nPoint 2 1 3 1 2 1\n",
        r"line 2, column 'x': .* got 'a'",
    ),
    ("a.npz", trex()[:-40], r"format is not known|damaged archive"),
    (
        "a.csv",
        LAYOUTS["CellProfiler"][1].replace("2,1,", "2.5,1,"),
        r"'ImageNumber': expected a whole number",
    ),
]


@defects("name, content, message", DAMAGED)
def test_damage_is_named(read, name, content, message):
    with pytest.raises(InputError, match=message):
        read(content, name=name)


@pytest.mark.parametrize(
    ("name", "file"),
    [("a.geff", "zarr.json"), ("a", ".zgroup"), ("a.zarr", "README")],
)
def test_zarr_without_a_graph_is_refused_with_what_to_export(tmp_path, name, file):
    folder = tmp_path / name
    folder.mkdir()
    (folder / file).write_text("{}")
    with pytest.raises(InputError, match="one graph of GEFF.*got none.*--columns"):
        read_recording(folder)
