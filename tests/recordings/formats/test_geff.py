"""Graphs of GEFF, as folders of Zarr that the tests write: no package for it is needed.

The bytes of `BLOSC` were made by numcodecs 0.15 with lz4 and shuffled bytes.
"""

import base64
import json
import zlib

import numpy as np
import pyarrow
import pytest
from tests.defects import defects, told

from pinav.recordings import labels, read_recording
from pinav.recordings.formats.zarr_arrays import Group

NODES = np.array([3, 8, 1, 5, 9, 4])
T, X = np.array([0, 1, 2, 0, 1, 2.0]), np.array([1, 2, 3, 11, 12, 13.0])
LINES = np.array([7, 7, 7, 2, 2, 2])
EDGES = np.array([[3, 8], [8, 1], [5, 9], [9, 4]])
AXES = [
    {"name": "t", "type": "time", "unit": "second", "scale": 0.5, "scaled_unit": "s"},
    {"name": "y", "type": "space", "unit": "micrometer"},
    {"name": "x", "type": "space", "unit": "micrometer", "offset": 100.0},
]


def zstd(content):
    return pyarrow.Codec("zstd").compress(content, asbytes=True)


def write_group(folder, attributes, version=3):
    folder.mkdir(parents=True)
    if version == 2:
        (folder / ".zgroup").write_text('{"zarr_format": 2}')
        (folder / ".zattrs").write_text(json.dumps(attributes))
    else:
        said = {"zarr_format": 3, "node_type": "group", "attributes": attributes}
        (folder / "zarr.json").write_text(json.dumps(said))


def write_array(folder, values, codec="zstd", compress=zstd):
    """An array of version 3 in chunks of four rows."""
    folder.mkdir(parents=True)
    chunk = (4, *values.shape[1:])
    codecs = [{"name": "bytes", "configuration": {"endian": "little"}}]
    said = {
        "shape": values.shape,
        "data_type": values.dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
        "chunk_key_encoding": {"name": "default"},
        "fill_value": 0,
        "codecs": codecs + ([{"name": codec}] if codec else []),
    }
    (folder / "zarr.json").write_text(json.dumps(said))
    for number, at in enumerate(range(0, len(values), 4)):
        whole = np.zeros(chunk, values.dtype)
        whole[: len(values[at : at + 4])] = values[at : at + 4]
        name = folder.joinpath("c", str(number), *["0"] * (values.ndim - 1))
        name.parent.mkdir(parents=True, exist_ok=True)
        name.write_bytes(compress(whole.tobytes()))


def write_graph(folder, axes=AXES, edges=EDGES, **said):
    write_group(folder, {"geff": {"axes": axes, **said}})
    write_array(folder / "nodes/ids", NODES)
    write_array(folder / "edges/ids", edges)
    for name, values in (("t", T), ("x", X), ("y", 2 * X), ("lineage", LINES)):
        write_array(folder / f"nodes/props/{name}/values", values)
    return folder


def test_tracks_are_stretches_of_edges_with_scale_and_offset(tmp_path):
    data = read_recording(write_graph(tmp_path / "a.geff"))
    assert data.units == {"x": "um", "y": "um", "t": "s"}
    np.testing.assert_allclose(data.trajectory(0).times, [0, 0.5, 1])
    np.testing.assert_allclose(data.trajectory(1).states[:, 0], [111, 112, 113])
    np.testing.assert_allclose(data.trajectory(1).states[:, 1], [-22, -24, -26])
    divided = np.array([[3, 8], [8, 1], [8, 4], [5, 9]])
    data = read_recording(write_graph(tmp_path / "b.geff", edges=divided))
    assert sorted(one["particle"] for one in labels(data)) == ["0", "2"]
    assert [len(one.times) for one in data] == [2, 2]  # one node alone is no path
    named = {"track_node_props": {"tracklet": "lineage"}}
    folder = write_graph(tmp_path / "c.geff", **named)
    assert [one["particle"] for one in labels(read_recording(folder))] == ["7", "2"]
    with told(r"axes t, x: y is not among them"):
        read_recording(write_graph(tmp_path / "d.geff", axes=[AXES[0], AXES[2]]))


def test_the_only_graph_in_a_store_is_read_and_two_are_refused(tmp_path):
    write_group(tmp_path / "all.zarr", {})
    write_graph(tmp_path / "all.zarr" / "first")
    assert len(read_recording(tmp_path / "all.zarr")) == 2
    write_graph(tmp_path / "all.zarr" / "second")
    with told("got first, second; give its folder"):
        read_recording(tmp_path / "all.zarr")


def test_ids_that_are_missing_are_named(tmp_path):
    folder = write_graph(tmp_path / "a.geff")
    (folder / "edges/ids/zarr.json").unlink()
    with told("ids of nodes or of edges are missing"):
        read_recording(folder)


@pytest.mark.parametrize(
    ("codec", "compress"), [("", bytes), ("zstd", zstd), ("zlib", zlib.compress)]
)
def test_codecs_give_back_what_they_took(tmp_path, codec, compress):
    values = np.arange(18.0).reshape(9, 2)
    write_array(tmp_path / "a", values, codec, compress)
    np.testing.assert_array_equal(Group(tmp_path).array("a"), values)


def test_a_chunk_that_is_not_stored_holds_the_fill_value(tmp_path):
    write_array(tmp_path / "a", np.arange(1, 9))
    (tmp_path / "a/c/1").unlink()
    np.testing.assert_array_equal(Group(tmp_path).array("a"), [1, 2, 3, 4, 0, 0, 0, 0])


BLOSC = (
    "0s$ciKn4H+Kn4H+_yGU_6aWAK$N&HU009IE5E&#fKv86Qkg3Gs03k$akh$a$Kyjqm5J`l=06~Pw5Lu-0"
    "K#}A*km*FB0Aa)_kojcMK(Qp55QzkV0D%OF5Sb*gK+$CRkSWAr0HH+bkU8X$K=Gtm5Xpo=0KtSw5ZR=0"
    "KoR7*kZD9A0O7=`ka=WLKrtj45D5eU009IE5E&#fKv86Qkg3Gs03k$akh$a$Kyjqm5J`l=06~Pw5Lu-0"
    "K#}A*km*FB0Aa)_kojcMK(Qp55QzkV0D%OF5Sb*gx&QzG8vp?S5&;1K5CQ=J@SOt#0|NvE1Ox>I1qB8M"
    "1_uWR2nY!Y2?`1d3kwVk4Gj(s4-XI!5fKs+6B85^6%`g27Z@2C8X6lM9337WA0QziA|oUuB_<~)C@Cr{"
    "D=aN8FEBANGBY$aHa9pqIy*c)K0iP~LPJDFMn_0VN=r;lPES!%Q&d$}S6NzHTwPyaVPa%uW@l+?Yiw?B"
    "aB_2Wc6WJtdwqU?fr5mEhlq-cjgF9!la!X1nVJg#0018V0RXR10000001E&B03QGW0IyI0000003jhEB"
    "9{>RWuTTI00000B0000V00986Pyhe`000XB0018V0RXR10000001E&B03QGW0IyI000000"
)
"""200 whole numbers of 8 bytes, the squares of 0, 1, 2..."""


def test_an_array_of_version_2_with_blosc(tmp_path):
    (tmp_path / "a").mkdir()
    said = {
        "shape": [200],
        "chunks": [200],
        "dtype": "<i8",
        "fill_value": 0,
        "order": "C",
        "compressor": {"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 1},
    }
    (tmp_path / "a/.zarray").write_text(json.dumps(said))
    (tmp_path / "a/0").write_bytes(base64.b85decode(BLOSC))
    squares = np.arange(200) ** 2
    np.testing.assert_array_equal(Group(tmp_path).array("a"), squares)


DAMAGE = [
    ("c/0", lambda b: b[:7], "ids: (damaged array|cannot read).*again"),
    (
        "zarr.json",
        lambda b: b.replace(b"shape", b"form"),
        "damaged array of Zarr: 'shape'; export it again",
    ),
    ("zarr.json", lambda b: b[:20], "zarr.json: damaged Zarr"),
    ("zarr.json", lambda b: b"[]", "damaged Zarr: no entries"),
    (
        "zarr.json",
        lambda b: b.replace(b"zstd", b"sharding_indexed"),
        "ids: Zarr with the codec sharding_indexed is not read; write .* zstd",
    ),
    (
        "zarr.json",
        lambda b: b.replace(b"int64", b"U4"),
        "Zarr with values of <U4 is not read",
    ),
    (
        "c/0",
        lambda b: b"\2\1\x24\x08" + bytes(100),
        "Blosc with its own compressor or with shuffled bits is not read",
    ),
]


@defects("file, damage, message", DAMAGE)
def test_damage_is_refused_in_one_line(tmp_path, file, damage, message):
    folder = write_graph(tmp_path / "a.geff")
    place = folder / "nodes/ids" / file
    if "Blosc" in message:
        said = folder / "nodes/ids/zarr.json"
        said.write_bytes(said.read_bytes().replace(b"zstd", b"blosc"))
    place.write_bytes(damage(place.read_bytes()))
    with told(message):
        read_recording(folder)


def test_filters_are_refused(tmp_path):
    (tmp_path / "a").mkdir()
    said = '{"shape": [4], "chunks": [4], "filters": [{"id": "delta"}]}'
    (tmp_path / "a/.zarray").write_text(said)
    with told("a: Zarr with filters is not read"):
        Group(tmp_path).array("a")
