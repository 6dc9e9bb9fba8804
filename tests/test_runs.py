import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w
from tests.defects import told

from pinav.manifest import MANIFEST_FILE, REPAIR, Manifest
from pinav.runs import SCHEMA, RunFolder, environment

CONFIG = {
    "run": {"schema": SCHEMA, "command": "test"},
    "seeds": [1, 2],
    "recipe": "paper",
}


@pytest.fixture(autouse=True)
def advice():
    """The words that the command line gives for damaged files."""
    token = REPAIR.set("delete it and repeat pinav test with --resume")
    yield
    REPAIR.reset(token)


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
    with told("already holds a run; replace it with"):
        RunFolder.create(folder.path, CONFIG, overwrite=False)
    assert folder.read_json("metrics.json") == {"a": 1}
    RunFolder.create(folder.path, CONFIG | {"recipe": "default"}, overwrite=True)
    assert not folder.has("metrics.json")
    assert folder.config()["recipe"] == "default"


def test_overwriting_leaves_what_is_not_ours(folder, tmp_path):
    names = ("notes.txt", "raw.csv", "notes.json", "tracks.npz", ".mine.tmp")
    for name in names:
        (folder.path / name).write_text("mine")
    folder.write_table("table.csv", ("a",), [(1,)])
    RunFolder.create(folder.path, CONFIG, overwrite=True)
    assert all((folder.path / name).read_text() == "mine" for name in names)
    assert not folder.has("table.csv")
    # Whatever its manifest says, which a damaged or foreign file may say.
    outside = tmp_path / "outside"
    outside.mkdir()
    (folder.path / "linked").symlink_to(outside)
    for name in ("../outside/one.csv", "linked/two.csv", "three.csv"):
        (folder.path / name).write_text("mine")
        folder.manifest.record(name)
    RunFolder.create(folder.path, CONFIG, overwrite=True)
    assert {path.name for path in outside.iterdir()} == {"one.csv", "two.csv"}
    assert not folder.has("three.csv")


def test_a_killed_process_leaves_nothing_and_starts_again(folder, tmp_path):
    (folder.path / ".model.eqx.0badcafe.tmp").write_text("half")
    RunFolder.resume(folder.path, CONFIG)
    assert not list(folder.path.glob(".*.tmp"))
    killed = tmp_path / "killed"
    killed.mkdir()
    (killed / ".config.toml.0badcafe.tmp").write_text("job = ")
    (killed / "environment.json").write_text("{}")
    assert RunFolder.resume(killed, CONFIG).config() == CONFIG


def test_a_first_attempt_without_results_does_not_block_the_next(folder):
    other = CONFIG | {"seeds": [3]}
    assert RunFolder.create(folder.path, other, overwrite=False).config() == other
    folder.write_model("model.eqx", {}, {"w": jnp.zeros(2)})
    with told("holds a run; continue it with --resume, "):
        RunFolder.create(folder.path, CONFIG, overwrite=False)


def test_a_file_of_another_run_is_refused(folder):
    folder.write_model("model.eqx", {}, {"w": jnp.zeros(2)})
    content = (folder.path / "model.eqx").read_bytes()
    (folder.path / "model.eqx").write_bytes(content.replace(b"pinav", b"other"))
    with told("is not the file that this run wrote; delete"):
        folder.read_model("model.eqx", lambda header: {"w": jnp.zeros(2)})


def test_other_places_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with told("is a file; choose another folder"):
        RunFolder.create(tmp_path / "file", CONFIG, overwrite=True)
    with told("is not empty and holds no run; choose"):
        RunFolder.create(tmp_path, CONFIG, overwrite=True)
    with told("cannot be made .*; choose another --out"):
        RunFolder.create(tmp_path / "file" / "below", CONFIG, overwrite=False)
    with told(r"holds no run \(no config.toml\); give"):
        RunFolder.open(tmp_path)


def test_resume_wants_the_same_settings_and_schema(folder):
    assert RunFolder.resume(folder.path, CONFIG).config() == CONFIG
    with told(r"holds a run with seeds = \[1, 2\], not \[3\]"):
        RunFolder.resume(folder.path, CONFIG | {"seeds": [3]})
    config = {"run": {"schema": 1, "command": "test"}}
    (folder.path / "config.toml").write_text(tomli_w.dumps(config))
    for read in (RunFolder.open, lambda path: RunFolder.resume(path, CONFIG)):
        with told(r"another version of pinav \(schema 1"):
            read(folder.path)


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
    folder.manifest.record("model.eqx")
    with told(r"model.eqx cannot be read \(.*\); delete it"):
        folder.read_model("model.eqx", lambda header: jnp.zeros(3))


def test_damaged_results_are_named(folder):
    for name, read in {
        "metrics.json": folder.read_json,
        "results.npz": folder.read_arrays,
    }.items():
        (folder.path / name).write_bytes(b"{")
        folder.manifest.record(name)
        with told(f"{name} cannot be read .*--resume"):
            read(name)
    (folder.path / "config.toml").write_text("a = ")
    with told("config.toml: cannot be read"):
        folder.config()


def test_the_record_survives_a_cut_line_and_a_repeated_chunk(folder):
    for step, loss in ((1, 5.0), (2, 4.0), (2, 4.0)):
        folder.append_record({"model": "ude", "step": step, "loss": loss})
    with open(folder.path / "metrics.jsonl", "a") as file:
        file.write('{"model": "ude", "st')
    folder.append_record({"model": "ude", "step": 3, "loss": np.inf})
    *lines, cut, last = (folder.path / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line)["step"] for line in lines] == [1, 2, 2]
    assert cut == '{"model": "ude", "st'
    assert json.loads(last) == {"model": "ude", "step": 3, "loss": None}


def test_tables_are_csv_and_numbers_that_are_not_finite_null(folder):
    folder.write_table("t.csv", ("a", "b"), [(1, "x,y"), (2, "")])
    assert (folder.path / "t.csv").read_text() == 'a,b\n1,"x,y"\n2,\n'
    folder.write_json("metrics.json", {"a": np.inf, "b": np.array([1.0, np.nan])})
    text = (folder.path / "metrics.json").read_text()
    assert json.loads(text) == {"a": None, "b": [1.0, None]}


@pytest.mark.parametrize("content", [b"{", b"[1]", b'{"a\x80": {}}', b"\xff\xfe{"])
def test_a_damaged_manifest_names_no_files(content, tmp_path):
    (tmp_path / MANIFEST_FILE).write_bytes(content)
    assert Manifest(tmp_path).entries() == {}
