"""Learning from probes: known answers come back, bands say where nothing is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals
from validation.heat.checks import reference_model

from pinav.errors import InputError
from pinav.thermal.grids import RadialGrid
from pinav.thermal.learning import learn, perfusion_curve, visited_range
from pinav.thermal.perfusion import kernel_perfusion, lang, neural_perfusion
from pinav.thermal.protocols import Piecewise
from pinav.thermal.readings import Readings, load_probes, save_probes
from pinav.thermal.solve import probes_at, solve
from pinav.thermal.steppers import Rosenbrock
from pinav.thermal.tissues import Tissue

STEPPER = Rosenbrock(20.0)
EDGES = (0.0, 300.0, 600.0, 900.0)
STEPS = Piecewise.constant(EDGES, [1e4, 6e3, 1e4], 1e5)
POINTS = np.array([[0.0], [0.006], [0.013], [0.02]])


def muscle(power=1.6e5, law=None):
    """Muscle alone, heated by a spot."""
    grid, law = RadialGrid.sphere(0.04, 24), law or lang("muscle")
    spot = jnp.exp(-0.5 * (grid.distances() / 0.012) ** 2)
    tissue = Tissue(0.49, 1090.0, 3421.0)
    return reference_model(grid, power * spot, None, law, tissue)


def fitted(start, readings, **learned):
    return learn(start, STEPS, readings, stepper=STEPPER, **learned)


def curve_at(learned, at):
    visited = visited_range(learned.model, STEPS, jnp.ones(24))
    return perfusion_curve(learned.posterior, lambda m: m.perfusion, at, visited)


@pytest.fixture(scope="module")
def readings():
    options = {"observe": probes_at(muscle(), POINTS), "save_every": 20.0}
    solution = solve(muscle(), STEPS, stepper=STEPPER, **options)
    clean = np.asarray(solution.observed)
    noise = 0.05 * np.asarray(jax.random.normal(jax.random.key(0), clean.shape))
    return Readings(np.asarray(solution.times), clean + noise, POINTS)


@pytest.fixture(scope="module")
def learned(readings):
    start = muscle(law=kernel_perfusion(0.47, (37.0, 46.0)))
    return fitted(start, readings, laws=lambda m: (m.perfusion,))


@pytest.mark.slow
def test_perfusion_of_temperature_comes_back_within_its_band(learned):
    visited = visited_range(learned.model, STEPS, jnp.ones(24))
    at = np.linspace(41.0, visited[1] - 0.5, 8)
    curve = curve_at(learned, at)
    true = np.asarray(lang("muscle")(jnp.asarray(at)))
    assert np.abs(curve.values / true - 1).max() < 0.15
    low, high = curve.band
    assert np.mean((low <= true) & (true <= high)) >= 0.75
    assert learned.hyperparameters.noise == pytest.approx(0.05, rel=0.15)


@pytest.mark.slow
def test_the_band_widens_where_the_data_say_nothing(learned):
    """Near the arterial temperature perfusion has no effect, above none was."""
    curve = curve_at(learned, np.array([37.2, 43.0]))
    assert curve.sd[0] > 3 * curve.sd[1]
    assert curve.inside.tolist() == [True, True]


@pytest.mark.parametrize(
    "law",
    [
        kernel_perfusion(0.5, (37.0, 45.0)),
        neural_perfusion(0.5, (37.0, 45.0), key=jax.random.key(1), width=4),
    ],
    ids=["kernels", "network"],
)
def test_laws_are_positive_and_flat_outside_their_range(law):
    moved = eqx.tree_at(
        lambda m: m.weights,
        law,
        jax.tree.map(lambda w: w + 0.7 if eqx.is_inexact_array(w) else w, law.weights),
    )
    at = jnp.array([[30.0, 37.0, 41.0], [45.0, 50.0, 44.0]])
    found = moved(at)
    assert found.shape == at.shape
    assert bool(jnp.all(found > 0))
    assert float(found[0, 0]) == pytest.approx(float(found[0, 1]))
    assert float(found[1, 0]) == pytest.approx(float(found[1, 1]))
    assert float(found[0, 2]) != pytest.approx(float(found[0, 1]), rel=1e-3)


def test_untrained_kernels_are_their_level():
    found = kernel_perfusion(0.8, (37.0, 45.0))(jnp.array([38.0, 44.0]))
    assert found.tolist() == pytest.approx([0.8, 0.8])


@pytest.mark.slow
def test_a_network_learns_too(readings):
    law = neural_perfusion(0.47, (37.0, 46.0), key=jax.random.key(0), width=6)
    fit = fitted(muscle(law=law), readings, laws=lambda m: (m.perfusion,))
    assert fit.hyperparameters.noise == pytest.approx(0.05, rel=0.3)


def scale(model):
    return model.sources[0].scale


@pytest.mark.slow
def test_the_scale_of_the_power_is_learned_from_steps(readings):
    (found,) = fitted(muscle(2e5), readings, constants=scale).constants.values()
    assert found.value == pytest.approx(0.8, abs=4 * found.sd)
    assert found.sd < 0.01


@pytest.mark.slow
def test_readings_survive_a_file(tmp_path, readings):
    values = np.where(readings.values > 44, np.nan, readings.values)
    with_gap = eqx.tree_at(lambda d: d.values, readings, values)
    save_probes(with_gap, tmp_path / "probes.csv")
    again = load_probes(tmp_path / "probes.csv")
    assert again.times == pytest.approx(with_gap.times)
    assert again.points == pytest.approx(with_gap.points)
    assert np.array_equal(again.values, with_gap.values, equal_nan=True)


@pytest.mark.slow
def test_what_cannot_be_learned_is_refused(readings, tmp_path):
    with pytest.raises(InputError, match="nothing to learn"):
        fitted(muscle(), readings)
    far = Readings(readings.times, readings.values, POINTS + 1.0)
    with pytest.raises(InputError, match="probe at 1 m: expected between 0 and 0.04"):
        learn(muscle(), STEPS, far, constants=scale)
    late = Readings(readings.times + 1e4, readings.values, POINTS)
    with pytest.raises(InputError, match="saved time .* expected after 0 and up to"):
        learn(muscle(), STEPS, late, constants=scale)
    with pytest.raises(InputError, match=r"of shape \(45, 4\), times by places"):
        Readings(readings.times, readings.values[:, :2], POINTS)
    with pytest.raises(InputError, match="cannot read"):
        load_probes(tmp_path / "nowhere.csv")


FROM, TO = 37.0, 45.0
test_bad_kernels_are_refused = refusals(
    (lambda: kernel_perfusion(0.0, (FROM, TO)), "perfusion level: expected > 0"),
    (lambda: kernel_perfusion(1.0, (TO, FROM)), "perfusion range: expected increasing"),
    (
        lambda: kernel_perfusion(1.0, (FROM, TO), length_scale=0.0),
        "length_scale: expected > 0 K",
    ),
)
