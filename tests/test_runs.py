import errno
import json
import os

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.errors import InputError
from pinav.runs import RunFolder, environment

CONFIG = {"run": {"command": "test"}, "seeds": [1, 2], "recipe": "paper"}


@pytest.fixture
def folder(tmp_path):
    return RunFolder.create(tmp_path / "run", CONFIG, overwrite=False)


def test_a_new_run_says_how_it_was_made(folder):
    assert folder.config() == CONFIG
    saved = folder.read_json("environment.json")
    assert saved == environment()
    assert {"pinav", "python", "platform", "jax", "diffrax"} <= saved.keys()


def test_an_existing_run_is_kept_unless_overwritten(folder):
    folder.write_json("metrics.json", {"a": 1})
    with pytest.raises(InputError, match="already holds a run; go on with --resume"):
        RunFolder.create(folder.path, CONFIG, overwrite=False)
    assert folder.read_json("metrics.json") == {"a": 1}
    RunFolder.create(folder.path, CONFIG | {"recipe": "default"}, overwrite=True)
    assert not folder.has("metrics.json")
    assert folder.config()["recipe"] == "default"


def test_overwriting_leaves_what_is_not_ours(folder):
    (folder.path / "notes.txt").write_text("mine")
    RunFolder.create(folder.path, CONFIG, overwrite=True)
    assert (folder.path / "notes.txt").read_text() == "mine"


def test_other_places_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file; choose another folder"):
        RunFolder.create(tmp_path / "file", CONFIG, overwrite=True)
    with pytest.raises(InputError, match="is not empty and holds no run; choose"):
        RunFolder.create(tmp_path, CONFIG, overwrite=True)
    with pytest.raises(InputError, match="cannot be made .*; choose another --out"):
        RunFolder.create(tmp_path / "file" / "below", CONFIG, overwrite=False)
    with pytest.raises(InputError, match=r"holds no run \(no config.toml\); give"):
        RunFolder.open(tmp_path)


def test_resume_wants_the_same_settings(folder):
    assert RunFolder.resume(folder.path, CONFIG).config() == CONFIG
    with pytest.raises(
        InputError, match=r"holds a run with seeds = \[1, 2\], not \[3\]"
    ):
        RunFolder.resume(folder.path, CONFIG | {"seeds": [3]})


def test_resume_starts_where_nothing_was_saved(tmp_path):
    killed = tmp_path / "killed"
    killed.mkdir()
    (killed / ".config.toml.0badcafe.tmp").write_text("job = ")
    (killed / "environment.json").write_text("{}")
    assert RunFolder.resume(killed, CONFIG).config() == CONFIG


def test_a_model_comes_back_as_it_was(folder):
    model = {"w": jnp.arange(3.0), "n": 2.5}
    folder.write_model("model.eqx", {"kind": "test"}, model)
    like = {"w": jnp.zeros(3), "n": 0.0}
    headers = []

    def build(header):
        headers.append(header)
        return like

    assert eqx.tree_equal(folder.read_model("model.eqx", build), model)
    assert headers[0]["kind"] == "test"
    assert folder.models() == ["model.eqx"]


@pytest.mark.parametrize("damage", [b"", b"not json\n", b"{}\nrubbish"])
def test_a_damaged_model_is_named(folder, damage):
    (folder.path / "model.eqx").write_bytes(damage)
    with pytest.raises(InputError, match=r"model.eqx cannot be read \(.*\); delete it"):
        folder.read_model("model.eqx", lambda header: jnp.zeros(3))


def test_damaged_results_are_named(folder):
    for name, read in {
        "metrics.json": folder.read_json,
        "results.npz": folder.read_arrays,
    }.items():
        (folder.path / name).write_bytes(b"{")
        with pytest.raises(InputError, match=f"{name} cannot be read .*--resume"):
            read(name)
    (folder.path / "config.toml").write_text("a = ")
    with pytest.raises(InputError, match="config.toml cannot be read"):
        folder.config()


def test_numbers_that_are_not_finite_become_null(folder):
    folder.write_json("metrics.json", {"a": np.inf, "b": np.array([1.0, np.nan])})
    text = (folder.path / "metrics.json").read_text()
    assert json.loads(text) == {"a": None, "b": [1.0, None]}


def test_the_record_survives_a_cut_line_and_a_repeated_chunk(folder):
    for step, loss in ((1, 5.0), (2, 4.0), (2, 4.0)):
        folder.append_record({"model": "ude", "step": step, "loss": loss})
    with open(folder.path / "metrics.jsonl", "a") as file:
        file.write('{"model": "ude", "st')
    assert [record["step"] for record in folder.records()] == [1, 2]
    folder.append_record({"model": "ude", "step": 3, "loss": 3.0})
    assert [record["step"] for record in folder.records()] == [1, 2, 3]


def test_a_table_is_plain_csv(folder):
    folder.write_table("t.csv", ("a", "b"), [(1, "x,y"), (2, "")])
    assert (folder.path / "t.csv").read_text() == 'a,b\n1,"x,y"\n2,\n'


def test_a_full_disk_leaves_the_old_file(folder, monkeypatch):
    folder.write_json("metrics.json", {"a": 1})

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="metrics.json: .*No space left on device"):
        folder.write_json("metrics.json", {"a": 2})
    assert folder.read_json("metrics.json") == {"a": 1}
    assert not list(folder.path.glob("*.tmp"))
