"""A model file says how its model is built again, and holds its numbers."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav import forces
from pinav.checkpoints import read_tree, write_tree
from pinav.codec import encode
from pinav.errors import InputError
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.kernels import profile_environment
from pinav.fitting.environments.summary import ModelChoice, summarise_for
from pinav.forces.fitted_laws import FittedLaw
from pinav.learning.learned import ModelHeader, build_model, read_header
from pinav.scenarios import scenario
from pinav.trajectories import simulate

PATHS = scenario("brownian")
DATA = simulate(PATHS, key=jax.random.key(0))
PLACES = jnp.linspace(0.0, 3.0, 5)
RING = FittedLaw("ring", (jnp.asarray(3.0), jnp.asarray(0.1), jnp.asarray(0.2)))


def laid(name):
    return summarise_for(ModelChoice(name), DATA).environment


def structured():
    free = forces.KernelPotential.with_zero_weights(np.zeros((3, 2)), 1.0)
    ring = forces.CentralTerm(jnp.ones(6), jnp.ones(2), PLACES, 0.7, law=RING)
    wall = forces.WallTerm(
        jnp.ones(5), jnp.asarray(0.4), jnp.zeros(2), PLACES, 0.7, rotational=True
    )
    return forces.StructuredForce((ring, wall), free)


ENVIRONMENTS = {
    "kernel-potential": lambda: laid("kernel-potential"),
    "kernel-force": lambda: laid("kernel-force"),
    "kernel-mixture": lambda: laid("kernel-mixture"),
    "kernel-potential-time": lambda: laid("kernel-potential-time"),
    "kernel-profile": lambda: profile_environment(
        DATA,
        (
            forces.KernelAxis(0, warp=forces.Warp(-9.0, 2.0)),
            forces.KernelAxis(1, period=7.0),
        ),
    ),
    "structured": structured,
    "neural-force": lambda: None,
}


@pytest.fixture(params=ENVIRONMENTS)
def model(request):
    """The header of a model whose numbers are all of their own, and the model."""
    name = "kernel-potential" if request.param == "structured" else request.param
    choice = ModelChoice(name)
    summary = dataclasses.replace(
        summarise_for(choice, DATA), environment=ENVIRONMENTS[request.param]()
    )
    basis = forces.KernelBasis.around((forces.KernelAxis(0),), DATA.states[0])
    weights = jnp.ones((2, len(basis.centers)))
    mobility = forces.KernelTensor(jnp.ones(2), weights, basis, ((0,), (1,)))
    swimmer = dataclasses.replace(PATHS.swimmer, mobility=mobility)
    built = build(choice, swimmer, summary)
    rng = np.random.default_rng(0)
    filled = jax.tree.map(
        lambda leaf: (
            leaf + jnp.asarray(rng.normal(size=leaf.shape))
            if eqx.is_inexact_array(leaf)
            else leaf
        ),
        built,
    )
    return ModelHeader(choice, summary.of_fit(filled)), filled


def test_a_file_gives_the_same_model(model, tmp_path):
    header, filled = model
    write_tree(tmp_path / "model", json.dumps(encode(header).document), filled)

    def untrained(content):
        return build_model(read_header(content), PATHS)

    again = read_tree(tmp_path / "model", untrained)
    assert eqx.tree_equal(again, filled)


def test_a_file_of_another_version_is_refused():
    content = {"choice": {"name": "kernel-force"}, "data": {"centers": []}}
    with pytest.raises(InputError, match="another version.*centers.*fit the data aga"):
        read_header(content)
