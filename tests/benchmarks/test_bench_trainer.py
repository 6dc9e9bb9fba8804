import numpy as np
import pytest
from benchmarks.trainer.cells import COLUMNS
from benchmarks.trainer.systems import DEVELOPMENT, JUDGED, benchmark_system
from benchmarks.trainer.table import Options, cells


def test_cells_are_those_of_the_keys_columns_and_seeds():
    assert not set(DEVELOPMENT) & set(JUDGED)
    assert len(DEVELOPMENT) == len(JUDGED) == 30
    assert not any(key % 2 for key in DEVELOPMENT)
    assert all(key % 2 for key in JUDGED)
    options = Options(keys=(4,), columns=("network", "kernel"), seeds=(0, 1))
    asked = [cell.label for cell in cells(options)]
    assert asked == ["network 4 0", "network 4 1", "kernel 4 0"]
    assert {int(cell.system) for cell in cells(Options(half="judged"))} == set(JUDGED)


@pytest.mark.parametrize("key", [0, 2, 4, 8])
def test_a_system_is_drawn_by_its_key_alone(key):
    one, other = benchmark_system(key), benchmark_system(key)
    np.testing.assert_array_equal(one.system.starts, other.system.starts)
    assert 0.5 <= one.width <= 5.0
    assert 1 <= len(one.system.starts) <= 4
    assert 19.8 <= float(one.system.times[-1]) <= 50.0


def test_a_column_that_must_fail_changes_what_the_fit_is_told_or_what_is_observed():
    drawn = benchmark_system(4)
    damping = float(drawn.system.swimmer.drag.damping)
    told = COLUMNS["wrong-drag"].known(drawn)
    np.testing.assert_allclose(told.drag.damping, 1.3 * damping)
    assert COLUMNS["network"].known(drawn).drag.damping == damping
    coarse = COLUMNS["coarse"].truth(drawn).times
    assert coarse[1] - coarse[0] > 2 * drawn.system.times[1]
    (barrier, swirl) = COLUMNS["swirl"].truth(drawn).environment.terms
    assert barrier is drawn.system.environment
    places = drawn.system.starts[0, :2] + 0.1
    assert (
        abs(float(swirl(0.0, places, places) @ (places - swirl.constants[1:3]))) < 1e-12
    )
