import numpy as np
import pytest
from benchmarks.trainer.cells import COLUMNS, Measurement
from benchmarks.trainer.systems import DEVELOPMENT, JUDGED, benchmark_system
from benchmarks.trainer.table import Options, cells, line, summary


def measurement(**changes):
    values = {"key": 4, "column": "kernel", "seed": 0, "rmse": 1e-6, "seconds": 2.0}
    values |= {"processor_seconds": 3.0}
    drawn = {"encounter": "turn", "form": "gaussian", "width": 1.5}
    return Measurement(**(values | {"outcome": "converged"} | drawn | changes))


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


def test_the_table_gives_quantiles_and_counts_causes():
    several = [measurement(rmse=10.0**-power) for power in range(3, 8)]
    assert "1.0e-05" in summary(several)
    assert "1.0e-03" in summary(several)
    assert "turn" in line(several[0])
    assert "converged" in line(several[0])
    causes = {1e-1: "physics", 1e-2: "", 1.0: "search"}
    several = [
        measurement(column="wrong-drag", rmse=rmse, cause=cause)
        for rmse, cause in causes.items()
    ]
    assert "2 above 0.01; 1 of these name it: physics" in summary(several)
    assert "above" not in summary([measurement(rmse=1.0, cause="search")])


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
