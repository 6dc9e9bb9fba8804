import numpy as np
import pytest

from pinav.analysis import Factor, sobol_indices
from pinav.errors import InputError

PI = np.pi


def ishigami(x, a=7.0, b=0.1):
    one, two, three = x.T
    value = np.sin(one) + a * np.sin(two) ** 2 + b * three**4 * np.sin(one)
    return value[:, None]


def ishigami_indices(a=7.0, b=0.1):
    """Closed forms of Ishigami and Homma (1990)."""
    first = 0.5 * (1 + b * PI**4 / 5) ** 2
    second = a**2 / 8
    both = b**2 * PI**8 * (1 / 18 - 1 / 50)
    total = first + second + both
    return (
        total,
        np.array([first, second, 0.0]) / total,
        np.array([first + both, second, both]) / total,
    )


def test_indices_of_the_ishigami_function():
    factors = [Factor(f"x{i}", -PI, PI) for i in range(3)]
    found = sobol_indices(ishigami, factors, ["y"], samples=2048)
    variance, first, total = ishigami_indices()
    assert found.variance[0] == pytest.approx(variance, rel=0.02)
    assert np.allclose(found.first[0], first, atol=0.03)
    assert np.allclose(found.total[0], total, atol=0.03)
    for interval, true in (
        (found.first_interval, first),
        (found.total_interval, total),
    ):
        low, high = interval[0].T
        assert np.all(low - 0.02 < true)
        assert np.all(true < high + 0.02)
        assert np.all(high - low < 0.25)


def test_indices_of_a_linear_model_are_shares_of_the_variance():
    slopes, widths = np.array([1.0, -2.0, 0.0]), np.array([1.0, 2.0, 5.0])
    factors = [
        Factor(f"x{i}", 3.0, 3.0 + width) for i, width in enumerate(widths.tolist())
    ]
    found = sobol_indices(
        lambda x: np.stack([x @ slopes + 100.0, np.full(len(x), 7.0)], axis=1),
        factors,
        ["linear", "constant"],
        samples=512,
    )
    shares = (slopes * widths) ** 2 / ((slopes * widths) ** 2).sum()
    assert np.allclose(found.first[0], shares, atol=0.02)
    assert np.allclose(found.total[0], shares, atol=0.02)
    assert np.isnan(found.first[1]).all()
    assert found.variance[1] == 0.0


def test_a_seed_repeats_the_intervals():
    factors = [Factor("a", 0.0, 1.0), Factor("b", 0.0, 1.0)]

    def product(x):
        return x.prod(axis=1, keepdims=True)

    one, two = (sobol_indices(product, factors, ["y"], samples=64) for _ in range(2))
    assert np.array_equal(one.total_interval, two.total_interval)
    other = sobol_indices(product, factors, ["y"], samples=64, seed=1)
    assert not np.array_equal(one.total, other.total)


def test_bad_input_is_refused():
    good = [Factor("a", 0.0, 1.0)]
    with pytest.raises(InputError, match="Factor a: expected a finite range"):
        Factor("a", 1.0, 1.0)
    with pytest.raises(InputError, match="factors: expected one or more"):
        sobol_indices(lambda x: x, [], ["y"])
    with pytest.raises(InputError, match="expected a power of two"):
        sobol_indices(lambda x: x, good, ["y"], samples=100)
    with pytest.raises(InputError, match="expected between 0 and 1"):
        sobol_indices(lambda x: x, good, ["y"], confidence=1.0)
    with pytest.raises(InputError, match="an outcome is not finite"):
        sobol_indices(lambda x: np.full_like(x, np.nan), good, ["y"])
    with pytest.raises(InputError, match="a row per sample and a column per"):
        sobol_indices(lambda x: x[:, 0], good, ["y"])
