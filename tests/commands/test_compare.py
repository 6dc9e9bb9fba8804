"""`pinav compare`: rows, verdicts, and what it refuses."""

import jax.numpy as jnp
import numpy as np
import pytest

from pinav.commands.compare import CompareSettings, job
from pinav.errors import InputError
from pinav.fitting import ModelEvidence
from pinav.fitting.environments.catalogue import mean_drag, with_tensor_drag
from pinav.fitting.environments.summary import summarise_data
from pinav.forces import tensor_matrix
from pinav.learning.learned import Learned
from pinav.report import sections_text
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.trajectories import Trajectories


def row(value, outcome="converged"):
    evidence = None if value is None else ModelEvidence(value + 1.0, 1.0)
    return job.ComparedModel(outcome, evidence, reason="no")


def test_a_model_without_evidence_gets_no_verdict_but_a_row():
    rows = {"isotropic-drag": row(None, "failed"), "anisotropic-drag": row(5.0)}
    (verdict,) = job.verdicts(rows)
    assert verdict.difference is None
    assert "No verdict on isotropic drag or anisotropic drag" in verdict.text
    found = job.Comparison(rows, (verdict,))
    names = [cells[0] for cells in job.table(found).rows]
    assert names == ["anisotropic-drag", "isotropic-drag"]
    assert "no" in sections_text(job.sections(found))


def positions(name, channels=("x", "y")):
    return Trajectories.from_arrays(
        np.arange(4.0),
        np.arange(4.0 * len(channels)).reshape(4, -1),
        channels=channels,
        provenance={"scenario": name},
    )


@pytest.mark.parametrize(
    ("models", "name", "channels", "message"),
    [
        (("first-order", "kernel-potential"), "paper", 4, "positions alone, got x, y"),
        (("first-order", "kernel-potential"), "brownian", 2, "physics with inertia"),
        (("isotropic-drag", "anisotropic-drag"), "brownian", 2, "physics with inertia"),
        (("physics-only", "kernel-potential"), "brownian", 2, "fitted by kernels alo"),
        (("neural-force", "kernel-potential"), "brownian", 2, "fitted by kernels alo"),
        (("isotropic-drag", "anisotropic-drag"), "shear", 4, "fluid at rest, got InFl"),
    ],
)
def test_candidates_that_cannot_be_had_are_refused(models, name, channels, message):
    data = positions(name, ("x", "y", "vx", "vy")[:channels])
    with pytest.raises(InputError, match=message):
        job.check_settings(CompareSettings(models=models), data)


def test_a_drag_to_learn_starts_isotropic_with_the_mean_of_the_known_one():
    known = scenario("anisotropic-drag").swimmer
    data = summarise_data(positions("paper", ("x", "y", "vx", "vy")))
    assert mean_drag(known, data) == pytest.approx(0.36)
    tensor = with_tensor_drag(known, data).drag.tensor
    matrix = tensor_matrix(tensor, jnp.zeros(2))
    np.testing.assert_allclose(matrix, 0.36 * np.eye(2), atol=1e-15)


@pytest.mark.slow
def test_comparison_of_stochastic_paths_from_the_command_line(
    fitted_run, tmp_path, printed, refused
):
    fitted, data = fitted_run("langevin")
    learned = Learned.open(fitted).constants
    assert learned["diffusion"].value == pytest.approx(0.245, rel=0.2)
    words, run = ["--models", "kernel-potential", "kernel-force"], tmp_path / "run"
    assert "The evidence prefers" in printed("compare", data, "--out", run, *words)
    found = RunFolder.open(run).load("metrics", job.Comparison)
    assert found.models.keys() == {"kernel-potential", "kernel-force"}
    assert "nats" in (run / "report.html").read_text()
    words = ["fit", data, "--recipe", "langevin", "--out", run, "--system", "paper"]
    refused(words, "expected a system without inertia")
