"""`pinav heat`: cases from files, their refusal, and what a run leaves behind."""

import csv
import json
import tomllib

import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w
from tests.heat_cases import EXAMPLES, ball, run, write

from pinav import cli
from pinav.runs import RunFolder
from pinav.thermal.case import read_case
from pinav.thermal.design import Run
from pinav.thermal.planned_run import PlanTask
from pinav.thermal.setup import Setup


def small(name, folder, **changes):
    """An example on a coarse grid, with tables changed: its file."""
    content = ball(name) | {"step": 20.0}
    for table, values in changes.items():
        if isinstance(values, dict):
            content.setdefault(table, {}).update(values)
            content[table] = {k: v for k, v in content[table].items() if v is not None}
        else:
            content[table] = values
    return write(folder, content, name=f"{name}.toml")


@pytest.mark.slow
def test_simulate_leaves_metrics_figures_and_a_report(tmp_path, capsys):
    case, out = small("tumour", tmp_path), tmp_path / "run"
    assert run("simulate", case, "--out", out) == 0
    printed = capsys.readouterr().out
    assert "D90 of the tumour" in printed
    assert "Synthetic data of a research code" in printed
    metrics = json.loads((out / "metrics.json").read_text())["value"]
    assert metrics["imbalance"] < 1e-10
    assert 44 < metrics["T_max"] < 48
    assert metrics["T90"] < metrics["T50"] < metrics["T10"] <= metrics["T_max"]
    page = (out / "report.html").read_text()
    assert "nothing here is medical advice" in page
    assert "heat-" not in page  # images are embedded
    assert {p.stem for p in (out / "figures").glob("*.svg")} == {
        "heat-fields",
        "heat-protocol",
        "heat-probes",
    }
    assert run("simulate", case, "--out", out) == cli.USAGE_ERROR
    assert "already holds a run" in capsys.readouterr().err
    assert cli.run(["report", str(out)]) == 0


@pytest.mark.slow
def test_simulate_in_the_plane_with_particles(tmp_path, capsys):
    case = small(
        "tumour",
        tmp_path,
        grid={"kind": "box", "cells": [16, 16], "size": 2.5e-3, "radius": None},
        heating={
            "kind": "particles",
            "density": None,
            "reference": None,
            "concentration": 5.0,
            "diameter": 16.0,
            "bound": False,
        },
        probes={"points": [[0.02, 0.02]]},
        eddy={"radius": 0.1, "conductivity": 0.4},
        wall={"exchange": 20.0, "ambient": 25.0},
        field={"times": [0, 120]},
        step=5.0,
    )
    assert run("simulate", case, "--out", tmp_path / "run", "--json") == 0
    metrics = json.loads(capsys.readouterr().out)
    (warning,) = metrics["warnings"]
    assert "strained 2.81 times" in warning
    assert metrics["Hf"] == pytest.approx(1e9)


@pytest.mark.slow
def test_learn_compares_with_constant_perfusion(tmp_path, capsys):
    case, out = small("learn", tmp_path), tmp_path / "run"
    assert run("learn", case, "--out", out) == 0
    metrics = json.loads((out / "metrics.json").read_text())["value"]
    assert metrics["residual"] < 0.7 * metrics["constant_residual"]
    assert metrics["noise"] == pytest.approx(0.1, rel=0.1)
    assert {row["power"] for row in metrics["held_out"]} == {1.3, 0.6}
    assert "residual of the best constant perfusion" in capsys.readouterr().out
    assert (out / "figures" / "heat-perfusion.svg").exists()


def test_learn_reads_probes_beside_the_case(tmp_path, capsys):
    with open(tmp_path / "probes.csv", "w", newline="") as file:
        rows = [(60.0 * k, 0.0, 37.0 + 0.1 * k) for k in range(1, 9)]
        csv.writer(file).writerows([("t", "r", "T"), *rows])
    case = small("learn", tmp_path, learn={"data": "absent.csv", "held_out": []})
    assert run("learn", case, "--out", tmp_path / "run") == cli.USAGE_ERROR
    assert "absent.csv: cannot be read" in capsys.readouterr().err


@pytest.mark.slow
def test_optimise_names_what_binds(tmp_path, capsys):
    times = [0, 450, 900, 1350, 1800]
    case = small("optimise", tmp_path, field={"times": times, "amplitudes": [1e4] * 4})
    out = tmp_path / "run"
    assert run("optimise", case, "--out", out) == 0
    metrics = json.loads((out / "metrics.json").read_text())["value"]
    names = {own["name"]: own["active"] for own in metrics["constraints"]}
    assert names == {"maximum temperature": True, "Hergt-Dutz limit": False}
    assert metrics["result"]["D90"] > metrics["start_D90"]
    assert "maximum temperature [°C]" in capsys.readouterr().out


def test_a_ramp_stays_a_ramp_in_a_plan(tmp_path):
    field = {"times": [0, 600, 1800], "amplitudes": None, "ramp": [0, 1e4, 5e3]}
    path = small("optimise", tmp_path, field=field)
    case, _ = read_case(path)
    task = PlanTask.of(case, Setup.of(case, tmp_path), tmp_path)
    (variable,) = task.variables
    plan = variable.apply(jnp.ones(1), Run(task.setup.model, task.setup.protocol))
    assert np.allclose(plan.protocol.starts, [0.0, 2e4])
    assert np.allclose(plan.protocol.ends, [2e4, 1e4])


def test_tasks_say_what_they_need(tmp_path, capsys):
    case = small("tumour", tmp_path)
    assert run("optimise", case, "--out", tmp_path / "b") == cli.USAGE_ERROR
    assert "expected a table [optimise]" in capsys.readouterr().err
    bare = tomllib.loads(case.read_text())
    del bare["probes"]
    case.write_text(tomli_w.dumps(bare))
    assert run("learn", case, "--out", tmp_path / "c") == cli.USAGE_ERROR
    assert "learn: expected data, a CSV file, or probes" in capsys.readouterr().err
    assert run("simulate", tmp_path / "no.toml", "--out", tmp_path / "d") == 2
    assert "cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda p: p.name)
def test_the_examples_are_cases(path):
    own = Setup.read(path)
    assert own.model.grid.shape == own.body.target.shape


@pytest.mark.slow
def test_damage_and_a_law_of_ones_own(tmp_path, capsys):
    law = {"temperatures": [37, 45], "values": [0.5, 4.0], "unit": "kg/m3/s"}
    case = small("tumour", tmp_path, damage={"law": "liver"}, tissue={"perfusion": law})
    assert run("simulate", case, "--out", tmp_path / "run") == 0
    assert "dead fraction of the tumour (Arrhenius)" in capsys.readouterr().out
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())["value"]
    # at T50 of about 44.5 °C for half an hour, 3e-3 a second
    assert metrics["dead_outside"] < metrics["dead_target"] < 1
    assert metrics["dead_target"] > 0.5


@pytest.mark.slow
def test_a_run_records_its_case(tmp_path):
    case, out = small("tumour", tmp_path), tmp_path / "run"
    assert run("simulate", case, "--out", out) == 0
    config = RunFolder.open(out).config()
    assert config["run"]["command"] == "heat"
    assert config["case"]["title"] == "A heated sphere"
    rows = list(csv.DictReader((out / "probes.csv").read_text().splitlines()))
    assert [float(row["t"]) for row in rows[::4]] == [10.0 * k for k in range(1, 181)]
