"""Truths of traps, rings and walls, on data whose law was put in."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter
from validation.truth import known

from pinav.errors import InputError
from pinav.forces import parallel_mobility

RANDOM = np.random.default_rng(4)


def relaxing(frames, decay, sd=1.0):
    """An Ornstein-Uhlenbeck process at equal times."""
    kicks = RANDOM.normal(size=frames)
    kicks[1:] *= np.sqrt(1 - decay**2)
    return sd * lfilter([1.0], [1.0, -decay], kicks)


def test_equipartition_sees_through_the_blur():
    """Variance 1 and rate 0.4 a frame, exposed for eight tenths of a frame."""
    fine = relaxing(60_000 * 10, np.exp(-0.04))
    frames = fine.reshape(-1, 10)[:, -8:].mean(axis=1)
    times = np.arange(len(frames)) / 7.0
    truth = known.trap_truth(times, frames)
    assert abs(truth.variance.value - 1) < 3 * truth.variance.sd < 0.06
    assert abs(truth.rate.value - 0.4 * 7) < 3 * truth.rate.sd < 0.3
    assert truth.recorded_variance < 0.94
    assert truth.stiffness(2.0).value == 2.0 / truth.variance.value
    kept = RANDOM.random(len(times)) > 0.2
    lost = known.trap_truth(times[kept], frames[kept])
    np.testing.assert_allclose(lost.variance.value, truth.variance.value, rtol=0.02)


def test_a_bead_that_does_not_relax_has_no_such_truth():
    with pytest.raises(InputError, match="expected 800 frames or more, got 100"):
        known.trap_truth(np.arange(100.0), np.ones(100))
    with pytest.raises(InputError, match="not positive at lags 1 to 4"):
        known.trap_truth(np.arange(2000.0), (-1.0) ** np.arange(2000))
    with pytest.raises(InputError, match="does not fall at lags 1 to 4"):
        known.trap_truth(np.arange(4000.0), np.tile(np.repeat([1.0, -1.0], 2000), 1))


def test_the_lag_is_that_of_the_drive():
    times = np.arange(1000.0)
    bead = 2 * times - 6 + 0.01 * RANDOM.normal(size=1000)
    lag = known.measured_lag(times, bead, 2 * times)
    assert abs(lag.value - 3) < 4 * lag.sd < 0.1
    drive = np.where(times < 500, 2 * times, 1500 - times)
    speed = np.where(times < 500, 2.0, -1.0)
    back = known.measured_lag(times, drive - 3 * speed + 0.7, drive)
    np.testing.assert_allclose(back.value, 3.0)
    with pytest.raises(InputError, match="expected a trap that moves"):
        known.measured_lag(times, bead, 0 * times)


def ring_fields(places):
    return 1.0 - 0.8 * np.cos(places), 0.1 + 0.03 * np.sin(places)


def test_the_steady_state_of_a_ring_has_the_drift_that_made_it():
    places = (np.arange(180) + 0.5) * 2 * np.pi / 180
    drift, diffusion = ring_fields(places)
    density, current = known.steady_state(drift, diffusion, 2 * np.pi)
    assert density.min() > 0
    np.testing.assert_allclose(density.sum() * 2 * np.pi / 180, 1.0)
    flow = diffusion * density
    slope = (np.roll(flow, -1) - np.roll(flow, 1)) / (4 * np.pi / 180)
    np.testing.assert_allclose(drift * density - slope, current, rtol=5e-3)
    flat = known.steady_state(np.full(60, 2.0), np.full(60, 0.3), 5.0)
    np.testing.assert_allclose(flat[0], 0.2)
    np.testing.assert_allclose(flat[1], 0.4)


def test_density_and_current_give_drift_and_diffusion_of_a_ring():
    step, tracks, frames = 0.01, 300, 6000
    x = RANDOM.uniform(0, 2 * np.pi, tracks)
    saved = np.empty((frames, tracks))
    for index in range(frames + 1000):
        drift = 1.0 - 0.8 * np.cos(x)
        x = x + step * drift + np.sqrt(0.2 * step) * RANDOM.normal(size=tracks)
        saved[max(index - 1000, 0)] = x
    truth = known.ring_truth(saved.T[:, ::5], 5 * step, 2 * np.pi)
    drift = 1.0 - 0.8 * np.cos(truth.angles)
    assert truth.distance(truth.drift(0.1), drift) < 0.03
    assert truth.distance(drift, drift, weighted=False) == 0
    learned = truth.diffusion_of(drift)
    assert abs(learned.value - 0.1) < 3 * learned.sd < 0.1
    expected = known.steady_state(drift, np.full(180, 0.1), 2 * np.pi)[1]
    assert abs(truth.mean_current.value - expected) < 3 * truth.mean_current.sd
    inside = np.abs(truth.drift(0.1) - drift) < 3 * truth.drift_sd(0.1)
    assert inside.mean() > 0.9
    with pytest.raises(InputError, match="two or more tracks"):
        known.ring_truth(saved.T[:1], step, 2 * np.pi)


@pytest.mark.parametrize("normal", [True, False])
def test_a_wall_is_found_where_it_stands(normal):
    mobility = known.brenner_mobility if normal else parallel_mobility
    gaps = np.linspace(0.05, 2.0, 40)
    values = 0.15 * np.asarray(mobility(jnp.asarray(gaps / 1.5)))
    score = known.wall_score(gaps + 7.0, values, 1.5, normal=normal, least_gap=0.15)
    np.testing.assert_allclose([score.contact, score.bulk], [7.0, 0.15], atol=2e-4)
    assert score.error < 1e-3
    given = known.wall_score(gaps + 7.0, 1.05 * values, 1.5, normal=normal, bulk=0.15)
    assert 0.01 < given.error < 0.2
    with pytest.raises(InputError, match="expected four or more heights"):
        known.wall_score(gaps[:3], values[:3], 1.5, normal=normal)


def test_heights_that_are_doubtful_place_no_wall():
    gaps = np.linspace(0.05, 2.0, 40)
    true = 0.15 * np.asarray(known.brenner_mobility(jnp.asarray(gaps / 1.5)))
    near = gaps < 0.3
    learned = np.where(near, 1.2 * true, true)
    sd = np.where(near, 0.2, 0.002) * learned
    plain = known.wall_score(gaps + 7.0, learned, 1.5, normal=True)
    weighted = known.wall_score(gaps + 7.0, learned, 1.5, normal=True, sd=sd)
    assert abs(weighted.contact - 7.0) < 1e-3 < 0.01 < abs(plain.contact - 7.0)


def test_boltzmanns_law_gives_the_weight():
    heights = RANDOM.exponential(0.56, size=20_000)
    force = known.boltzmann_force(heights, 0.2, 2.5, 4.0)
    assert abs(force.value + 4.0 / 0.56) < 3.5 * force.sd < 0.7
    level = known.boltzmann_force(np.tile([0.5, 1.5], 200), 0.0, 2.0, 1.0)
    assert abs(level.value) < 1e-6
    with pytest.raises(InputError, match="expected 100 heights or more"):
        known.boltzmann_force(heights, 50.0, 60.0, 1.0)
