"""Graphs of GEFF, as folders of Zarr that the tests write: no package for it is needed.

The bytes of `BLOSC` were made by numcodecs 0.15 with lz4 and shuffled bytes.
"""

import base64
import json
import zlib

import numpy as np
import pyarrow
import pytest

from pinav.errors import InputError
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


def test_a_branch_ends_a_track(tmp_path):
    divided = np.array([[3, 8], [8, 1], [8, 4], [5, 9]])
    data = read_recording(write_graph(tmp_path / "a.geff", edges=divided))
    assert sorted(one["particle"] for one in labels(data)) == ["0", "2"]
    assert [len(one.times) for one in data] == [2, 2]  # one node alone is no path


def test_tracklets_that_the_metadata_name_are_kept(tmp_path):
    named = {"track_node_props": {"tracklet": "lineage"}}
    folder = write_graph(tmp_path / "a.geff", **named)
    assert [one["particle"] for one in labels(read_recording(folder))] == ["7", "2"]


def test_the_only_graph_in_a_store_is_read_and_two_are_refused(tmp_path):
    write_group(tmp_path / "all.zarr", {})
    write_graph(tmp_path / "all.zarr" / "first")
    assert len(read_recording(tmp_path / "all.zarr")) == 2
    write_graph(tmp_path / "all.zarr" / "second")
    with pytest.raises(InputError, match="got first, second; give its folder"):
        read_recording(tmp_path / "all.zarr")


def test_an_axis_that_is_missing_is_named(tmp_path):
    with pytest.raises(InputError, match=r"axes t, x: y is not among them"):
        read_recording(write_graph(tmp_path / "a.geff", axes=[AXES[0], AXES[2]]))


def test_ids_that_are_missing_are_named(tmp_path):
    folder = write_graph(tmp_path / "a.geff")
    (folder / "edges/ids/zarr.json").unlink()
    with pytest.raises(InputError, match="ids of nodes or of edges are missing"):
        read_recording(folder)


@pytest.mark.parametrize(
    ("codec", "compress"),
    [("", bytes), ("zstd", zstd), ("zlib", zlib.compress)],
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
    "0s$ci02u%P02u%P(*ytj6aWAK4FLcE|M36;1PKrsBr!lyWO<OO#NhxTL}`$@<Pkt|q}dQjguwtogvk(D"
    "r13zJ<T;S(M4<p-#3_*ZWYIveB$*J21c3m71c?xtB(XrzWciRO#9;uTMCp(@<dHz}q*)Njgh2qogh>$D"
    "q;WtI<hhV(L?Hm-#Ho;ZWKlpdBpDD11OWg61PKrsBr!lyWO<OO#NhxTL}`$@<Pkt|q}dQjguwtogvk(D"
    "r13zJ<T;S(M4<p-#3_*ZWYIveB$*J21c3m71c?xtB(XrzWciRO#9;uTMCp(@<dHz}q*)Njgh2qogh>$D"
    "q;WtI<hhV(L?Hm-#Ho;ZWKlpdBpDD11OWg6|Njb5*$_#D!4v}k02=@S01^QK01yHJ0Pz3+_X7h10|W#F"
    "1O){J1qKEN2L}fT2nh)Z3JMAf3k(bm4Gs<u4-gO$5fTy;6BHB`6&4p47#SHF8XFuO9UdMZAR!?lBP1jx"
    "CMPE-DJm-~EG;fCFflPQGc+|eH#j*uJ3Ku;KR`i3LqtVJM@UIZOH55pPf=1+R8>}2Sz23MU0+~fVq|4z"
    "XK89{Y;JFGa&vTccX@hyeSUv|f`o;Kh>DAij*yX)l$Mv7nw*`VprWLur>Ux}t*^1Nw6?doyS=`^!o<bL"
    "$;-^n(9+b^*V)_M-{Ioq=IH9|?(p*T_W1hz{s0051_%la4iFL)78n{F9w8$oCn+l}FfueYI6FN*K}1GK"
    "N=;8uQ&w17U0-2jW@&3}aB_5ad3=6>gNBHUjgXR+mztcPp`@m%tFE!Lwz<2$z{AGK%g)f#*4f+M;pFD&"
    "?C<gP_xk<+0tE;Q4iOU;85|!XB`7N{F*G+iJwQW7NlZ^tRajeIVPt1&ZE<vWdVPR{hl-7mlb4#Eprog&"
    "t+BMXy1v20$ji>s)!E$N<L2q@@bvfl{sILF3=k6+8Xh4fC@e2CHab2*MM+FhQ&(GFVrFS=adminfP{yO"
    "kCT>~o}#9yt+BPay}`uD%+S=>+~DNs?C|vX`~U<93=k9;93UhpEHE@UJV8ZCO;J@@USeiyZgY2ge}ssP"
    "kd>L8p{A;?v$wmz#L3Ok*4p0V=j`zH`Thb23lJ0;9U>+xFEltkK}JhYR9RhOW@~VCd47V2jFFX^pQNa*"
    "vbVdy#mdjq*xlmi?D6&b{{#sR6Br#LCoC~GJ3vKBPgGf6V`y!1cYJ|{i;<R_prxv>wYtB=$<Nf;-sI`-"
    "^ZEV*2o4h%9wR6&GdVs(NlsH)USw%+bb5b<ijb9?pr)&_w!Fc|%+lE1<LU17`Tqq95EdIDCoM8KK14}R"
    "Ra;<YY;t&ggNcuoo1vzxvbes)%Fx!_;^^-5`TzzD5*QvNDlj%YLP$<jT485xb9sM-jFOn1q^q&Fy*K~>"
    "03QGW0PG(D0RUGY0s#O$9|HjZFdqZ~04W~@0RST(1_1yb9|r*d8y^S(02dz#0RRV32?+@a2@U`N03QGW"
    "0RR903Qzz50000E0000V00991|Njb50000001f~E03QGW0RR903Qzz50000E0000V00991|Njb500000"
    "01f~E03QGW0RR903Qzz50000"
)
"""800 whole numbers of 8 bytes, the squares of 0, 1, 2..."""


def test_an_array_of_version_2_with_blosc(tmp_path):
    (tmp_path / "a").mkdir()
    said = {
        "shape": [800],
        "chunks": [800],
        "dtype": "<i8",
        "fill_value": 0,
        "order": "C",
        "compressor": {"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 1},
    }
    (tmp_path / "a/.zarray").write_text(json.dumps(said))
    (tmp_path / "a/0").write_bytes(base64.b85decode(BLOSC))
    squares = np.arange(800) ** 2
    np.testing.assert_array_equal(Group(tmp_path).array("a"), squares)


DAMAGE = {
    "cut chunk": ("c/0", lambda b: b[:7], "ids: (damaged array|cannot read).*again"),
    "no shape": (
        "zarr.json",
        lambda b: b.replace(b"shape", b"form"),
        "damaged array of Zarr: 'shape'; export it again",
    ),
    "no JSON": ("zarr.json", lambda b: b[:20], "zarr.json: damaged Zarr"),
    "no entries": ("zarr.json", lambda b: b"[]", "damaged Zarr: no entries"),
    "unknown codec": (
        "zarr.json",
        lambda b: b.replace(b"zstd", b"sharding_indexed"),
        "ids: Zarr with the codec sharding_indexed is not read; write .* zstd",
    ),
    "words": (
        "zarr.json",
        lambda b: b.replace(b"int64", b"U4"),
        "Zarr with values of <U4 is not read",
    ),
    "shuffled bits": (
        "c/0",
        lambda b: b"\2\1\x24\x08" + bytes(100),
        "Blosc with its own compressor or with shuffled bits is not read",
    ),
}


@pytest.mark.parametrize(("file", "damage", "message"), DAMAGE.values(), ids=DAMAGE)
def test_damage_is_refused_in_one_line(tmp_path, file, damage, message):
    folder = write_graph(tmp_path / "a.geff")
    place = folder / "nodes/ids" / file
    if "Blosc" in message:
        said = folder / "nodes/ids/zarr.json"
        said.write_bytes(said.read_bytes().replace(b"zstd", b"blosc"))
    place.write_bytes(damage(place.read_bytes()))
    with pytest.raises(InputError, match=message) as caught:
        read_recording(folder)
    assert "\n" not in str(caught.value)


def test_filters_are_refused(tmp_path):
    (tmp_path / "a").mkdir()
    said = '{"shape": [4], "chunks": [4], "filters": [{"id": "delta"}]}'
    (tmp_path / "a/.zarray").write_text(said)
    with pytest.raises(InputError, match="a: Zarr with filters is not read"):
        Group(tmp_path).array("a")
