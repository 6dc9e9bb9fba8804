"""The run of a network that a structured fit of kernels taught."""

import jax
import numpy as np
import pytest
from tests.fitted_runs import crossing_system

from pinav.analysis import influence
from pinav.errors import InputError
from pinav.forces import NeuralPotential, StructuredForce, ZeroForce
from pinav.learning.learn import learn, open_run
from pinav.learning.learned import TEACHER_FILE
from pinav.learning.recipes import Bayes
from pinav.trajectories import simulate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def crossings():
    truth = crossing_system(6, 61)
    return truth, simulate(truth, key=jax.random.key(2))


def fit(crossings, **options):
    truth, data = crossings
    recipe = Bayes(**options)
    return learn(truth, data, model="neural-potential", width=16, recipe=recipe)


@pytest.fixture(scope="module")
def taught(crossings, tmp_path_factory):
    return fit(crossings).save(tmp_path_factory.mktemp("teacher") / "run")


def test_the_run_says_what_structure_its_teacher_had(taught):
    structure = taught.findings.structure
    assert structure.of_teacher
    assert structure.terms[0].name.startswith("central")
    assert structure.terms[0].profile is not None
    run = open_run(taught.path)
    assert isinstance(run.model.environment, NeuralPotential)
    teacher = run.teacher.model.environment
    assert isinstance(teacher, StructuredForce)
    assert run.evidence.process is teacher
    assert run.teacher.choice.name == "kernel-potential"


def test_the_prior_of_a_stored_network_is_that_of_its_teacher(taught, crossings):
    run = open_run(taught.path)
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
    run = taught.path
    for file in run.iterdir():
        if file.is_file() and file.name != TEACHER_FILE:
            (tmp_path / file.name).write_bytes(file.read_bytes())
    with pytest.raises(InputError, match=TEACHER_FILE):
        open_run(tmp_path)


def test_without_a_search_free_kernels_teach_a_network(crossings, tmp_path):
    kept = fit(crossings, structure="free").save(tmp_path / "run")
    assert kept.findings.structure is None
    run = open_run(tmp_path / "run")
    assert run.teacher is None
    assert not run.folder.has(TEACHER_FILE)
    assert not isinstance(run.evidence.process, StructuredForce | ZeroForce)
