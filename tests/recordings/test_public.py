"""Public recordings: a wrong file, a missing network, and the tables written."""

import functools
import gzip
import hashlib
import http.server
import json
import threading
import urllib.error

import numpy as np
import pytest
from scipy.io import savemat
from tests.recordings.synthetic import packed
from validation.truth.cases import BUILT_IN, read_recording

from pinav import cli
from pinav.errors import InputError
from pinav.recordings import public
from pinav.recordings.public import PUBLIC, fetch_recording, public_recording

CONTENT = {
    "ring_driven_bead": packed(np.savetxt, np.arange(80.0).reshape(2, 40)),
    "dragged_trap": packed(np.savetxt, [[1, 2, 0], [1.5, 2.25, 0.0069]]),
    "trap_at_rest": b"\n" + packed(np.savetxt, [[2e-8, 0], [-1e-8, 0.0069]]),
    "wall_bead_60hz": packed(savemat, {name: np.array([[1.0, 2.5]]) for name in "xyz"}),
}


def expect(name, monkeypatch):
    """The checksum of the small file is the one that is expected."""
    digest = hashlib.sha256(CONTENT[name]).hexdigest()
    faked = tuple(one._replace(sha256=digest) for one in PUBLIC)
    monkeypatch.setattr(public, "PUBLIC", faked)


@pytest.mark.parametrize("name", CONTENT)
def test_the_authors_file_becomes_the_table_that_truth_reads(
    name, tmp_path, monkeypatch
):
    expect(name, monkeypatch)
    source = tmp_path / "original"
    source.write_bytes(CONTENT[name])
    path = fetch_recording(name, tmp_path / "truth", source)
    recording = read_recording(path, BUILT_IN[name])
    assert len(recording.times) == 2
    assert np.isfinite(recording.positions).all()
    if name == "trap_at_rest":
        np.testing.assert_allclose(recording.positions[:, 0], [0.02, -0.01])
    assert gzip.decompress(path.read_bytes()).startswith(b"t_s,")
    with pytest.raises(InputError, match="exists already; choose another --out"):
        fetch_recording(name, tmp_path / "truth", source)


def test_another_file_and_no_file_are_refused(tmp_path):
    source = tmp_path / "other"
    source.write_bytes(b"1 2 3\n")
    with pytest.raises(InputError, match="expected the checksum 80da7843a802e782"):
        fetch_recording("dragged_trap", tmp_path, source)
    assert not (tmp_path / "dragged_trap").exists()
    with pytest.raises(InputError, match="none: cannot be read"):
        fetch_recording("dragged_trap", tmp_path, tmp_path / "none")
    with pytest.raises(InputError, match="recording 'moon' is unknown; choose one of"):
        public_recording("moon")


class Server(http.server.SimpleHTTPRequestHandler):
    """The files of a folder, without a word on the terminal."""

    def log_message(self, *words):
        del words


@pytest.fixture
def served(tmp_path, monkeypatch):
    """A folder whose files stand where those of the authors' repositories do."""
    folder = tmp_path / "served"
    folder.mkdir()
    handler = functools.partial(Server, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        host = f"http://127.0.0.1:{server.server_port}"
        local = property(lambda self: f"{host}/{self.name}")
        monkeypatch.setattr(public.PublicRecording, "address", local)
        monkeypatch.setenv("no_proxy", "127.0.0.1")
        yield folder
        server.shutdown()
        thread.join()


def test_a_recording_is_fetched_and_its_checksum_verified(
    served, tmp_path, monkeypatch, capsys, refused
):
    name = "dragged_trap"
    (served / name).write_bytes(CONTENT[name])
    words = ["data", "fetch", name, "--out", str(tmp_path / "truth")]
    refused(words, "expected the checksum 80da7843a802e782")
    assert not (tmp_path / "truth").exists()
    expect(name, monkeypatch)
    assert cli.run(words) == 0
    path = tmp_path / "truth" / name / "recording.csv.gz"
    assert str(path) in capsys.readouterr().out
    assert read_recording(path, BUILT_IN[name]).positions.shape == (2, 1)


def test_the_way_by_hand_and_the_list_are_told(tmp_path, monkeypatch, capsys, refused):
    def no_network(address, timeout):
        assert address.startswith("https://raw.githubusercontent.com/eXpensia/")
        raise urllib.error.URLError("no route to host")

    monkeypatch.setattr(public.urllib.request, "urlopen", no_network)
    words = ["data", "fetch", "wall_bead_60hz", "--out", str(tmp_path)]
    assert cli.run(words) == 2
    message = capsys.readouterr().err
    assert "no download (no route to host); by hand: git clone" in message
    assert cli.run(["data", "list", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["name"] for row in rows} == set(BUILT_IN)
    assert all(len(row["sha256"]) == 64 and row["licence"] for row in rows)
    refused(["data", "fetch"], "recording '' is unknown; choose one of")
