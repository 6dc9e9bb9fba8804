"""Growth of the iteration's time: the slope, the tables, and one tiny run."""

import jax
import numpy as np
import pytest

from benchmarks import growth
from pinav.errors import InputError


def test_the_slope_is_the_exponent():
    times = {n: 0.3 * n**1.7 for n in (1, 4, 16)}
    assert growth.slope(times) == pytest.approx(1.7)
    assert np.isnan(growth.slope({1: 2.0}))


def test_crossings_differ_and_begin_alike():
    nine = growth.crossings(9)
    assert len(nine) == 9
    starts = nine.states[:, 0]
    assert len(np.unique(starts.round(6), axis=0)) == 9
    assert np.array_equal(starts[:2], growth.crossings(2).states[:, 0])
    fewer = growth.crossings(2, 51)
    assert fewer.times.shape == (2, 51)
    np.testing.assert_allclose(fewer.states[:, -1], nine.states[:2, -1], atol=1e-6)


def test_weights_of_a_network_grow_with_the_square_of_its_width():
    data = growth.crossings(1)
    few, many = (growth.num_weights(data, width) for width in (32, 64))
    assert few == pytest.approx(32 * 32, rel=0.5)
    assert many / few == pytest.approx(4.0, rel=0.2)


def test_calls_take_turns():
    order = []
    calls = {n: (lambda n=n: order.append(n)) for n in (1, 2)}
    growth.medians(calls, rounds=2)
    assert order == [1, 2, 1, 2]


@pytest.mark.slow
def test_a_tiny_run_prints_and_draws(tmp_path, capsys):
    words = ["--trajectories", "1", "2", "--rounds", "1", "--out", str(tmp_path)]
    with jax.numpy_dtype_promotion("standard"):
        growth.main([*words, "--samples", "--widths", "--fits"])
    printed = capsys.readouterr().out
    assert "slope" in printed
    assert "fits/s" not in printed
    lines = (tmp_path / "growth.csv").read_text().splitlines()
    assert [line.split(",")[:2] for line in lines[1:]] == [
        ["trajectories", "1"],
        ["trajectories", "2"],
    ]
    assert (tmp_path / "growth.png").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fits", "0"], "--fits: expected numbers of 1 or more"),
        (["--rounds", "0"], "--rounds: expected 1 or more"),
    ],
)
def test_mistakes_get_one_line(words, message, tmp_path):
    with pytest.raises(InputError, match=message):
        growth.main(["--out", str(tmp_path), *words])
