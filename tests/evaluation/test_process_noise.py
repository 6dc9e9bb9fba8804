"""A wandering velocity widens the bands of rollouts by what it adds to their errors."""

import jax.numpy as jnp
import numpy as np
import pytest

from pinav import evaluation
from pinav.dynamics import OverdampedSwimmer
from pinav.evaluation.coverage import wandering_variance
from pinav.fitting import Posterior, ravel_model
from pinav.forces import HarmonicTrap, ZeroForce
from pinav.systems import WanderingVelocity
from pinav.trajectories import Trajectories

RATE, NOISE = 0.4, 0.02
WANDERING = WanderingVelocity(
    still=0.3, driven=0.4, memory=0.8, slow=0.1, slow_memory=10.0
)


def model():
    """A swimmer in a trap."""
    trap = HarmonicTrap(stiffness=RATE, center=jnp.zeros(2))
    return OverdampedSwimmer(ZeroForce(), trap, 1.0)


def paths(count, times, seed, fine=20):
    """Draws of positions in the trap, from (2, -1), carried by both velocities."""
    random = np.random.default_rng(seed)
    w, u = random.normal(size=(2, count, 2))
    x, path = np.tile([2.0, -1.0], (count, 1)), []
    sd = np.hypot(WANDERING.still, WANDERING.driven)  # commanded at 1 Hz
    for step in np.diff(times, append=times[-1] + 1.0) / fine:
        path.append(x)
        for _ in range(fine):
            x = x + step * (-RATE * x + sd * w + WANDERING.slow * u)
            kept = np.exp(-step / WANDERING.memory)
            w = kept * w + np.sqrt(1 - kept**2) * random.normal(size=w.shape)
            kept = np.exp(-step / WANDERING.slow_memory)
            u = kept * u + np.sqrt(1 - kept**2) * random.normal(size=u.shape)
    return np.stack(path, axis=1)


def recording(states, times):
    return Trajectories.from_arrays(
        [times] * len(states),
        list(states),
        channels=("x", "y"),
        commands={
            "frequency": [np.ones(len(times))] * len(states),
            "heading": [np.zeros(len(times))] * len(states),
        },
    )


TIMES = np.concatenate([np.arange(0.0, 6.0, 0.2), [7.0, 9.0, 14.0]])


@pytest.mark.parametrize("count", [1, 20])
def test_the_variance_is_that_of_simulated_paths(count):
    """Also after gaps much longer than the memory."""
    states = paths(8000, TIMES, seed=1)
    decay = np.exp(-RATE * TIMES)
    weights = decay[:count] / (decay[:count] ** 2).sum()
    starts = np.einsum("k,nkd->nd", weights, states[:, :count])
    errors = states - decay[None, :, None] * starts[:, None]
    piece = next(iter(recording(states[:1], TIMES)))
    mean = decay[:, None] * np.array([2.0, -1.0])
    variance = wandering_variance(model(), WANDERING, piece, mean, count)
    if count == 1:
        assert np.all(variance[0] == 0)
    measured = errors.var(axis=0)
    np.testing.assert_allclose(variance[count:], measured[count:], rtol=0.08)


def test_the_variance_is_not_known_once_the_rollout_diverged():
    piece = next(iter(recording(paths(1, TIMES, seed=0), TIMES)))
    path = np.zeros((len(TIMES), 2))
    path[12:] = np.nan
    variance = wandering_variance(model(), WANDERING, piece, path, 5)
    assert np.isfinite(variance[:12]).all()
    assert np.isnan(variance[12:]).all()


@pytest.mark.slow
def test_bands_cover_a_wandering_swimmer_as_often_as_nominal():
    """Of 60 recordings with noise; without the velocity hardly any sample is inside."""
    times = TIMES[:-3]
    random = np.random.default_rng(3)
    states = paths(60, times, seed=2)
    data = recording(states + NOISE * random.normal(size=states.shape), times)
    free, theta = ravel_model(model(), lambda m: m.environment.stiffness)
    posterior = Posterior(free, np.asarray(theta), np.array([[1e-6]]))
    starts = evaluation.estimate_starts(model(), data)
    scored = evaluation.without_first(data, starts.count)
    every = {"all": np.ones(scored.times.shape, bool)}

    def coverage(wandering):
        bands = evaluation.rollout_bands(
            posterior, data, starts, noise=NOISE, wandering=wandering
        )
        return evaluation.rollout_coverage(bands, scored, NOISE, every)["all"]

    assert coverage(WANDERING) == pytest.approx(0.95, abs=0.03)
    assert coverage(None) < 0.3
    exact = recording(states, times)
    bands = evaluation.rollout_bands(posterior, exact, wandering=WANDERING)
    inside = evaluation.rollout_coverage(
        bands, evaluation.without_first(exact, 1), 0.0, every
    )["all"]
    assert inside == pytest.approx(0.95, abs=0.03)
