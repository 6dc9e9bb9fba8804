import contextlib
import json
import os
import tempfile
import zipfile
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from tests.defects import defects, told

from pinav.errors import InputError
from pinav.trajectories import Trajectories, is_trajectories, load, save

FINITE = st.floats(allow_nan=False, allow_infinity=False)
NAMES = (
    st.text(min_size=1, max_size=4)
    .filter(str.isprintable)
    .filter(lambda s: s == s.strip() and s[0] != "#" and s not in ("t", "trajectory"))
)
JSON = st.dictionaries(st.text(), st.none() | st.integers() | FINITE | st.text())


@st.composite
def several(draw):
    """Arguments of ragged trajectories with masks, commands and unicode names.

    The test makes the trajectories: beartype draws random numbers, which hypothesis
    does not allow here.
    """
    names = draw(st.lists(NAMES, min_size=1, max_size=4, unique=True))
    split = draw(st.integers(1, len(names)))
    channels, commands = names[:split], names[split:]
    times = [
        np.sort(draw(st.lists(FINITE, min_size=2, max_size=4, unique=True)))
        for _ in range(draw(st.integers(1, 3)))
    ]
    shapes = [(len(ts), len(channels)) for ts in times]
    return {
        "times": times,
        "states": [
            draw(npst.arrays(float, shape, elements=FINITE)) for shape in shapes
        ],
        "observed": [draw(npst.arrays(bool, shape)) for shape in shapes],
        "commands": {
            name: [draw(npst.arrays(float, len(ts), elements=FINITE)) for ts in times]
            for name in commands
        },
        "channels": channels,
        "units": {name: draw(st.text()) for name in (*names, "t")},
        "provenance": draw(JSON),
    }


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
@settings(max_examples=60, deadline=None)
@given(arguments=several())
def test_load_gives_back_what_was_saved(suffix, arguments):
    data = Trajectories.from_arrays(**arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"data{suffix}"
        save(data, path)
        again = load(path)
    assert eqx.tree_equal(again, data)
    for name in ("times", "states", "observed", "lengths"):  # the signs of zeros too
        assert getattr(again, name).tobytes() == getattr(data, name).tobytes()


@pytest.fixture
def data():
    return Trajectories.from_arrays(
        [[0.0, 0.5], [0.0, 0.25, 1.0]],
        [[[0.1, 0.2], [0.3, 0.4]], [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]],
        observed=[[[True, True], [True, False]], [[True, True]] * 3],
        commands={"heading": [[0.0, 1.0], [2.0, 3.0, 4.0]]},
        channels=("x", "y"),
        units={"x": "um", "y": "um", "t": "s"},
    )


def test_csv_can_be_read_by_eye(data, tmp_path):
    save(data, tmp_path / "a.csv")
    comment, *lines = (tmp_path / "a.csv").read_text().splitlines()
    assert json.loads(comment.removeprefix("# pinav: "))["units"]["x"] == "um"
    assert lines == [
        "trajectory,t,x,y,heading",
        "0,0.0,0.1,0.2,0.0",
        "0,0.5,0.3,,1.0",
        "1,0.0,1.0,2.0,2.0",
        "1,0.25,3.0,4.0,3.0",
        "1,1.0,5.0,6.0,4.0",
    ]


def write(tmp_path, content, name="data.csv"):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.fixture
def load_csv(tmp_path):
    return lambda content: load(write(tmp_path, content, "bad.csv"))


def test_plain_csv_needs_only_its_header_and_may_state_more(load_csv):
    read = load_csv("\ufefft, x, y, vx\r\n0,1,,3\r\n\r\n0.5, 4 ,5,6\r\n")
    np.testing.assert_array_equal(read.times, [[0.0, 0.5]])
    np.testing.assert_array_equal(read.states, [[[1, 0, 3], [4, 5, 6]]])
    np.testing.assert_array_equal(read.observed[0], [[1, 0, 1], [1, 1, 1]])
    assert read.channels == ("x", "y", "vx")
    assert read.units == dict.fromkeys(("x", "y", "vx", "t"), "?")
    assert read.provenance == {"source": "bad.csv"}
    read = load_csv(
        '# tracked by hand\n# pinav: {"commands": ["f"], "units": {"x": "µm"}}\n'
        "trajectory,f,t,x\nb,1,0,10\na,2,0,20\nb,3,1,30\na,4,2,40\n"
    )
    np.testing.assert_array_equal(read.states[:, :, 0], [[10, 30], [20, 40]])
    np.testing.assert_array_equal(read.commands["f"], [[1, 3], [2, 4]])
    assert read.units == {"x": "µm", "t": "?", "f": "?"}


BAD_CSV = [
    ("", r"line 1: expected the columns t, x, y, ..., got nothing"),
    ("t,x,y\n", r"no rows below the header"),
    ("0,1,2\n1,2,3\n", r"columns t, x, .* got 0, 1, 2; the first line"),
    ("x,y\n0,1\n1,2\n", r"line 1: expected the columns t, .* got x, y"),
    ("t\n0\n1\n", r"line 1: expected the columns .* got t;"),
    ("t,x,x\n0,1,2\n1,2,3\n", r"line 1: column 'x' stands twice"),
    (
        '# pinav: {"channels": ["x", "y"]}\nt,x,z\n0,1,2\n1,2,3\n',
        r"line 2: expected the columns t, x, y, got t, x, z",
    ),
    ("t,x\n0,1\n1,wall\n", r"line 3, column x: .* got 'wall'; leave the cell"),
    ("t,x\n0,1\n1,2,5\n", r"line 3: expected 2 cells \(t, x\), got 3"),
    ("t,x\n0,1_0\n1,2\n", r"line 2, column x: .* '1_0'"),
    (
        "# a\nt,x,y\n0,1,2\n\n1,2,nan\n",
        r"line 5, column y: expected a finite number, got 'nan'; leave the cell empty "
        "to mark a missing observation",
    ),
    ("t,x\n0,1\n1,-inf\n", r"line 3, column x: .* got '-inf'"),
    ("t,x\n0,1\n,2\n", r"line 3, column t: .* got ''; give its value"),
    (
        '# pinav: {"commands": ["f"]}\nt,x,f\n0,1,2\n1,2,\n',
        r"line 4, column f: .* got ''; give its value",
    ),
    ("t,x,y\n0,1,2\n1,2\n", r"line 3: expected 3 cells .* got 2"),
    ("t,x\n0,1\n2,1\n1,1\n", r"line 4, column t: time 1.0 after 2.0 is out of order"),
    (
        "trajectory,t,x\n0,0,1\n1,0,1\n0,1,1\n1,0,1\n",
        r"line 5, column t: time 0.0 after 0.0 is repeated",
    ),
    ("t,x\n0,1\n", r"trajectory 0: expected two or more samples, got 1"),
    ("t,µ\n0,1\n1,2\n".encode("latin-1"), r"expected UTF-8 text"),
    ('t,x\n0,"1\n1,2\n', r"not a CSV file: unexpected end of data"),
    ("# pinav: {\nt,x\n", r"line 1: not the metadata of pinav"),
    ("# pinav: []\nt,x\n", r"line 1: .*Expected `object`"),
    ('# pinav: {"unit": {}}\nt,x\n', r"line 1: .* unknown field `unit`"),
    (
        '# pinav: {"format": 2, "new": 0}\nt,x\n',
        r"line 1: format 2 is not known, expected 1; read it with the version",
    ),
]


@defects("content, message", BAD_CSV)
def test_bad_csv_is_named_with_its_place(load_csv, content, message):
    with told(r"bad\.csv: .*" + message):
        load_csv(content)


def without(name):
    return lambda arrays: arrays.pop(name)


def put(name, value):
    return lambda arrays: arrays.__setitem__(name, np.asarray(value))


BAD_NPZ = [
    (without("observed"), r"'observed' is missing; expected metadata"),
    (without("metadata"), r"'metadata' is missing; .* got times"),
    (put("metadata", '{"format": 9}'), r"format 9 is not known"),
    (put("metadata", b"\xff"), r"not the metadata of pinav"),
    (put("states", np.ones(5)), r"'states': expected 2 axes, got shape \(5,\)"),
    (put("lengths", [2, 2]), r"add up to the 5 times, got \[2, 2\]"),
    (put("lengths", [2.0, 3.0]), r"whole numbers"),
    (put("states", np.ones((4, 2))), r"'states': expected 5 samples, got 4"),
    (
        put("commands", np.ones((2, 5))),
        r"'commands': expected 1 rows \(heading\), got 2",
    ),
    (put("states", np.full((5, 2), np.nan)), r"trajectory 0, column 0 \(x\)"),
    (put("times", ["a"] * 5), r"times of trajectory 0: expected numbers"),
]


@defects("change, message", BAD_NPZ)
def test_bad_npz_is_named(data, tmp_path, change, message):
    path = tmp_path / "bad.npz"
    save(data, path)
    with np.load(path) as archive:
        arrays = dict(archive)
    change(arrays)
    np.savez(path, **arrays)
    with told(r"bad\.npz: .*" + message):
        load(path)


def test_npz_never_unpickles(data, tmp_path):
    path = tmp_path / "bad.npz"
    np.savez(path, times=np.array([{}], dtype=object))
    with told(r"bad\.npz: damaged npz file: Object arrays"):
        load(path)


@pytest.mark.parametrize("content", [b"", b"PK", b"hello", b"\x93NUMPY"])
def test_npz_that_is_no_zip_is_refused(tmp_path, content):
    with told(r"bad\.npz: not an npz file, or one cut sh"):
        load(write(tmp_path, content, "bad.npz"))


@pytest.mark.parametrize("start", range(30, 1900, 110))
def test_npz_damaged_anywhere_is_refused_or_read_right(data, tmp_path, start):
    """A zip checks its content: damage is found, or was where nothing is read."""
    path = tmp_path / "bad.npz"
    save(data, path)
    content = bytearray(path.read_bytes())
    for index in range(start, min(start + 4, len(content))):
        content[index] ^= 0xFF
    path.write_bytes(content)
    with contextlib.suppress(InputError):
        assert eqx.tree_equal(load(path), data)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_missing_file_and_folder_are_named(tmp_path, suffix):
    absent, folder = tmp_path / f"absent{suffix}", tmp_path / f"folder{suffix}"
    folder.mkdir()
    with told("absent.*: cannot read: No such file"):
        load(absent)
    with told("folder.*: cannot read: Is a directory"):
        load(folder)


def test_other_suffix_is_refused(data, tmp_path):
    for call in (load, lambda path: save(data, path)):
        with told(r"a\.xlsx: expected .* \.npz or \.csv"):
            call(tmp_path / "a.xlsx")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.npz", "a.csv"])
def test_a_file_is_replaced_where_that_is_asked_for(data, tmp_path, name):
    save(data, tmp_path / name)
    with told("exists already"):
        save(data.select([0]), tmp_path / name)
    assert eqx.tree_equal(load(tmp_path / name), data)
    save(data.select([0]), tmp_path / name, overwrite=True)
    assert len(load(tmp_path / name)) == 1


SPREADSHEETS = {
    "mark of a spreadsheet": "\ufefft,x\n0,0.5\n1,1.5\n",
    "semicolons": "t;x\n0;0.5\n1;1.5\n",
    "decimal commas": "\ufefft;x\n0;0,5\n1;1,5\n",
    "units": "t [s],x [um]\n0,0.5\n1,1.5\n",
}


@pytest.mark.parametrize("case", SPREADSHEETS)
def test_what_a_spreadsheet_writes_is_read(case, tmp_path):
    path = write(tmp_path, SPREADSHEETS[case])
    assert is_trajectories(path)
    data = load(path)
    np.testing.assert_array_equal(data.states[0, :, 0], [0.5, 1.5])
    known = {"x": "um", "t": "s"} if case == "units" else {"x": "?", "t": "?"}
    assert data.units == known


def test_units_are_stated_for_any_file(tmp_path):
    path = write(tmp_path, "t,x\n0,0.5\n1,1.5\n")
    assert load(path, units={"x": "mm"}).units == {"x": "mm", "t": "?"}
    with told("data.csv: units: 'y' is no column; .* x, t"):
        load(path, units={"y": "mm"})


def test_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with told("pipe.csv: expected a file, got a pipe; save"):
        load(tmp_path / "pipe.csv")
    assert is_trajectories(tmp_path / "pipe.csv")


def npz(tmp_path, header, size=0, **kind):
    """An archive with one array, of a header of one's own."""
    path = tmp_path / "data.npz"
    with (
        zipfile.ZipFile(path, "w", **kind) as archive,
        archive.open("times.npy", "w") as f,
    ):
        f.write(np.lib.format.magic(1, 0))
        text = str(header).encode().ljust(117) + b"\n"
        f.write(len(text).to_bytes(2, "little") + text)
        for _ in range(size):
            f.write(bytes(2**20))
    return path


def test_an_array_that_is_not_there_is_refused(tmp_path):
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**15,)}
    with told("'times.npy' claims 80{14,} bytes, but the file"):
        load(npz(tmp_path, header))


def test_a_file_that_unpacks_beyond_all_measure_is_refused(tmp_path):
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**25,)}
    path = npz(tmp_path, header, 256, compression=zipfile.ZIP_DEFLATED, compresslevel=1)
    assert path.stat().st_size < 2**21
    with told("npz file of .* bytes that unpacks to 268"):
        load(path)
