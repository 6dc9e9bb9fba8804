"""The quality report: counts, clock, speeds, coverage and what it warns of."""

import numpy as np
import pytest

from pinav.recordings import Reading, read_recording
from pinav.recordings.drive import WARNINGS, drive
from pinav.recordings.quality import quality
from pinav.trajectories import Trajectories

TIMES = np.arange(0, 60, 0.05)


def recorded(frequency, heading, *, times=TIMES, gain=3.0):
    """A swimmer that obeys at once, with its commands."""
    frequency, heading, _ = np.broadcast_arrays(frequency, heading, times)
    frequency, heading = np.array(frequency, float), np.array(heading, float)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    steps = (gain * frequency[:, None] * ahead)[:-1] * np.diff(times)[:, None]
    return Trajectories.from_arrays(
        [times],
        [np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])],
        commands={"frequency": [frequency], "heading": [heading]},
        channels=("x", "y"),
        units={"x": "um", "y": "um", "t": "s"},
        provenance={"trajectories": [{"run": "a", "particle": "1", "segment": 0}]},
    )


def random_turns(times=TIMES, seed=0):
    """A heading whose turning rate changes sign every few seconds."""
    random = np.random.default_rng(seed)
    rates = np.repeat(random.uniform(-2, 2, len(times) // 40 + 1), 40)[: len(times)]
    return np.cumsum(rates * 0.05)


def warnings(data):
    return set(quality(data).runs[0].warnings)


def test_good_commands_bring_no_warning():
    frequency = np.where(TIMES < 10, 0.0, 2.0 + np.round(TIMES / 20))
    assert warnings(recorded(frequency, random_turns())) == set()


CIRCLES = 2.0 + np.floor(TIMES / 15), 0.4 * TIMES
LINES = {
    "off": (0.0, 0.0),
    "frequency": (3.0, random_turns()),
    "heading": (2.0 + (TIMES > 30), 0.3 * np.sin(TIMES)),
    "drift": (2.0, 0.1 * np.sin(TIMES)),
    "delay": CIRCLES,
}


@pytest.mark.parametrize("name", LINES)
def test_each_warning_has_its_cause(name):
    found = warnings(recorded(*LINES[name]))
    assert WARNINGS[name] in found
    assert name != "delay" or len(found) == 1


def test_delay_is_confounded_exactly_where_turning_is_constant():
    """The share of a delay's effect that no gain matrix imitates, in its limits."""
    steady = drive(list(recorded(3.0, 0.4 * TIMES)))
    assert steady.delay < 1e-6
    free = drive(list(recorded(3.0, random_turns())))
    assert free.delay > 0.5


@pytest.mark.parametrize(
    ("frequency", "count", "rtol"),
    [(2.0 + np.floor(TIMES / 15), 4, 1e-3), (np.linspace(0.1, 5, len(TIMES)), 12, 0.1)],
    ids=["steps", "bins"],
)
def test_speeds_are_those_of_the_swimmer(frequency, count, rtol):
    found = quality(recorded(frequency, 0.05 * TIMES)).runs[0].speeds
    assert len(found) == count
    if count == 4:
        assert [speed.frequency for speed in found] == [2, 3, 4, 5]
    for speed in found:
        np.testing.assert_allclose(speed.median, 3.0 * speed.frequency, rtol=rtol)


def test_clock_and_way_of_a_straight_run():
    times = np.delete(TIMES, [50, 51, 200])
    found = quality(recorded(2.0, 0.0, times=times))
    run, track = found.runs[0], found.tracks[0]
    np.testing.assert_allclose(run.clock.rate, 20)
    np.testing.assert_allclose(run.clock.longest, 0.15)
    assert run.clock.gaps == 2
    np.testing.assert_allclose(run.clock.jitter, 0, atol=1e-9)
    np.testing.assert_allclose(track.speed, 6.0)
    np.testing.assert_allclose(track.path, 6.0 * (times[-1] - times[0]), rtol=0.02)
    assert (track.samples, track.lost, track.segments) == (len(times), 0, 1)


def test_recording_without_commands_scale_or_rate_says_so(read):
    data = read("frame,particle,x,y\n0,0,1,2\n1,0,1,2\n2,0,1,2\n")
    found = quality(data)
    assert found.runs[0].drive is None
    words = " ".join(found.warnings)
    for part in ("no commands of frequency", "give fps to have", "give mpp to have"):
        assert part in words
    unknown = quality(read("particle_id,frame,x,y\n0,0,1,2\n0,1,1,2\n"))
    assert "the unit of length is unknown" in " ".join(unknown.warnings)


def test_what_was_left_out_is_noted(read):
    text = "frame,t_s,x_px,y_px\n0,0,5,0\n1,0.1,5,0\n2,0.1,5,0\n3,0.3,90,0\n"
    notes = quality(read(text)).notes
    assert notes == ["1 repeated times left out", "1 segments of a single row left out"]


def test_real_sessions_tell_the_delay_only_on_random_paths(recording):
    """As its README measured, every delay fits the circles and 0.3 s the two others."""
    data = read_recording(
        recording("magscope_cellbot_sessions/sessions.csv.gz"),
        Reading(heading_offset=np.pi / 2),
    )
    for run in quality(data).runs:
        confounded = WARNINGS["delay"] in run.warnings
        assert confounded == run.name.startswith("datasetGP__"), run.name
        assert run.drive.condition < 2
        assert 0.05 < run.scatter < 1.5
        np.testing.assert_allclose(run.clock.rate, 10, rtol=0.05)


def test_error_and_diffusion_of_the_synthetic_trap(recording):
    """Its README states 0.023 and 0.5, from increments and their covariance."""
    data = read_recording(recording("sfi_synthetic_trap/optical_tweezer.csv"))
    found = quality(data).tracks[0].localisation
    np.testing.assert_allclose(found.diffusion, 0.5, rtol=0.1)
    np.testing.assert_allclose(found.deviation, 0.023, rtol=0.3)
