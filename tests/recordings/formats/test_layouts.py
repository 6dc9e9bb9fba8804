"""Twenty layouts of files as programs and laboratories write them, small and made here.

Every file holds one or two particles of four frames; docs/recordings.md lists them.
"""

import io

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from tests.defects import defects, told
from tests.recordings.synthetic import npy, packed, workbook

from pinav.recordings import labels, read_recording

FRAMES = np.arange(4)
X, Y, Z = FRAMES + 1.0, 2 * FRAMES + 1.0, 3 * FRAMES + 1.0
"""Of the first particle, in the unit of the file, y down."""


def lines(*rows):
    return "\n".join(rows) + "\n"


def rows(row):
    """The row of each frame, from its number and place."""
    places = zip(FRAMES, X, Y, Z, strict=True)
    return [
        row.format(n=f + 1, f=f, t=f / 4, clock=59 + f / 4, x=x, y=y, z=z)
        for f, x, y, z in places
    ]


def table(header, row, *above):
    return lines(*above, header, *rows(row))


def project():
    """One track that the filters of TrackMate passed, and one that they dropped."""

    def spot(frame, x, y):
        return (
            f'<SpotsInFrame frame="{frame}"><Spot ID="{frame}" FRAME="{frame}" '
            f'POSITION_X="{x}" POSITION_Y="{y}" POSITION_Z="0.0"/></SpotsInFrame>'
        )

    def edge(frame):
        return f'<Edge SPOT_SOURCE_ID="{frame}" SPOT_TARGET_ID="{frame + 1}"/>'

    frames = (*zip(FRAMES, X, Y, strict=True), (8, 0, 0), (9, 0, 0))
    spots = "".join(spot(*one) for one in frames)
    return (
        '<?xml version="1.0"?><TrackMate version="7"><Model spatialunits="micron" '
        f'timeunits="sec"><AllSpots>{spots}</AllSpots><AllTracks>'
        f'<Track TRACK_ID="5">{edge(0)}{edge(1)}{edge(2)}</Track>'
        f'<Track TRACK_ID="6">{edge(8)}</Track></AllTracks>'
        '<FilteredTracks><TrackID TRACK_ID="5"/></FilteredTracks></Model>'
        '<Settings><ImageData timeinterval="0.25"/></Settings></TrackMate>'
    )


def icy():
    spots = "".join(rows('<detection t="{f}" x="{x}" y="{y}" z="{z}" type="1"/>'))
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
PIXELS = {"fps": 4.0, "mpp": 1.0}
POINTS = rows("Point {n} {x} {y} {z} {n}.0 1.0")
TRACK = ("MTrackJ 1.5.1 Data File", "Assembly 1", "Cluster 1", "Track 1")
IMARIS = "Position X,Position Y,Position Z,Unit,Category,Collection,Time,TrackID,ID,"
OBJECTS = "ImageNumber,ObjectNumber,Location_Center_X,Location_Center_Y"
MICRONS = {"columns": TXY, **UM}
LAYOUTS = {
    "TrackMate project": ("a.xml", project(), {}, "trackmate-project"),
    "Icy": ("a.xml", icy(), PIXELS, "icy"),
    "SLEAP": ("a.h5", sleap(), PIXELS, "sleap"),
    "TRex": ("a.npz", trex(), {}, "trex"),
    "u-track": ("a.mat", utrack(), PIXELS, "u-track"),
    "MTrackJ": (
        "a.mdf",
        lines(*TRACK, *POINTS),
        {"fps": 4.0, "units": {"x": "um"}},
        "mtrackj",
    ),
    "Imaris": (
        "Position.csv",
        table(
            IMARIS,
            "{x},{y},{z},um,Spot,Position,{n},100,{f},",
            *("", "Position", "===================="),
        ),
        {"fps": 4.0},
        "imaris",
    ),
    "CellProfiler": (
        "Objects.csv",
        table(f"{OBJECTS},TrackObjects_Label_50", "{n},1,{x},{y},3"),
        PIXELS,
        "cellprofiler",
    ),
    "idtracker.ai": (
        "trajectories.csv",
        table("seconds,x1,y1", "{t},{x},{y}"),
        {"mpp": 1.0},
        "idtracker.ai",
    ),
    "workbook with titles": (
        "a.xlsx",
        workbook({"Tracking": [["Experiment 7"], [], ["t", "x", "y"], *SHEET]}),
        MICRONS,
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
        table("Zeit [s];x [µm];y [µm]", "{t};{x};{y}").replace(".", ","),
        {"columns": {"t": "Zeit", "x": "x", "y": "y"}},
        "table",
    ),
    "title rows": (
        "a.csv",
        table("t,x,y", "{t},{x},{y}", "My tracker 2.1", "operator: me"),
        MICRONS,
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
        MICRONS,
        "table",
    ),
}


CLOCK = {"columns": TXY, "units": {"x": "um"}}
WIDE = {"columns": {"t": "t", "x": "x*", "y": "y*"}, "particles": ["1"], **UM}
STEPS = {"columns": {"dt": "dt", "x": "x", "y": "y"}, **UM}
TABLES = {
    "btrack with z": ("ID,t,x,y,z", "1,{f},{x},{y},{z}", PIXELS, "napari"),
    "napari without z": ("track_id,t,y,x", "1,{f},{y},{x}", PIXELS, "napari-plane"),
    "stamps of a clock": ("t,x,y", "23:59:{clock},{x},{y}", CLOCK, "table"),
    "wide table": ("t,x1,y1,x2,y2", "{t},{x},{y},{x},{y}", WIDE, "table"),
    "intervals": ("dt,x,y", "0.25,{x},{y}", STEPS, "table"),
}
for name, (header, row, reading, format) in TABLES.items():
    LAYOUTS[name] = ("a.csv", table(header, row), reading, format)

WITH_HEIGHT = {"Icy", "MTrackJ", "Imaris", "btrack with z"}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_twenty_layouts_are_read(read, layout):
    name, content, reading, format = LAYOUTS[layout]
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
    assert ("z" in data.channels) == (layout in WITH_HEIGHT)
    if layout in WITH_HEIGHT:
        np.testing.assert_allclose(piece.states[seen, 2], Z[seen])


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
        r"track 7, detection 1, column 'x': .* got 'wall'",
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
    with told(message):
        read(content, name=name)


@pytest.mark.parametrize(
    ("name", "file"), [("a.geff", "zarr.json"), ("a", ".zgroup"), ("a.zarr", "README")]
)
def test_zarr_without_a_graph_is_refused_with_what_to_export(tmp_path, name, file):
    folder = tmp_path / name
    folder.mkdir()
    (folder / file).write_text("{}")
    with told("one graph of GEFF.*got none.*--columns"):
        read_recording(folder)
