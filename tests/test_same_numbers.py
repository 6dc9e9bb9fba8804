"""Shared runs and small computations give the numbers that they gave before."""

import pytest
from tests.computations import COMPUTATIONS
from tests.fitted_runs import RUNS
from tests.stored_numbers import CLOSED, contents, numbers_in, result_of, summarise


@pytest.mark.parametrize("name", RUNS)
def test_a_shared_run_holds_the_numbers_that_are_kept(name, fitted_run, same_numbers):
    folder = fitted_run(name)[0].parent
    same_numbers.check(name, result_of(contents([folder]), [folder]))


@pytest.mark.parametrize("name", COMPUTATIONS)
def test_a_computation_gives_the_numbers_that_are_kept(name, same_numbers):
    found = summarise(numbers_in(COMPUTATIONS[name]()))
    assert found.numbers
    same_numbers.check(f"library/{name}", found, CLOSED)
