import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals

from pinav.analysis import Factor, RolloutStudy, sobol_indices
from pinav.dynamics import FixedStep, Swimmer, rollout
from pinav.errors import InputError
from pinav.forces import LinearDrag, ZeroForce
from pinav.scenarios import barrier_crossings

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
    intervals = found.first_interval, found.total_interval
    for interval, true in zip(intervals, (first, total), strict=True):
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


ONE = Factor("a", 0.0, 1.0)


def indices_of(function=lambda x: x, factors=(ONE,), **options):
    return lambda: sobol_indices(function, factors, ["y"], **options)


test_bad_input_is_refused = refusals(
    (lambda: Factor("a", 1.0, 1.0), "Factor a: expected a finite range"),
    (indices_of(factors=()), "factors: expected one or more"),
    (indices_of(samples=100), "expected a power of two"),
    (indices_of(lambda x: np.full_like(x, np.nan)), "an outcome is not finite"),
    (indices_of(lambda x: x[:, 0]), "a row per sample and a column per"),
)


TIMES = np.linspace(0.0, 4.0, 41)
LANDMARK = np.array([5.0, 5.0])


def study():
    start = np.array([1.0, 2.0, 3.0, 3.0])
    return RolloutStudy(barrier_crossings().truth, start, TIMES, LANDMARK, 0.35)


@eqx.filter_jit
def path(swimmer, start):
    fine = FixedStep(substeps=8)
    return rollout(swimmer, jnp.asarray(start), jnp.asarray(TIMES), solver=fine).ys


def test_outcomes_are_those_of_rollouts_with_changed_constants():
    own = study()
    factors = own.factors(relative=0.1, shift=0.2)
    names = ["environment", "damping", "gain", "start x", "start y"]
    assert [f.name for f in factors] == names

    def strengths(swimmer):
        return swimmer.environment.height, swimmer.drag.damping, swimmer.propulsion.gain

    values = zip((1.1, 0.9, 1.05), strengths(own.swimmer), strict=True)
    changed = eqx.tree_at(strengths, own.swimmer, tuple(s * v for s, v in values))
    moved = own.start + np.array([0.1, -0.2, 0.0, 0.0])
    true = np.asarray(path(changed, moved))[:, :2]
    nominal = np.asarray(path(own.swimmer, own.start))[-1, :2]
    parameters = np.array([[1.1, 0.9, 1.05, 0.1, -0.2], [1.0, 1.0, 1.0, 0.0, 0.0]])
    found = own.outcomes(factors, parameters)
    displacement = np.linalg.norm(true[-1] - nominal)
    nearest = np.linalg.norm(true - LANDMARK, axis=1).min()
    expected = [*true[-1], displacement, nearest, float(displacement <= 0.35)]
    assert np.allclose(found[0], expected, atol=1e-4)
    assert found[1, 2] == pytest.approx(0.0, abs=1e-12)
    assert found[1, 4] == 1.0


def test_a_coasting_swimmer_depends_on_start_and_damping_as_it_should():
    """x(T) = x0 + v0 (1 - exp(-eta T)) / eta: nearly linear in a small change."""
    coasting = Swimmer(ZeroForce(), LinearDrag(0.5), ZeroForce())
    start = np.array([0.0, 0.0, 1.0, 0.0])
    own = RolloutStudy(coasting, start, TIMES, LANDMARK, 0.35)
    factors = own.factors(relative=0.01, shift=0.01)
    names = ["environment", "damping", "start x", "start y"]
    assert [f.name for f in factors] == names
    found = own.indices(factors, samples=128)
    decay = np.exp(-2.0)
    slope = decay * 4.0 / 0.5 - (1 - decay) / 0.5**2
    spread = np.array([0.0, slope * 0.005, 0.01, 0.0])
    assert np.allclose(found.total[0], spread**2 / (spread**2).sum(), atol=0.03)
    assert np.allclose(found.total[1], [0.0, 0.0, 0.0, 1.0], atol=0.03)


def test_unknown_factors_are_refused():
    with pytest.raises(InputError, match="'moment' is unknown; choose from damping"):
        study().indices((Factor("moment", 0.0, 1.0),))
