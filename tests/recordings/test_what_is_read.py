"""What the reading of a file does to its numbers, and what is judged from them."""

import math

import numpy as np
import pandas as pd
import pytest

from pinav.reading import Reading
from pinav.recordings import units
from pinav.recordings.assembly import groups, image_positions, labels
from pinav.recordings.drive import (
    Drive,
    drive,
    path_length,
    speeds_by_frequency,
    window_ends,
    window_speeds,
)
from pinav.recordings.localisation import localisation
from pinav.recordings.quality import quality
from pinav.recordings.reading import read_recording
from pinav.trajectories.selection import concatenate
from pinav.trajectories.trajectory import Trajectory

RNG = np.random.default_rng(6)


def read(columns=None, units=None, **options):
    """A recording of a table; its columns are those that it is asked for."""
    table = pd.DataFrame(columns)
    names = options.pop("names", {name: name for name in columns})
    return read_recording(table, Reading(columns=names, units=units, **options))


FRAMES = np.arange(12)


def table(**more):
    """Two particles of twelve frames."""
    base = {
        "frame": np.tile(FRAMES, 2),
        "particle": np.repeat(["a", "b"], 12),
        "x": np.concatenate([2.0 * FRAMES, 3.0 * FRAMES + 100]),
        "y": np.concatenate([1.0 * FRAMES, 5.0 + 0 * FRAMES]),
    }
    return {**base, **more}


def test_units_are_multiples_of_micrometres_seconds_hertz_and_radians():
    lengths = {"nm": 1e-3, "um": 1, "mm": 1e3, "cm": 1e4, "m": 1e6}
    assert {u: units.length(u)[0] for u in lengths} == lengths
    times = {"ms": 1e-3, "s": 1, "min": 60, "h": 3600, "d": 86400}
    assert {u: units.duration(u)[0] for u in times} == times
    rates = {"Hz": 1, "kHz": 1e3, "rpm": 1 / 60, "rad/s": 1 / math.tau}
    for unit, factor in rates.items():
        assert math.isclose(units.command("frequency", "Hz", unit), factor)
    assert math.isclose(units.command("heading", "rad", "deg"), math.pi / 180)
    assert units.command("field_x", "1", "%") == 0.01


def test_positions_are_scaled_and_turned_and_go_back_to_the_image():
    recording = read(table(), fps=4.0, mpp=0.5)
    first, second = recording
    assert np.allclose(first.times, FRAMES / 4)
    assert np.allclose(first.states, np.stack([FRAMES, -0.5 * FRAMES], axis=1))
    assert recording.units["x"] == "um"
    back = image_positions(recording, second.states)
    assert np.allclose(back, np.stack([3.0 * FRAMES + 100, 5 + 0 * FRAMES], axis=1))
    up = read(table(), fps=4.0, mpp=0.5, y="up").trajectory(0)
    assert np.allclose(up.states[:, 1], 0.5 * FRAMES)
    scaled = read(table(), units={"x": "nm", "t": "s"}, fps=4.0)
    assert np.allclose(scaled.trajectory(0).states[:, 0], 2e-3 * FRAMES)


def test_labels_follow_what_is_chosen_and_joined():
    recording = read(table(), fps=1.0)
    assert [label["particle"] for label in labels(recording)] == ["a", "b"]
    second = recording.select([1])
    assert [label["particle"] for label in labels(second)] == ["b"]
    joined = concatenate([second, recording])
    assert [label["particle"] for label in labels(joined)] == ["b", "a", "b"]
    picked = joined.select([2, 0])
    assert [label["particle"] for label in labels(picked)] == ["b", "b"]
    assert groups(joined, "particle") == {("b",): [0, 2], ("a",): [1]}
    alone = read(table(), fps=1.0, particles=("b",))
    assert np.allclose(alone.trajectory(0).states[:, 0], 3.0 * FRAMES + 100)


@pytest.mark.parametrize(
    ("options", "cuts"),
    [
        ({}, 1),
        ({"jump": 30.1}, 1),
        ({"jump": 29.9}, 2),
        ({"gap": 3}, 1),
        ({"gap": 2}, 2),
    ],
)
def test_a_path_is_cut_at_jumps_and_gaps_beyond_their_limits(options, cuts):
    frame = np.array([0, 1, 2, 3, 4, 5, 8, 9, 10, 11])
    x = np.where(frame > 3, 30.0, 0.0)
    recording = read({"frame": frame, "x": x, "y": 0 * x}, fps=1.0, **options)
    assert len(recording) == cuts


def test_times_are_summed_from_the_intervals_of_each_particle():
    steps = np.tile([0.1, 0.2, 0.3, 0.1], 2)
    columns = {
        "dt [ms]": 1e3 * steps,
        "particle": np.repeat(["a", "b"], 4),
        "x": np.arange(8.0),
        "y": np.arange(8.0),
    }
    names = {"dt": "dt [ms]", "particle": "particle", "x": "x", "y": "y"}
    for piece in read(columns, names=names):
        assert np.allclose(piece.times - piece.times[0], [0, 0.2, 0.5, 0.6])


def test_commands_are_held_late_and_turned():
    heading = np.where(FRAMES < 6, 10.0, 50.0)
    columns = {
        "t": 1.0 * FRAMES,
        "x": 1.0 * FRAMES,
        "y": 0.0 * FRAMES,
        "frequency": np.where(FRAMES == 3, np.nan, 60.0 + FRAMES),
        "heading": heading,
    }
    stated = {"heading": "deg", "frequency": "rpm", "t": "s", "x": "um"}
    (piece,) = read(columns, units=stated, delay=1.0, heading_offset=0.25)
    late = np.maximum(FRAMES - 1, 0)
    late = np.where(late == 3, 2, late)
    assert np.allclose(piece.commands["frequency"], 1 + late / 60)
    late = np.maximum(FRAMES - 1, 0)
    assert np.allclose(piece.commands["heading"], np.radians(heading[late]) + 0.25)


def test_a_rate_that_is_not_that_of_the_times_is_noted():
    columns = table(t=np.tile(FRAMES * 0.1, 2))
    assert any(
        "fps 5 was given" in n for n in read(columns, fps=5.0).provenance["notes"]
    )
    near = read(columns, fps=10.05).provenance["notes"]
    assert not any("was given" in note for note in near)


def rolling(headings, frequency, step=0.125, speed=2.0):
    """A robot that follows its commands at once."""
    times = step * np.arange(len(headings))
    velocity = (
        speed * frequency[:, None] * np.stack([np.cos(headings), np.sin(headings)], 1)
    )
    states = np.concatenate([[[0, 0]], np.cumsum(step * velocity[:-1], axis=0)])
    commands = {"frequency": frequency, "heading": headings}
    return Trajectory(times, states, np.ones_like(states, bool), commands)


def test_what_a_drive_covers_is_counted():
    turning = np.linspace(0, math.tau, 600, endpoint=False)
    frequency = np.where(np.arange(600) % 4 == 0, 0.0, np.where(turning > 3, 2.0, 1.0))
    covered = drive([rolling(turning, frequency)])
    assert covered.frequency == (0.0, 2.0)
    assert (covered.levels, covered.off, covered.sectors) == (2, 0.25, 12)
    assert 20 / 180 < covered.aligned < 0.3
    assert covered.warnings() == []
    steady = drive([rolling(np.full(600, 0.3), np.full(600, 2.0))])
    assert (steady.levels, steady.sectors, steady.aligned) == (1, 1, 1.0)
    assert steady.condition > 1e6
    even = drive([rolling(turning, np.full(600, 2.0))])
    # Commands of one size all around are orthogonal to each other and to a drift.
    assert math.isclose(even.condition, 1.0, rel_tol=1e-6)
    assert math.isclose(even.raw_condition, math.sqrt(2), rel_tol=1e-6)
    assert even.delay < 0.01


GOOD = {
    "frequency": (0.0, 2.0),
    "levels": 2,
    "off": 0.1,
    "sectors": 3,
    "condition": 10.0,
    "raw_condition": 1.0,
    "aligned": 0.9,
    "delay": 0.2,
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frequency": (0.0, 0.0)}, "off throughout"),
        ({"levels": 1, "off": 0.0}, "single frequency"),
        ({"sectors": 2}, "hardly varies"),
        ({"condition": 10.1}, "gain and drift"),
        ({"aligned": 0.91}, "one axis"),
        ({"delay": 0.19}, "turning rate"),
    ],
)
def test_a_drive_is_warned_of_beyond_each_limit_alone(change, words):
    assert Drive(**GOOD).warnings() == []
    (warning,) = Drive(**GOOD | change).warnings()
    assert words in warning


def test_speeds_are_those_over_half_a_second():
    frequency = np.repeat([1.0, 2.0], 100)
    piece = rolling(np.zeros(200), frequency)
    first, last = window_ends(piece)
    assert (last - first == 4).all()
    speed, _, _ = window_speeds(piece)
    assert np.allclose(speed[:90], 2.0)
    assert np.allclose(speed[105:], 4.0)
    slow, fast = speeds_by_frequency([piece])
    assert (slow.frequency, fast.frequency) == (1.0, 2.0)
    assert np.allclose([slow.median, slow.low, slow.high], 2.0)
    assert np.allclose([fast.median, fast.low, fast.high], 4.0)
    assert slow.windows == 96
    assert math.isclose(path_length(piece), piece.states[196, 0])


def test_quality_counts_rows_lost_frames_and_the_clock():
    columns = table(t=np.tile(FRAMES * 0.1, 2))
    columns["t"] = columns["t"] + np.where(np.tile(FRAMES, 2) > 8, 0.15, 0.0)
    columns["x"][3] = np.nan
    names = {"t": "t", "particle": "particle", "x": "x", "y": "y"}
    found = quality(read(columns, names=names, units={"x": "um", "t": "s"}))
    one, other = found.tracks
    assert (one.samples, one.lost, other.samples, other.lost) == (11, 1, 12, 0)
    assert math.isclose(one.duration, 1.25)
    (run,) = found.runs
    assert (run.particles, run.samples, run.clock.gaps) == (2, 23, 2)
    assert math.isclose(run.clock.interval, 0.1)
    assert math.isclose(run.clock.rate, 10.0)
    assert math.isclose(run.clock.longest, 0.25)
    assert math.isclose(other.speed, 30.0, rel_tol=0.2)


def test_the_error_of_a_localisation_is_its_scatter_over_films():
    times = [np.arange(250.0)]

    def film():
        steps = 0.3 * RNG.standard_normal((250, 2))
        return localisation(
            times, [np.cumsum(steps, 0) + RNG.standard_normal((250, 2))]
        )

    films = [film() for _ in range(20)]
    deviations = np.array([one.deviation for one in films])
    error = np.median([one.error for one in films])
    assert abs(deviations.mean() - 1.0) < 0.03
    assert 0.5 < deviations.std(ddof=1) / error < 1.7
    diffusion = np.mean([one.diffusion for one in films])
    assert abs(diffusion / (0.3**2 / 2) - 1) < 0.5
