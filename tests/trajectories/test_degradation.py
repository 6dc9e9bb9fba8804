"""Each degradation against its closed form; inputs stay as they are."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pinav.errors import InputError
from pinav.trajectories import (
    FrameLoss,
    GaussianNoise,
    MotionBlur,
    Subsample,
    Trajectories,
    Unobserved,
    degrade,
)

KEY = jax.random.key(7)


def smooth(count=3, samples=400):
    """A parabola, a cosine and a straight line, at irregular times."""
    rng = np.random.default_rng(0)
    times = [np.cumsum(rng.uniform(0.01, 0.03, samples + i)) for i in range(count)]
    states = [np.stack([t**2, np.cos(2 * t), 3 * t + 1], axis=1) for t in times]
    return Trajectories.from_arrays(
        times,
        states,
        channels=("x", "y", "vx"),
        commands={"f": times},
        units={"x": "um"},
        provenance={"source": "test"},
    )


STEPS = {
    "noise": GaussianNoise(0.1),
    "loss": FrameLoss(0.3),
    "blur": MotionBlur(0.2),
    "unobserved": Unobserved(("vx",)),
    "subsample": Subsample(4),
}


@pytest.mark.parametrize("step", STEPS.values(), ids=list(STEPS))
def test_the_input_stays_and_the_provenance_remembers(step):
    data, untouched = smooth(), smooth()
    result = degrade(data, [step], key=KEY)
    assert_array_equal(data.states, untouched.states)
    assert_array_equal(data.observed, untouched.observed)
    assert data.provenance == untouched.provenance
    (note,) = result.provenance["degradation"]
    assert note["step"] == type(step).__name__
    assert result.provenance["source"] == "test"
    assert (result.channels, result.units) == (data.channels, data.units)
    assert len(result.commands["f"][0]) == len(result.times[0])
    again = degrade(data, [step], key=KEY)
    assert_array_equal(again.states, result.states)
    assert_array_equal(again.observed, result.observed)


def test_steps_in_sequence_are_noted_in_sequence():
    steps = [MotionBlur(0.1), GaussianNoise(0.05), FrameLoss(0.1)]
    result = degrade(degrade(smooth(), steps[:2], key=KEY), steps[2:], key=KEY)
    names = [note["step"] for note in result.provenance["degradation"]]
    assert names == ["MotionBlur", "GaussianNoise", "FrameLoss"]
    assert result.provenance["degradation"][1]["deviation"] == 0.05


def test_a_trajectory_is_degraded_alike_whatever_the_others_are():
    data = smooth()
    alone = degrade(data.select([0]), [GaussianNoise(0.1), FrameLoss(0.2)], key=KEY)
    together = degrade(data, [GaussianNoise(0.1), FrameLoss(0.2)], key=KEY)
    assert_array_equal(alone.trajectory(0).states, together.trajectory(0).states)
    assert not np.array_equal(together.observed[0], together.observed[1])


def test_noise_has_its_deviation_and_spares_what_was_not_observed():
    data = degrade(smooth(samples=4000), [Unobserved(("vx",))], key=KEY)
    result = degrade(data, [GaussianNoise(0.1)], key=KEY)
    noise = (result.states - data.states)[0, :4000]
    assert_allclose(noise[:, :2].std(), 0.1, rtol=4 / np.sqrt(16000))
    assert abs(noise[:, :2].mean()) < 4 * 0.1 / np.sqrt(8000)
    assert not noise[:, 2].any()
    only_y = degrade(data, [GaussianNoise(0.1, ("y",))], key=KEY)
    assert_array_equal(only_y.states[..., 0], data.states[..., 0])


def test_frames_are_lost_whole_and_at_the_rate_asked_for():
    result = degrade(smooth(samples=4000), [FrameLoss(0.3)], key=KEY)
    for piece in result:
        assert (piece.observed.all(axis=1) | ~piece.observed.any(axis=1)).all()
        assert piece.observed[[0, -1]].all()
        lost = 1 - piece.observed[:, 0].mean()
        assert_allclose(lost, 0.3, atol=4 * np.sqrt(0.21 / 4000))
    for piece in degrade(smooth(samples=40), [FrameLoss(0.99)], key=KEY):
        assert piece.observed[[0, -1]].all()


def test_blur_of_a_parabola_a_wave_and_a_line():
    data, exposure = smooth(), 0.2
    result = degrade(data, [MotionBlur(exposure)], key=KEY)
    times = data.trajectory(0).times
    whole = (times > times[0] + 0.1) & (times < times[-1] - 0.1)
    times, (x, y, vx) = times[whole], result.trajectory(0).states[whole].T
    chord = 0.03**2 / 12  # chords miss a curve by its second derivative times this
    assert_allclose(x - times**2, exposure**2 / 12, atol=2 * chord)
    sinc = np.sin(exposure) / exposure  # half the exposure times the frequency 2
    assert_allclose(y, np.cos(2 * times) * sinc, atol=4 * chord)
    assert_allclose(vx, 3 * times + 1, rtol=1e-12)
    piece = degrade(smooth(), [MotionBlur(0.2)], key=KEY).trajectory(0)
    middle = (piece.times[0] + piece.times[0] + 0.1) / 2
    assert_allclose(piece.states[0, 2], 3 * middle + 1, rtol=1e-12)


def test_samples_are_left_out_as_asked():
    data = smooth()
    result = degrade(data, [Subsample(4)], key=KEY)
    assert_array_equal(result.trajectory(1).states, data.trajectory(1).states[::4])
    assert_array_equal(
        result.trajectory(1).commands["f"], data.trajectory(1).times[::4]
    )
    kept = degrade(smooth(), [Unobserved(("vx",), keep_first=True)], key=KEY)
    assert kept.observed[:, 0].all()
    assert not kept.observed[:, 1:, 2].any()
    assert kept.trajectory(0).observed[:, :2].all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: GaussianNoise(-0.1), "Noise.deviation: expected 0 or more, got -0"),
        (lambda: FrameLoss(1.0), "probability: expected 0 to below 1, got 1.0"),
        (lambda: MotionBlur(0.0), "MotionBlur.exposure: expected > 0, got 0.0"),
        (lambda: Subsample(0), "Subsample.every: expected 1 or more, got 0"),
        (
            lambda: degrade(smooth(samples=4), [Subsample(9)], key=KEY),
            "Subsample: 4 samples leave a single one; expected every < 4, got 9",
        ),
        (
            lambda: degrade(smooth(), [Unobserved(("z",))], key=KEY),
            "Unobserved.channels: 'z' is no channel; expected some of x, y, vx",
        ),
        (
            lambda: degrade(smooth(), [FrameLoss(0.5), MotionBlur(0.1)], key=KEY),
            "MotionBlur: expected complete samples; apply it before FrameLoss",
        ),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(InputError, match=message):
        make()
