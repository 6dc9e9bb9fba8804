"""MR thermometry: turns, drift and lost voxels leave what was learned as it is."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals
from validation.heat.checks import reference_model

from pinav.errors import InputError
from pinav.thermal.grids import CartesianGrid
from pinav.thermal.images import phase_turn
from pinav.thermal.learning import learn, read_residuals
from pinav.thermal.perfusion import ConstantPerfusion, RegionalPerfusion
from pinav.thermal.protocols import Piecewise
from pinav.thermal.readings import Readings
from pinav.thermal.solve import solve
from pinav.thermal.sources import PowerSource, ShiftedSource
from pinav.thermal.steppers import RKL2

GRID = CartesianGrid((12, 10), (4e-3, 5e-3))
STEPPER = RKL2(stages=3, longest=15.0)
FIELD = Piecewise.constant((0.0, 120.0, 240.0), [1e4, 6e3], 1e5)
TIMES = 30.0 * np.arange(1, 9)
TURN = 12.0


def model(flows=(1.0, 3.0), shift=(0.0, 0.0), scale=1.0):
    """Two tissues side by side, and a spot between them."""
    left = jnp.broadcast_to((jnp.arange(12) < 6)[:, None], GRID.shape).astype(float)
    spot = 1.2e5 * jnp.exp(-0.5 * (GRID.distances() / 0.009) ** 2)
    laws = tuple(ConstantPerfusion(jnp.asarray(w)) for w in flows)
    perfusion = RegionalPerfusion((left, 1 - left), laws)
    source = ShiftedSource(PowerSource(spot, 1e4, scale), jnp.asarray(shift))
    medium = reference_model(GRID, 0.0, None, perfusion)
    return eqx.tree_at(lambda m: m.sources, medium, (source,))


TRUTH = model((0.7, 4.0), (2e-3, -1.5e-3), 1.1)


def clean():
    """What a perfect thermometer would show."""
    return np.asarray(solve(TRUTH, FIELD, stepper=STEPPER, save_at=TIMES).observed)


def frames(noise=0.2, drift="linear"):
    random, values = np.random.default_rng(3), clean().copy()
    sd = noise * random.uniform(0.5, 1.5, GRID.shape)
    values += sd * random.normal(size=values.shape)
    slopes = np.linspace(-1, 1, 12)[:, None]
    values += np.cumsum(random.normal(size=(8, 1, 1)), axis=0) * (2 + 0.3 * slopes)
    values = 37 + (values - 37 + TURN / 2) % TURN - TURN / 2
    values[:, 3, 4], values[5, :4] = np.nan, np.nan
    return Readings(TIMES, values, noise=sd, turn=TURN, drift=drift)


def residuals_of(data):
    return read_residuals(TRUTH, FIELD, data, stepper=STEPPER)


def picked(one):
    source = one.sources[0]
    return tuple(w.value for w in one.perfusion.laws), source.source.scale, source.shift


def test_perfusion_power_and_place_come_back():
    fit = learn(model(), FIELD, frames(0.05), constants=picked, stepper=STEPPER)
    true = np.array([0.7, 4.0, 1.1, 2e-3, -1.5e-3])
    values, sd = np.array([(own.value, own.sd) for own in fit.constants.values()]).T
    assert np.abs((values - true) / sd).max() < 3
    assert np.all(sd[:3] < 0.15 * true[:3])
    assert fit.hyperparameters.noise == pytest.approx(1.0, rel=0.15)


def test_what_a_drift_explains_is_no_residual():
    data = frames()
    moved = data.values + np.linspace(-1, 1, 10)[None, None, :] + 1.0
    residuals = residuals_of(data)
    before = residuals(TRUTH)
    after = residuals_of(eqx.tree_at(lambda d: d.values, data, moved))(TRUTH)
    assert jnp.allclose(before, after, atol=1e-8)
    assert before.shape == (int(data.observed.sum()),)
    assert residuals.num_projected == 8 * 3


def test_without_drift_or_turns_residuals_are_those_of_probes():
    data = Readings(TIMES, clean() + 0.5, noise=np.full(GRID.shape, 0.25))
    assert jnp.allclose(residuals_of(data)(TRUTH), -2.0)


@pytest.mark.slow
def test_the_shift_of_a_source_keeps_its_power_and_moves_its_middle():
    moved = TRUTH.sources[0].shape(GRID)
    still = model().sources[0].shape(GRID)
    assert float(jnp.sum(moved)) == pytest.approx(float(jnp.sum(still)), rel=2e-2)
    places = (jnp.arange(12.0) + 0.5) * 4e-3
    gap = (moved.sum(1) @ places / moved.sum()) - (still.sum(1) @ places / still.sum())
    assert float(gap) == pytest.approx(2e-3, rel=0.15)  # some leaves the grid
    unmoved = ShiftedSource(PowerSource(still, 1e4), jnp.zeros(2), 3.0)
    assert jnp.allclose(unmoved.shape(GRID), 3 * still)


def test_a_spot_that_reaches_over_a_side_moves_as_if_there_were_none():
    """What comes in falls off as the map does: a fifth of the error else."""

    def spot(shift):
        distances = np.asarray(GRID.distances([0.026 + shift, 0.025]))
        return np.exp(-0.5 * (distances / 0.012) ** 2)

    still, true = spot(0.0), spot(4.6e-3)
    moved = ShiftedSource(
        PowerSource(jnp.asarray(still), 1e4), jnp.asarray([4.6e-3, 0])
    )
    errors = np.abs(np.asarray(moved.shape(GRID)) - true)
    assert errors[3:-1].max() < 1e-3
    assert errors[0].max() < 0.2 * (still[0] - true[0]).max()


def test_a_turn_of_the_phase_at_three_tesla():
    assert phase_turn(3.0, 0.02) == pytest.approx(39.14, abs=0.01)


def test_frames_up_to_a_time():
    assert frames().until(90.0).times.tolist() == [30.0, 60.0, 90.0]


def bad(**changes):
    still = {"times": TIMES, "values": np.full((8, 12, 10), 37.0)}
    return lambda: Readings(**still | {"noise": np.ones(GRID.shape)} | changes)


test_bad_frames = refusals(
    (bad(values=np.zeros((8, 3, 3))), "expected values of shape"),
    (bad(times=TIMES - 30.0), "increasing times > 0 s"),
    (bad(values=np.full((8, 12, 10), np.nan)), "expected a reading, got none"),
    (bad(noise=np.zeros(GRID.shape)), "expected a noise > 0 K at every voxel"),
    (bad(turn=-1.0), "expected a turn > 0 K"),
    (bad(drift="cubic"), "expected a drift, none, constant, linear"),
)


def test_frames_of_another_grid_or_without_a_drift():
    with pytest.raises(InputError, match="expected frames of shape"):
        residuals_of(Readings(TIMES, np.full((8, 3, 3), 37.0)))
    values = np.full((8, 12, 10), np.nan)
    values[:, 0, 0] = 37.0
    with pytest.raises(InputError, match="voxels in every frame that tell its drift"):
        residuals_of(Readings(TIMES, values, drift="linear"))
