"""The paper's network on one trajectory beside a kernel potential on several."""

import equinox as eqx
import pytest
from benchmarks.__main__ import run
from benchmarks.paper_weakness import Weakness

from benchmarks import paper_weakness
from pinav.runs import RunFolder
from pinav.scenarios.planar import paper_barrier, paper_swimmer


@pytest.mark.slow
def test_the_papers_weakness_stands_beside_what_several_trajectories_give(
    tmp_path, monkeypatch, capsys
):
    """The truth in place of one fit, a barrier of half the height of the other."""
    half = eqx.tree_at(lambda force: force.height, paper_barrier(), 5.25 / 2)
    models = {"model-ude.eqx": paper_swimmer(half), "model-kernel.eqx": paper_swimmer()}
    monkeypatch.setattr(
        paper_weakness, "_read_or_fit", lambda _, name, *rest: models[name]
    )
    out = tmp_path / "run"
    argv = ["paper-weakness", "--out", str(out), "--held-out", "3"]
    assert run([*argv, "--count", "1"]) == 0
    found = RunFolder.open(out).load("metrics", Weakness).models
    ude, kernel = found[paper_weakness.UDE], found[paper_weakness.KERNEL]
    errors = [one.error for one in ude.force.values()]
    assert errors == pytest.approx([0.5] * len(errors))
    assert {one.error for one in kernel.force.values()} == {0.0}
    assert kernel.rollouts.high < 1e-8 < ude.rollouts.median
    physics = found[paper_weakness.PHYSICS].force
    assert physics["unvisited"].error == pytest.approx(1.0)
    assert "UDE with time, one trajectory" in capsys.readouterr().out
    page = (out / "report.html").read_text()
    assert "The paper&#x27;s weakness in one figure" in page
    assert "Gauss-Newton curriculum of pinav, not the paper&#x27;s optimiser" in page
