"""What the shared runs hold and say is what they held and said before."""

import pytest
from tests.fitted_runs import RUNS, TERMINAL
from tests.stored_numbers import contents, result_of


@pytest.mark.parametrize("name", RUNS)
def test_a_shared_run_holds_the_numbers_that_are_kept(name, fitted_run, same_numbers):
    folder = fitted_run(name)[0].parent
    printed = (folder / TERMINAL).read_text()
    same_numbers.check(name, result_of(contents([folder]), printed, [folder]))
