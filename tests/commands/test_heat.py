"""`pinav heat`: cases from files, their refusal, and what a run leaves behind."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from tests.heat_cases import EXAMPLES, GONE, PLANE, run, small

from pinav.thermal.case import read_case
from pinav.thermal.design import Run
from pinav.thermal.planned_run import PlanTask
from pinav.thermal.setup import Setup


@pytest.mark.slow
def test_simulate_in_the_plane_with_particles(tmp_path, printed):
    particles = {"kind": "particles", "concentration": 5.0, "diameter": 16.0}
    changes = PLANE | {
        "heating": particles | {"bound": False},
        "eddy": {"radius": 0.1, "conductivity": 0.4},
        "wall": {"exchange": 20.0, "ambient": 25.0},
        "field.times": [0, 120],
        "step": 5.0,
    }
    case = small("tumour", tmp_path, changes)
    words = ["heat", "simulate", case, "--out", tmp_path / "run", "--json"]
    metrics = json.loads(printed(*words))
    (warning,) = metrics["warnings"]
    assert "strained 2.81 times" in warning
    assert metrics["Hf"] == pytest.approx(1e9)


def test_a_ramp_stays_a_ramp_in_a_plan(tmp_path):
    field = {"field.times": [0, 600, 1800], "field.ramp": [0, 1e4, 5e3]}
    path = small("optimise", tmp_path, field | {"field.amplitudes": GONE})
    case, _ = read_case(path)
    task = PlanTask.of(case, Setup.of(case, tmp_path), tmp_path)
    (variable,) = task.variables
    plan = variable.apply(jnp.ones(1), Run(task.setup.model, task.setup.protocol))
    assert np.allclose(plan.protocol.starts, [0.0, 2e4])
    assert np.allclose(plan.protocol.ends, [2e4, 1e4])


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda p: p.name)
def test_the_examples_are_cases(path):
    own = Setup.read(path)
    assert own.model.grid.shape == own.body.target.shape


@pytest.mark.slow
def test_damage_and_a_law_of_ones_own(tmp_path, capsys):
    law = {"temperatures": [37, 45], "values": [0.5, 4.0], "unit": "kg/m3/s"}
    changes = {"damage": {"law": "liver"}, "tissue.perfusion": law}
    case = small("tumour", tmp_path, changes)
    assert run("simulate", case, "--out", tmp_path / "run") == 0
    assert "dead fraction of the tumour (Arrhenius)" in capsys.readouterr().out
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())["value"]
    # at T50 of about 44.5 °C for half an hour, 3e-3 a second
    assert metrics["dead_outside"] < metrics["dead_target"] < 1
    assert metrics["dead_target"] > 0.5
