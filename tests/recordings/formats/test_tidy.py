"""The tidy table, and what is common to all formats: cuts, commands, labels."""

import gzip

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.defects import defects, told

from pinav.recordings import COMMAND_UNITS, Reading, groups, labels, read_recording
from pinav.trajectories import concatenate

HEADER = "run,particle,segment,frame,t_s,x_um,y_um,freq_hz,alpha_rad"


def rows(*lines):
    return "\n".join([HEADER, *lines, ""])


def test_table_in_micrometres_is_taken_as_it_is(read):
    data = read(
        rows(
            "10,1,0,5,0.0,1.5,-2.5,3,0.1",
            "10,1,0,6,0.04,2.5,-3.5,4,0.2",
            "10,1,1,9,0.2,9,8,5,0.3",
            "10,1,1,10,0.3,7,6,6,0.4",
            "b,2.0,0,0,0.0,1,1,0,0",
            "b,2.0,0,2,0.1,2,2,0,0",
        )
    )
    assert labels(data) == [
        {"run": "10", "particle": "1", "segment": 0},
        {"run": "10", "particle": "1", "segment": 1},
        {"run": "b", "particle": "2", "segment": 0},
    ]
    np.testing.assert_array_equal(data.trajectory(0).states, [[1.5, -2.5], [2.5, -3.5]])
    np.testing.assert_array_equal(data.trajectory(1).times, [0.2, 0.3])
    np.testing.assert_array_equal(data.trajectory(1).commands["frequency"], [5, 6])
    np.testing.assert_array_equal(data.trajectory(1).commands["heading"], [0.3, 0.4])
    assert data.units == {
        "x": "um",
        "y": "um",
        "t": "s",
        "frequency": "Hz",
        "heading": "rad",
    }
    assert data.provenance["positions"]["y flipped"] is False
    assert data.provenance["source"] == "tracks.csv"


PIXELS = "t_s,x_px,y_px\n0,10,20\n1,12,26\n2,14,32\n"


def test_pixels_are_flipped_and_scaled(read):
    data = read(PIXELS, mpp=0.5)
    np.testing.assert_array_equal(data.states[0], [[5, -10], [6, -13], [7, -16]])
    assert data.units["x"] == "um"
    plain = read(PIXELS)
    np.testing.assert_array_equal(plain.states[0], [[10, -20], [12, -26], [14, -32]])
    assert plain.units["x"] == "px"
    up = read(PIXELS, y="up")
    np.testing.assert_array_equal(up.states[0, :, 1], [20, 26, 32])
    assert [r.provenance["positions"]["y flipped"] for r in (plain, up)] == [
        True,
        False,
    ]


def test_gzip_is_unpacked(read):
    data = read(gzip.compress(PIXELS.encode()), name="a.csv.gz")
    assert len(data) == 1
    assert labels(data)[0]["run"] == "a"


def track(frames, xs, commands=None):
    lines = ["frame,t_s,x_px,y_px" + (",freq_hz,alpha_rad" if commands else "")]
    for index, (frame, x) in enumerate(zip(frames, xs, strict=True)):
        tail = "" if not commands else f",{commands[index]},{commands[index] / 10}"
        lines.append(f"{frame},{frame / 10!r},{x},0{tail}")
    return "\n".join(lines)


def test_track_is_cut_at_jumps_and_gaps_and_never_bridged(read):
    frames = [0, 1, 2, 3, 13, 14, 25, 26]
    text = track(frames, [0, 1, 41, 82, 83, 84, 85, 86])
    data = read(text)
    assert [p.times.tolist() for p in data] == [
        [0.0, 0.1, 0.2],
        [0.3, 1.3, 1.4],
        [2.5, 2.6],
    ]
    assert [label["segment"] for label in labels(data)] == [0, 1, 2]
    assert len(read(track(frames, [0, 1, 41, 82, 83, 84, 85, 86]), jump=39.0)) == 3
    assert (
        len(read(track(frames, [0, 1, 41, 82, 83, 84, 85, 86]), jump=1e3, gap=20)) == 1
    )
    data = read(track([0, 1, 2, 3, 4], [0, 1, 90, 1, 2]))
    assert len(data) == 2
    assert [p["segment"] for p in data.provenance["segments left out"]] == [1]
    times = [0, 0.1, 0.2, 0.3, 0.4, 1.4, 2.5, 2.6]
    text = "t_s,x_px,y_px\n" + "".join(f"{t},0,0\n" for t in times)
    assert [len(p.times) for p in read(text)] == [6, 2]


def test_lost_positions_stay_as_rows_without_observation(read):
    text = "frame,t_s,x_px,y_px,freq_hz,alpha_rad\n"
    text += "0,0,,nan,1,0\n1,1,5,5,2,0\n2,2,,6,3,0\n3,3,7,7,4,0\n4,4,,,5,0\n"
    data = read(text)
    np.testing.assert_array_equal(data.times, [[1, 2, 3]])
    np.testing.assert_array_equal(data.observed[0], [[1, 1], [0, 0], [1, 1]])
    np.testing.assert_array_equal(data.commands["frequency"], [[2, 3, 4]])


def test_heading_offset_is_added_and_recorded(read):
    text = track(range(3), range(3), [1, 2, 3])
    data = read(text, heading_offset=np.pi / 2)
    np.testing.assert_allclose(data.commands["heading"][0], np.pi / 2 + np.r_[1:4] / 10)
    assert data.provenance["commands"]["heading_offset"] == np.pi / 2


def test_delay_shifts_commands_across_cuts(read):
    """A robot that was lost for a while still had its commands."""
    text = track(range(6), [0, 1, 2, 90, 91, 92], [1, 2, 3, 4, 5, 6])
    data = read(text, delay=0.2)
    assert [p.commands["frequency"].tolist() for p in data] == [[1, 1, 1], [2, 3, 4]]
    between = read(text, delay=0.15)
    assert between.trajectory(1).commands["frequency"].tolist() == [2, 3, 4]
    assert data.provenance["commands"]["delay"] == 0.2


def test_missing_commands_are_held_and_counted(read):
    text = "t_s,x_px,y_px,freq_hz,alpha_rad\n"
    text += "0,0,0,,\n1,0,0,2,1\n2,0,0,,1\n3,0,0,4,1\n"
    data = read(text)
    np.testing.assert_array_equal(data.commands["frequency"], [[2, 2, 2, 4]])
    assert data.provenance["rows without a command"] == 2


def test_frames_sort_rows_and_one_time_of_two_frames_is_left_out(read):
    text = "frame,t_s,x_px,y_px\n2,0.2,2,0\n0,0,0,0\n3,0.2,3,0\n1,0.1,1,0\n"
    data = read(text)
    np.testing.assert_array_equal(data.states[0, :, 0], [0, 1, 2])
    assert data.provenance["repeated times left out"] == 1


def test_labels_follow_selections_and_joins(read):
    data = read(
        "run,kind,particle,t_s,x_um,y_um\n"
        + "".join(
            f"{run},{kind},{particle},{t},0,0\n"
            for run in "ab"
            for kind in ("bead", "swimmer")
            for particle in (1, 2)
            for t in (0, 1)
        )
    )
    assert labels(data)[3] == {
        "run": "a",
        "particle": "swimmer 2",
        "kind": "swimmer",
        "segment": 0,
    }
    chosen = data.select([5, 2]).select([1])
    assert [label["particle"] for label in labels(chosen)] == ["swimmer 1"]
    joined = concatenate([chosen, data]).select([0, 1])
    assert [label["particle"] for label in labels(joined)] == ["swimmer 1", "bead 1"]
    assert list(groups(data, "run", "kind")) == [
        ("a", "bead"),
        ("a", "swimmer"),
        ("b", "bead"),
        ("b", "swimmer"),
    ]
    assert groups(data)["b", "bead 2"] == [5]
    with told("no label 'robot'; expected some of run"):
        groups(data, "robot")


def test_labels_of_other_trajectories_are_refused(paper_trajectories):
    with told("say nothing of runs and particles"):
        labels(paper_trajectories)


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)), min_size=2, max_size=8
    ),
    st.floats(0.01, 10),
)
def test_every_digit_survives(tmp_path_factory, points, mpp):
    path = tmp_path_factory.mktemp("tidy") / "a.csv"
    lines = [f"{i},{x!r},{y!r}" for i, (x, y) in enumerate(points)]
    path.write_text("\n".join(["t_s,x_px,y_px", *lines]))
    data = read_recording(path, Reading(mpp=mpp, jump=1e9))
    expected = mpp * np.array(points) * [1, -1]
    np.testing.assert_array_equal(data.states[0], expected)


def good(row, column, value):
    """A sound table, one cell of which is another."""
    lines = [["run", "particle", "frame", "t_s", "x_px", "y_px", "freq_hz"]]
    lines += [["a", "1", str(i), str(i / 10), str(i), "2", "3"] for i in range(4)]
    lines[row][lines[0].index(column)] = value
    return "\n".join(map(",".join, lines))


BAD = [
    ("\n\n", r"the file is empty"),
    ("t_s,angle_rad\n0,1\n", r"columns t_s, angle_rad: a log of comm"),
    ("t_s,x_px\n0,1\n1,2\n", r"header: column 'y_px' is missing; got t_s"),
    (good(3, "t_s", "nan"), r"line 4, column 't_s': .* got 'nan'; give"),
    (good(3, "t_s", ""), r"line 4, column 't_s': .* got an empty cell; gi"),
    (
        good(3, "t_s", "0.05"),
        r"line 4, column 't_s': time 0.05 is before the time 0.1 of line 3; sort",
    ),
    (good(4, "freq_hz", "off"), r"line 5, .*'freq_hz': .* 'off'"),
    ("t_s|x_px|y_px\n0|1|2\n", r"the format is not known; say what"),
]


@defects("content, message", BAD)
def test_damage_is_named_with_its_place(read, content, message):
    with told(r"tracks\.csv: .*" + message):
        read(content)


BAD_READING = [
    ({"format": "excel"}, r"format: expected one of .*tidy.* got 'excel'"),
    ({"mpp": 0.0}, r"mpp: expected > 0, got 0"),
    ({"gap": 0}, r"gap: expected > 0"),
    ({"jump": -1.0}, r"jump: expected > 0"),
    ({"delay": -0.1}, r"delay: expected 0 or more, got -0.1"),
    ({"heading_offset": np.nan}, r"heading_offset: expected a number"),
    ({"likelihood": 2.0}, r"likelihood: expected 0 to 1, got 2"),
    ({"delay": 0.1}, r"delay: the file has no commands"),
    ({"heading_offset": 1.0}, r"offset: the file has no commands; leave it out"),
    ({"fps": 20.0}, r"fps: the file has times and no frames"),
]


@defects("reading, message", BAD_READING)
def test_wrong_options_are_named(read, reading, message):
    with told(message):
        read(PIXELS, **reading)


MAGSCOPE = "magscope_speed_vs_freq/{}.csv.gz"
PILLARS = "ecoli_pillars_trackmate/{}-rep1-02022024.csv"
FILM = {"fps": 20.0, "mpp": 0.656}
REAL = {
    "magscope_cellbot_sessions/sessions.csv.gz": (22_360, 9, 9, {}),
    "magscope_roller_circles/control_circles.csv.gz": (11_756, 1, 6, {}),
    "magscope_roller_circles/idle_brownian.csv.gz": (880, 4, 4, {}),
    MAGSCOPE.format("5um_roller"): (68_242, 81, 91, {}),
    MAGSCOPE.format("5um_dimer"): (28_001, 5, 5, {}),
    MAGSCOPE.format("20um_roller"): (36_458, 14, 24, {}),
    MAGSCOPE.format("cellbot"): (118_004, 33, 42, {}),
    "dna_microswimmer_flow/tracks.csv.gz": (66_337, 29, 29, {}),
    PILLARS.format("dev1-pil0-dis0"): (836, 5, None, FILM),
    PILLARS.format("sorted-dev1-pil3-dis1"): (2757, 9, None, FILM),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_a_real_file_is_read_whole(recording, name):
    """Counts as its README states them; single rows and repeated times are named."""
    samples, tracks, segments, reading = REAL[name]
    data = read_recording(recording(name), Reading(**reading))
    left_out = data.provenance["segments left out"]
    repeats = data.provenance.get("repeated times left out", 0)
    assert int(data.lengths.sum()) == samples - len(left_out) - repeats
    assert (
        len({*groups(data)} | {(p["run"], p["particle"]) for p in left_out}) == tracks
    )
    assert segments in (None, len(data) + len(left_out))
    assert set(data.commands) <= set(COMMAND_UNITS)
    assert repeats == (1 if "5um_roller" in name else 0)
    if reading:
        assert data.times.max() <= 40.0
        assert set(data.units.values()) == {"um", "s"}
        plain = read_recording(recording(name))
        assert plain.units["t"] == "frame"
        assert "frame numbers" in plain.provenance["notes"][0]
