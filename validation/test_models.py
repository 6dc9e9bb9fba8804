"""The bars of the missing models: rotational, moving, anisotropic, stochastic."""

import math
from typing import Any

import jax
import numpy as np
import pytest

from pinav import cli
from pinav.commands.compare import CompareSettings
from pinav.commands.compare.job import compare
from pinav.errors import FitError
from pinav.evaluation import VISITED, field_map, force_errors
from pinav.fitting import (
    fit_bayes,
    fit_langevin,
    kernel_environment,
    principal_drags,
    rotational_fraction,
)
from pinav.fitting.environments.catalogue import with_tensor_drag
from pinav.fitting.environments.summary import ModelChoice, summarise_for
from pinav.forces import KernelMixture, KernelPotential
from pinav.learning.learn import open_run
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.trajectories import simulate

KEY = jax.random.key(0)


def observed(name):
    made = scenario(name, KEY)
    return made, simulate(made, key=KEY)


def with_kernels(swimmer, kind, data, dim=None):
    environment = kernel_environment(kind, data, dim=dim)
    return swimmer.with_environment(environment)


def differences(name, models, tmp_path):
    """Nats by which the second model of each verdict beats the first."""
    settings = CompareSettings(models=models)
    folder = RunFolder.create(
        tmp_path / "run", {"run": {"command": "compare"}}, overwrite=False
    )
    verdicts = compare(settings, observed(name)[1], folder).verdicts
    nats = [v.difference for v in verdicts if v.difference is not None]
    assert len(nats) == len(verdicts)
    return nats


def test_swirl_has_its_rotational_fraction():
    made, data = observed("swirl")
    environment: Any = made.true_swimmer.environment
    found = fit_bayes(with_kernels(made.swimmer, KernelMixture, data), data)
    field = field_map(found.model.environment, data)
    visited = field.distance <= VISITED
    squares = [
        np.sum(field_map(term, data).force[visited] ** 2) for term in environment.terms
    ]
    points = np.stack(np.meshgrid(field.x, field.y), axis=-1)[visited]
    fraction = rotational_fraction(found.posterior, points)
    assert fraction.value == pytest.approx(squares[1] / sum(squares), rel=0.1)


FORCES = ("kernel-potential", "kernel-force", "kernel-mixture")


def test_swirl_prefers_a_free_force(tmp_path):
    assert min(differences("swirl", FORCES, tmp_path)) > 10


def test_crossings_prefer_a_potential(tmp_path):
    assert max(differences("barrier-crossings", FORCES, tmp_path)) < 0


def test_crossings_need_an_environment_and_networks_cost_no_more_than_kernels(tmp_path):
    settings = CompareSettings(
        models=("physics-only", "kernel-potential", "neural-potential", "neural-force")
    )
    folder = RunFolder.create(
        tmp_path / "run", {"run": {"command": "compare"}}, overwrite=False
    )
    rows = compare(settings, observed("barrier-crossings")[1], folder).models
    values = {name: row.log_evidence or -math.inf for name, row in rows.items()}
    print(values)
    assert values["kernel-potential"] > values["physics-only"] + 1000
    assert values["kernel-potential"] - values["neural-potential"] < 100
    assert values["neural-potential"] > values["neural-force"]


@pytest.mark.parametrize(
    ("name", "moves"), [("moving-barrier", True), ("barrier-crossings", False)]
)
def test_only_a_moving_barrier_prefers_time(name, moves, tmp_path):
    models = ("kernel-potential", "kernel-potential-time")
    (difference,) = differences(name, models, tmp_path)
    assert (difference > 0) == moves


def test_anisotropic_drag_is_found():
    made, data = observed("anisotropic-drag")
    summary = summarise_for(ModelChoice(), data)
    model = with_tensor_drag(with_kernels(made.swimmer, KernelPotential, data), summary)
    found = fit_bayes(model, data, learn=lambda m: m.drag.tensor)
    drags = principal_drags(found.posterior)
    assert drags["along"].value == pytest.approx(0.24, rel=0.02)
    assert drags["across"].value == pytest.approx(0.48, rel=0.02)
    assert np.rad2deg(drags["director"].value) == pytest.approx(30.0, abs=2.0)


def test_brownian_diffusion_and_force():
    made, data = observed("brownian")
    model = with_kernels(made.swimmer, KernelPotential, data, dim=2)
    found = fit_langevin(model, data)
    truth: Any = made.truth
    true = truth.diffusion(made.starts[0])[0, 0]
    assert found.constants["diffusion"].value == pytest.approx(float(true), rel=0.15)
    truth = field_map(made.true_swimmer.environment, data)
    errors = force_errors(field_map(found.model.environment, data), truth)
    try:
        smooth = fit_bayes(model, data, throw=False)
    except FitError:
        return  # without process noise these paths cannot be explained at all
    deterministic = force_errors(field_map(smooth.model.environment, data), truth)
    assert errors["visited"] < deterministic["visited"]


def test_bands_hold_brownian_forces_in_spite_of_localisation_error(tmp_path, capsys):
    """The figures of docs/models.md, of draws that chose nothing."""
    shares = [covered_share(tmp_path / str(seed), seed) for seed in range(8)]
    with capsys.disabled():
        print("covered:", " ".join(f"{share:.0%}" for share in shares))
    assert min(shares) > 0.5
    assert np.mean(shares) > 0.8


def covered_share(folder, seed):
    """What the 95 % band covers where the force is a tenth of its size or more."""
    folder.mkdir()
    data, run = str(folder / "data.npz"), str(folder / "run")
    drawn = ["--count", "20", "--noise", "0.02", "--seed", str(seed)]
    assert cli.run(["simulate", "brownian", "--out", data, *drawn]) == 0
    learn = ["--recipe", "langevin", "--observation", "learn"]
    assert cli.run(["fit", data, "--out", run, *learn]) == 0
    maps = open_run(folder / "run").findings.force
    assert maps is not None
    assert maps.truth is not None
    assert maps.sd is not None
    near = maps.learned.distance < VISITED
    truth, sd = maps.truth.force[near], maps.sd[near]
    size = np.sqrt(np.mean(truth**2))
    acts = np.linalg.norm(truth, axis=1) > 0.1 * size
    miss = np.abs(maps.learned.force[near] - truth)
    return float(np.mean(miss[acts] < 1.96 * sd[acts]))
