"""The run of a network that a structured fit of kernels taught."""

import equinox as eqx
import jax
import numpy as np
import pytest
from pinav.commands.evidence_file import TEACHER_MODEL_FILE
from pinav.commands.fit.plan import plan_fit

from pinav.analysis import influence
from pinav.commands.fit import job
from pinav.commands.fit.settings import FitSettings
from pinav.errors import InputError
from pinav.forces import NeuralPotential, StructuredForce, ZeroForce
from pinav.learning.learned import Learned
from pinav.runs import RunFolder
from pinav.scenarios import barrier_crossings
from pinav.trajectories import simulate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def crossings():
    truth = eqx.tree_at(
        lambda s: (s.starts, s.times),
        barrier_crossings(),
        replace_fn=lambda a: a[:6] if a.ndim == 2 else a[:61],
    )
    return truth, simulate(truth, key=jax.random.key(2))


def fit(crossings, path, **settings):
    settings = FitSettings(
        model="neural-potential", width=16, recipe="bayes", **settings
    )
    folder = RunFolder.create(path, {}, overwrite=False)
    return job.fit(plan_fit(settings, *crossings), folder), folder


@pytest.fixture(scope="module")
def taught(crossings, tmp_path_factory):
    return fit(crossings, tmp_path_factory.mktemp("teacher") / "run")


def test_the_run_says_what_structure_its_teacher_had(taught):
    metrics, folder = taught
    assert "the network's teacher: structure: central about" in metrics.text()
    run = Learned.open(folder.path)
    assert isinstance(run.model.environment, NeuralPotential)
    teacher = run.teacher.model.environment
    assert isinstance(teacher, StructuredForce)
    assert run.evidence.process is teacher
    assert run.teacher.choice.name == "kernel-potential"
    assert "structure/0" in folder.read_arrays("results.npz")


def test_the_prior_of_a_stored_network_is_that_of_its_teacher(taught, crossings):
    run = Learned.open(taught[1].path)
    found = influence(
        run.model,
        crossings[1],
        run.evidence.states,
        run.evidence.hyperparameters,
        kernels=run.evidence.process,
    )
    assert np.all(np.isfinite(found.removals))
    assert 0 < found.leverages.sum() < 60


def test_a_network_without_its_teacher_is_refused(taught, tmp_path):
    run = taught[1].path
    for file in run.iterdir():
        if file.is_file() and file.name != TEACHER_MODEL_FILE:
            (tmp_path / file.name).write_bytes(file.read_bytes())
    with pytest.raises(InputError, match=TEACHER_MODEL_FILE):
        Learned.open(tmp_path)


def test_without_a_search_free_kernels_teach_a_network(crossings, tmp_path):
    metrics, folder = fit(crossings, tmp_path / "run", structure="free")
    assert metrics.structure is None
    run = Learned.open(folder.path)
    assert run.teacher is None
    assert not folder.has(TEACHER_MODEL_FILE)
    assert not isinstance(run.evidence.process, StructuredForce | ZeroForce)
