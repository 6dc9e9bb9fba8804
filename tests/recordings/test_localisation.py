"""Localisation error under motion, diffusion and irregular times, against the truth."""

import numpy as np
import pytest
from tests.identification.conftest import wander

from pinav.recordings.localisation import localisation


def observed(*, deviation, diffusion=0.0, speed=0.0, jitter=0.0, count=4000, seed=0):
    """Times and noisy positions of a particle that goes round in circles."""
    random = np.random.default_rng(seed)
    times = np.cumsum(0.04 * (1 + jitter * random.uniform(-1, 1, count)))
    angle = 1.5 * times
    circle = speed / 1.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    steps = np.sqrt(2 * diffusion * np.diff(times, prepend=0.0))[:, None]
    walk = np.cumsum(steps * random.standard_normal((count, 2)), axis=0)
    return times, circle + walk + deviation * random.standard_normal((count, 2))


ALL = {"deviation": 0.2, "diffusion": 0.5, "speed": 50.0, "jitter": 0.25}
CASES = {
    "at rest": {"deviation": 0.3},
    "driven": {"deviation": 0.3, "speed": 50.0},
    "driven, irregular times": {"deviation": 0.3, "speed": 50.0, "jitter": 0.25},
    "diffusing": {"deviation": 0.2, "diffusion": 0.5},
    "all together": ALL,
}


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_error_and_diffusion_are_found(case):
    times, path = observed(**case)
    found = localisation([times], [path])
    assert found is not None
    np.testing.assert_allclose(found.deviation, case["deviation"], rtol=0.1)
    assert found.scatter >= 0.98 * case["deviation"]
    if "diffusion" not in case:
        np.testing.assert_allclose(found.scatter, case["deviation"], rtol=0.03)
    diffusion = case.get("diffusion", 0.0)
    # What of an error could pass for diffusion, D = 0.1 sigma^2 / dt, is the tolerance.
    tolerance = 0.1 * diffusion + 0.1 * case["deviation"] ** 2 / 0.04
    np.testing.assert_allclose(found.diffusion, diffusion, atol=tolerance)


def test_diffusion_alone_is_hardly_taken_for_error():
    """Its steps are 0.2 long."""
    times, path = observed(deviation=0.0, diffusion=0.5)
    found = localisation([times], [path])
    assert found.deviation < 0.06
    np.testing.assert_allclose(found.diffusion, 0.5, rtol=0.1)


def test_steps_of_the_command_are_no_error():
    """A robot that turns back sharply every 2 s has kinks, which are left out."""
    times, path = observed(deviation=0.1, count=3000)
    path = path + 200.0 * np.abs((times / 2) % 2 - 1)[:, None]
    found = localisation([times], [path])
    np.testing.assert_allclose(found.deviation, 0.1, rtol=0.1)


@pytest.mark.parametrize("interval", [0.1, 0.5])
def test_motion_that_changes_from_row_to_row_is_no_diffusion(interval):
    """A velocity with a memory of 1 s: its steps are no parabola over four rows."""
    random = np.random.default_rng(1)
    times = interval * np.arange(3000)
    velocity = 0.3 * wander(random.standard_normal((3000, 2)), times)
    path = interval * np.cumsum(velocity, axis=0)
    found = localisation([times], [path + 0.2 * random.standard_normal(path.shape)])
    np.testing.assert_allclose(found.deviation, 0.2, rtol=0.1)


def test_segments_and_lost_rows_are_not_bridged():
    times, path = observed(deviation=0.3, count=3000)
    path[1500:] += 500.0
    path[::17] = np.nan
    found = localisation([times[:1500], times[1500:]], [path[:1500], path[1500:]])
    np.testing.assert_allclose(found.deviation, 0.3, rtol=0.1)


@pytest.mark.parametrize("count", [2, 8, 20])
def test_too_few_samples_give_nothing(count):
    times, path = observed(deviation=0.3, count=count)
    assert localisation([times], [path]) is None
