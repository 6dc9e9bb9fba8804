"""Bioheat: large grids, their cost, and the three demonstrations. Synthetic data."""

import json
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w
from benchmarks.heat import CASES, in_own_process, tumour
from validation.conftest import pinav
from validation.heat import exact
from validation.heat.checks import powers, reference_model
from validation.heat.exact import SET_S

from pinav.runs import RunFolder
from pinav.thermal.dose import value_exceeded_by
from pinav.thermal.grids import CartesianGrid, RadialGrid
from pinav.thermal.learned_tissue import LearnedTissue
from pinav.thermal.perfusion import ConstantPerfusion
from pinav.thermal.planned_run import PlannedRun
from pinav.thermal.protocols import Piecewise
from pinav.thermal.setup import Setup
from pinav.thermal.solve import solve

EXAMPLES = Path(__file__).parents[1] / "examples" / "heat"


@pytest.mark.parametrize("name", CASES)
def test_what_the_gradient_of_half_an_hour_costs(name):
    """In memory, and in runs; `python -m benchmarks heat` measures seconds."""
    cost = in_own_process(name)
    print(name, cost)
    assert cost.memory < CASES[name].memory
    assert cost.gradient < 6 * cost.forward


def test_the_heated_sphere_on_a_large_grid():
    """2e-2 K at 64³ cells of 0.94 mm."""
    grid = CartesianGrid.cubes((64, 64, 64), 0.94e-3)
    model = reference_model(grid, 4e5 * grid.ball(0.005))
    found = np.asarray(solve(model, powers((0.0, 300.0), [1.0])).final.temperature)
    r = np.asarray(grid.distances())
    for cell in [(32, 32, 32), (34, 33, 32), (37, 32, 32), (42, 36, 32)]:
        true = exact.heated_sphere(float(r[cell]), 300.0, SET_S, 4e5, 0.005)
        assert found[cell] - 37.0 == pytest.approx(true, abs=2e-2)


DEMO = [  # Q, perfusion: T(0) 5 min, T(0), T(R), T(R + 3 mm), T90
    (1.0e5, "const", (41.14, 42.98, 40.44, 39.15, 40.58)),
    (1.0e5, "Lang", (41.16, 43.20, 40.45, 39.13, 40.60)),
    (1.5e5, "const", (43.20, 45.96, 42.16, 40.22, 42.37)),
    (1.5e5, "Lang", (43.35, 46.19, 42.02, 40.04, 42.25)),
    (2.0e5, "const", (45.27, 48.95, 43.88, 41.30, 44.16)),
    (2.0e5, "Lang", (45.53, 48.88, 43.29, 40.73, 43.59)),
]


@pytest.mark.parametrize(("power", "perfusion", "listed"), DEMO)
def test_a_tumour_at_constant_field(power, perfusion, listed):
    """Demonstration 1, to 0.1 K."""
    model = tumour(RadialGrid.sphere(0.05, 200))
    share = model.grid.ball(0.010)
    model = eqx.tree_at(lambda m: m.sources[0].power, model, power * share)
    if perfusion == "const":
        rest = model.perfusion(jnp.full(model.grid.shape, 37.0))
        constant = ConstantPerfusion(rest)
        model = eqx.tree_at(lambda m: m.perfusion, model, constant)
    probes = model.grid.interpolation([0.0, 0.010, 0.013])
    found = solve(
        model,
        powers((0.0, 1800.0), [1.0]),
        save_at=[300.0, 1800.0],
        observe=lambda t: probes @ t,
    )
    t90 = value_exceeded_by(found.final.temperature, share * model.grid.volumes, 0.9)
    reached = [found.observed[0, 0], *found.observed[1], t90]
    print(power, perfusion, [round(float(v), 2) for v in reached])
    assert [float(v) for v in reached] == pytest.approx(listed, abs=0.1)


def ran(tmp_path, task, content, kind, name="case"):
    """The result of a task on a case, and its seconds."""
    case, out = tmp_path / f"{name}.toml", tmp_path / name
    case.write_text(tomli_w.dumps(content))
    begin = time.perf_counter()
    done = pinav("heat", task, str(case), "--out", str(out))
    seconds = time.perf_counter() - begin
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    return RunFolder.open(out).load("metrics", kind), seconds


EXAMPLE_SEED = 0
"""Draw of the noise for which the bars are stated; the others may scatter."""


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", ["kernels", "network"])
def test_perfusion_from_seven_probes(tmp_path, kind, seed):
    """Demonstration 2."""
    content = tomllib.loads((EXAMPLES / "learn.toml").read_text())
    content["learn"] |= {"kind": kind, "seed": seed}
    found, seconds = ran(tmp_path, "learn", content, LearnedTissue)
    law = found.laws["tissue"]
    assert law.true is not None
    at = np.array([40.0, 41.0, 42.0, 43.0, 44.0])
    values, true, low, high = (
        np.exp(np.interp(at, law.temperatures, np.log(curve)))
        for curve in (law.values, law.true, *law.band)
    )
    error = np.abs(values / true - 1)
    print(kind, seed, error, f"{seconds:.1f} s with imports and figures")
    assert found.residual == pytest.approx(0.1, rel=0.05)
    assert error[0] <= 0.20
    assert np.all(error[1:] <= 0.08)
    own = content["learn"]["seed"] == EXAMPLE_SEED
    # Of 25 places in five draws the nominal band of 95 % may miss one or two.
    assert np.sum((true < low) | (true > high)) <= (0 if own else 2)
    held_out = {row.power: row for row in found.held_out}
    assert held_out[1.3].learned <= (0.15 if own else 0.2)
    assert held_out[1.3].constant > 1.9
    assert found.constant_residual > 0.3
    assert seconds < 60


@pytest.mark.parametrize(
    ("edge_weighted", "least"), [(False, 14.0), (True, 36.0)], ids=["uniform", "edge"]
)
def test_a_protocol_under_limits(tmp_path, edge_weighted, least):
    """Demonstration 3, from a flat start."""
    content = tomllib.loads((EXAMPLES / "optimise.toml").read_text())
    content["heating"]["edge_weighted"] = edge_weighted
    found, seconds = ran(tmp_path, "optimise", content, PlannedRun)
    print(found.amplitudes, f"{seconds:.1f} s with imports and figures")
    assert least <= found.result.D90
    (temperature, _) = found.constraints
    assert temperature.active
    assert temperature.value <= 47.05
    assert seconds < 60


def test_the_examples_are_synthetic_and_small():
    for path in EXAMPLES.glob("*.toml"):
        assert np.prod(Setup.read(path).model.grid.shape) <= 500
        assert "Synthetic" in path.read_text()


@pytest.mark.parametrize(
    ("edge_weighted", "listed"), [(False, 9.44), (True, 25.9)], ids=["uniform", "edge"]
)
def test_a_protocol_that_pauses_is_worse(edge_weighted, listed):
    """The baselines of demonstration 3: constant, and on and off, both up to 47 °C."""
    model = tumour(RadialGrid.sphere(0.05, 100))
    share = model.grid.ball(0.010)
    volumes = share * model.grid.volumes
    shape = 0.4 + (model.grid.distances() / 0.010) ** 2 if edge_weighted else 1.0
    field = share * shape
    field = field * (jnp.sum(volumes) / jnp.sum(field * model.grid.volumes))

    def dose(protocol, power):
        own = eqx.tree_at(lambda m: m.sources[0].power, model, power * field)
        found = solve(own, protocol)
        reached = value_exceeded_by(found.final.dose, volumes, 0.9)
        return float(found.hottest.max()), float(reached)

    still = powers((0.0, 1800.0), [1.0])
    bursts = Piecewise.on_off(1e4, 1e5, on=50.0, off=100.0, duration=1800.0)
    results = {}
    for name, protocol in (("still", still), ("bursts", bursts)):
        low, high, reached = 5e4, 1e6, 0.0
        for _ in range(14):
            middle = 0.5 * (low + high)
            hot, reached = dose(protocol, middle)
            low, high = (middle, high) if hot < 47.0 else (low, middle)
        results[name] = reached
    print(results)
    assert results["still"] == pytest.approx(listed, rel=0.05)
    assert results["bursts"] < 0.6 * results["still"]


PHANTOM_KEYS = (204, 205, 206, 207)
"""Keys on which nothing was developed: 100 and 101 were used for that, and 201 to 203
when it was asked why bands missed the truth."""

PLANNED_KEYS = (202, 204)


def make_phantom(key, folder):
    command = [sys.executable, str(EXAMPLES / "phantom.py"), "--key", str(key)]
    subprocess.run([*command, "--out", str(folder)], check=True)
    return folder


def test_phantoms_of_four_tissues_are_learned(tmp_path):
    """Sixty frames of 48 x 48 x 24 voxels at 1 K noise; bands counted over all keys."""
    inside = []
    for key in PHANTOM_KEYS:
        case = make_phantom(key, tmp_path / f"phantom{key}") / "case.toml"
        out, begin = tmp_path / f"run{key}", time.perf_counter()
        done = pinav("heat", "learn", str(case), "--out", str(out))
        seconds = time.perf_counter() - begin
        assert done.returncode == 0, done.stderr
        metrics = json.loads((out / "metrics.json").read_text())["value"]
        print(key, f"{seconds:.0f} s", metrics["quantities"])
        for name, one in metrics["quantities"].items():
            true = metrics["true"][name]
            apart = abs(one["value"] - true)
            inside.append(apart < 1.96 * one["sd"])
            if name.startswith("perfusion"):
                assert apart <= 0.10 * true
            if name.startswith("power"):
                assert apart <= 0.03 * true
        assert seconds < 60
    print(f"{sum(inside)} of {len(inside)} in their 95 % bands")
    assert len(inside) == 7 * len(PHANTOM_KEYS)
    assert np.mean(inside) >= 0.95


@pytest.mark.parametrize("key", PLANNED_KEYS)
def test_a_phantom_is_planned_from_ten_frames(key, tmp_path):
    """The plan of a learned tissue, run on the true one."""
    case, out = make_phantom(key, tmp_path / "phantom") / "plan.toml", tmp_path / "run"
    done = pinav("heat", "optimise", str(case), "--out", str(out))
    assert done.returncode == 0, done.stderr
    metrics = json.loads((out / "metrics.json").read_text())["value"]
    judged = metrics["judged"]
    print(key, judged)
    assert judged["D90"] >= 0.9 * judged["best_D90"]
    assert judged["T_max"] <= metrics["max_temperature"] + 0.1
