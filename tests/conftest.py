"""Strict JAX, strict types: set before any test imports pinav."""

import os

os.environ.setdefault("MPLBACKEND", "Agg")

import jax
import jaxtyping
import pytest

jax.config.update("jax_enable_x64", val=True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

jaxtyping.install_import_hook("pinav", "beartype.beartype")


@pytest.fixture(scope="session")
def paper_trajectories():
    """The paper's benchmark, solved once for all tests."""
    from pinav.scenarios import paper
    from pinav.trajectories import simulate

    return simulate(paper())
