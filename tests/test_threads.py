"""Computations side by side are those of a loop."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.threads import map_on_cores, num_cores


@pytest.mark.parametrize("cores", ["1", "3"])
def test_results_come_in_the_order_of_the_items(monkeypatch, cores):
    monkeypatch.setenv("NPROC", cores)
    assert num_cores() == int(cores)
    matrices = list(np.random.default_rng(0).normal(size=(7, 20, 20)))
    each = map_on_cores(np.linalg.inv, matrices)
    for matrix, inverse in zip(matrices, each, strict=True):
        np.testing.assert_array_equal(inverse, np.linalg.inv(matrix))


def test_as_many_run_at_a_time_as_there_are_cores(monkeypatch):
    monkeypatch.setenv("NPROC", "2")
    both = threading.Barrier(2, timeout=30.0)  # breaks unless two wait at it
    assert sorted(map_on_cores(lambda _: both.wait(), [0, 1])) == [0, 1]


@pytest.mark.parametrize("exact", [True, False])
def test_threads_have_the_precision_of_the_caller(monkeypatch, exact):
    monkeypatch.setenv("NPROC", "2")
    with jax.enable_x64(exact):
        kinds = map_on_cores(lambda x: jnp.asarray(float(x)).dtype, [0, 1, 2])
    assert set(kinds) == {jnp.dtype("float64" if exact else "float32")}


def test_an_error_of_one_is_raised(monkeypatch):
    monkeypatch.setenv("NPROC", "2")
    with pytest.raises(ZeroDivisionError):
        map_on_cores(lambda x: 1 / x, [1, 0])


def test_nothing_and_no_core_count_of_ours(monkeypatch):
    monkeypatch.delenv("NPROC", raising=False)
    assert num_cores() >= 1
    assert map_on_cores(abs, []) == []
