"""Tables of controllers and strategies; what a folder holds is not flown again."""

import json

import pytest
from benchmarks.navigate import main
from benchmarks.navigate.strategies import compare_strategies

from pinav.runs import RunFolder


def row(regret):
    share = {"value": 1.0, "lower": 0.8, "upper": 1.0}
    return {
        "runs": 2,
        "success": share,
        "in_time": share,
        "violation": share,
        "arrival": {"low": 5.0, "median": 5.5, "high": 6.0},
        "regret": regret,
        "clearance": 0.4,
        "force_error": 0.1,
        "cover": 0.9,
        "consistency": 1.1,
        "changed": 0.0,
        "frame_time": 0.002,
        "command_time": 0.004,
        "replan_time": 0.05,
        "memory": 1e6,
    }


def test_finished_tasks_are_read(tmp_path, capsys):
    out = tmp_path / "bench"
    config = {"run": {"command": "bench-navigate-learn-online"}, "seeds": 2}
    folder = RunFolder.resume(out, config)
    certain = row({"value": 1.25, "lower": 1.2, "upper": 1.3})
    rows = {"oracle": row(None), "certain": certain}
    folder.write_json("learn-online-vortex.json", rows)
    compare_strategies(out, ["vortex"], 2)
    assert "1.250 (1.200–1.300)" in capsys.readouterr().out
    main(["--learn-online", "--tasks", "vortex", "--seeds", "2", "--out", str(out)])
    assert "1.250 (1.200–1.300)" in capsys.readouterr().out
    assert (out / "learn-online-vortex.csv").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
def test_a_learned_current_serves_a_follower(tmp_path):
    """One fit and two runs; the swimmers are observed under a programme of commands."""
    out = tmp_path / "bench"
    main(["--tasks", "follow-line", "--fits", "1", "--seeds", "2", "--out", str(out)])
    rows = json.loads((out / "task-follow-line.json").read_text())["controllers"]
    assert rows["learned"]["tracking"] < rows["physics only"]["tracking"] / 3
