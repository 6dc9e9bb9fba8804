import contextlib
import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from tests.fitted_runs import reproduced

from pinav import cli, files
from pinav.commands.reproduce import sections
from pinav.commands.reproduce.sections import Reproduction
from pinav.learning.learned import Learned
from pinav.runs import RunFolder


@pytest.fixture(scope="module")
def run(fitted_runs, tmp_path_factory) -> RunFolder:
    """A whole run of the command with a few steps, made once for all tests."""
    folder, _ = fitted_runs.copy("reproduced", tmp_path_factory.mktemp("reproduce"))
    return RunFolder.open(folder)


def reproduction(run: RunFolder) -> Reproduction:
    return run.load("metrics", Reproduction)


def words(out, *more):
    return [*reproduced(out), "--out", str(out), *more]


def results(folder: RunFolder) -> dict[str, bytes]:
    names = ["metrics.json", "table2.csv", "model-ude-42.eqx", "model-nn-only-1.eqx"]
    return {name: (folder.path / name).read_bytes() for name in names}


def test_a_stored_model_predicts_what_was_scored(run):
    from pinav.evaluation import predict
    from pinav.trajectories import load

    model = Learned.open(run.path).models["model-ude-42"]
    predicted, _ = predict(model, load(run.path / "data.npz"))
    stored = reproduction(run).rollout("ude-42").states
    np.testing.assert_array_equal(predicted[0], stored)


@pytest.mark.slow
def test_a_finished_run_is_not_done_again(run, printed):
    before = results(run)
    stamps = {p: p.stat().st_mtime_ns for p in run.path.glob("model*.eqx")}
    assert "paper" in printed(*words(run.path, "--resume"))
    assert results(run) == before
    assert {p: p.stat().st_mtime_ns for p in run.path.glob("model*.eqx")} == stamps


@contextlib.contextmanager
def kill_after(writes):
    """As `kill -9` between two files: the next write never happens."""
    done, write = [], files.os.replace

    def interrupted(*args):
        if len(done) == writes:
            raise KeyboardInterrupt
        done.append(args)
        write(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files.os, "replace", interrupted)
        yield


@pytest.fixture
def plain_figures(monkeypatch):
    """Every figure is written, but empty: drawing takes most of a resumed run."""

    for name in ("figure1", "force_comparison", "acceleration_figure"):
        monkeypatch.setattr(sections, name, lambda *args, **options: Figure())


@pytest.mark.slow
@pytest.mark.parametrize("writes", [0, 1, 2, 3, 5, 6, 8, 11])
def test_a_run_broken_off_at_any_write_ends_with_the_same_numbers(
    run, tmp_path, plain_figures, writes
):
    with kill_after(writes):
        assert cli.run(words(tmp_path / "broken")) == cli.INTERRUPTED
    assert cli.run(words(tmp_path / "broken", "--resume")) == 0
    assert results(RunFolder.open(tmp_path / "broken")) == results(run)


def test_json_prints_the_metrics(run, plain_figures, printed):
    found = json.loads(printed(*words(run.path, "--resume", "--json")))
    assert found == run.read_json("metrics.json")["value"]


@pytest.fixture(scope="module")
def default_run(tmp_path_factory) -> RunFolder:
    """The default recipe in full."""
    out = tmp_path_factory.mktemp("default") / "run"
    assert cli.run(["reproduce", "--seeds", "0", "--out", str(out)]) == 0
    return RunFolder.open(out)


@pytest.mark.slow
def test_the_default_recipe_leaves_the_paper_behind(default_run):
    result = default_run.load("metrics", Reproduction)
    total = {row.model: row.total for row in result.table2}
    assert total["ude"] <= 2e-3
    assert total["ude-kernel"] <= 1e-5
    assert total["nn-only"] < 0.015, "the black box too"
    assert result.losses["ude-kernel"].values.shape[1] <= 16
    assert result.force_error["ude-kernel"]["visited"] < 0.01
    assert "force-ude-kernel" in " ".join(map(str, default_run.path.rglob("*.svg")))


@pytest.mark.slow
def test_the_default_recipe_resumes_to_the_same_numbers(
    default_run, tmp_path, plain_figures
):
    argv = ["reproduce", "--seeds", "0", "--out", str(tmp_path / "run")]
    with kill_after(11):
        assert cli.run(argv) == cli.INTERRUPTED
    assert cli.run([*argv, "--resume"]) == 0
    for name in ("metrics.json", "table2.csv", "model-ude-0.eqx"):
        resumed = (tmp_path / "run" / name).read_bytes()
        assert resumed == (default_run.path / name).read_bytes()
