import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.defects import defects, told

from pinav import __version__
from pinav.scenarios import paper
from pinav.systems import Observation, system_text
from pinav.trajectories import (
    Trajectories,
    concatenate,
    halve,
    join,
    simulate,
    split,
    with_missing_channels,
)

NAN, INF = float("nan"), float("inf")
XY = ("x", "y")


def table(num_samples, start=0.0):
    return start + np.arange(2.0 * num_samples).reshape(-1, 2)


def ragged(count=3, **more):
    """Trajectories of 2, 3, ... samples whose states start at 0, 10, ..."""
    lengths = range(2, 2 + count)
    return Trajectories.from_arrays(
        [0.5 * np.arange(float(n)) for n in lengths],
        [table(n, 10.0 * i) for i, n in enumerate(lengths)],
        channels=XY,
        **more,
    )


def one(times=(0.0, 1.0, 2.0), states=None, **more):
    states = table(len(times)) if states is None else states
    return Trajectories.from_arrays(times, states, **({"channels": XY} | more))


def test_padding_repeats_the_last_row_and_is_not_observed():
    both = ragged(2, commands={"heading": [[1.0, 2.0], [3.0, 4.0, 5.0]]})
    np.testing.assert_array_equal(both.times, [[0.0, 0.5, 0.5], [0.0, 0.5, 1.0]])
    np.testing.assert_array_equal(both.states[0], [[0, 1], [2, 3], [2, 3]])
    np.testing.assert_array_equal(both.observed[:, :, 0], [[1, 1, 0], [1, 1, 1]])
    np.testing.assert_array_equal(both.commands["heading"], [[1, 2, 2], [3, 4, 5]])
    np.testing.assert_array_equal(both.lengths, [2, 3])
    assert (len(both), both.num_observed) == (2, 10)


@pytest.mark.parametrize("least", [1, 2, 3, 9])
def test_halves_have_the_samples_of_the_whole_in_their_order(least):
    whole = ragged(6, commands={"heading": [np.arange(float(n)) for n in range(2, 8)]})
    halves = halve(whole, least)
    assert len(halves) == sum(2 if n // 2 >= least else 1 for n in range(2, 8))
    assert min(halves.lengths) >= min(least, 2)
    np.testing.assert_array_equal(join(halves.states, halves, whole), whole.states)
    for name in ("times", "states"):
        pieces = [getattr(piece, name) for piece in halves]
        kept = [getattr(piece, name) for piece in whole]
        np.testing.assert_array_equal(np.concatenate(pieces), np.concatenate(kept))
    again = halve(halves, least)
    np.testing.assert_array_equal(join(again.states, again, whole), whole.states)


def test_one_trajectory_and_one_vector_of_times_need_no_list():
    assert eqx.tree_equal(
        one(), Trajectories.from_arrays([[0.0, 1.0, 2.0]], [table(3)], channels=XY)
    )
    shared = Trajectories.from_arrays(
        jnp.arange(3.0), np.stack([table(3), table(3)]), channels=XY
    )
    np.testing.assert_array_equal(shared.times, [[0, 1, 2], [0, 1, 2]])


def test_what_is_not_observed_is_zero_whatever_it_was():
    states = [[1.0, NAN], [2.0, 7.0], [NAN, 3.0]]
    observed = [[True, False], [True, False], [False, True]]
    data = one(states=states, observed=observed)
    np.testing.assert_array_equal(data.states[0], [[1, 0], [2, 0], [0, 3]])
    np.testing.assert_array_equal(data.observed[0], observed)
    assert data.num_observed == 3


def test_arrays_are_copies_that_cannot_be_written():
    times, states = np.arange(3.0), table(3)
    data = one(times, states)
    states[0, 0] = 99.0
    assert data.states[0, 0, 0] == 0.0
    for array in (data.times, data.states, data.observed, data.lengths):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_units_not_stated_are_unknown():
    data = one(units={"x": "µm", "t": "s"}, commands={"heading": [0.0, 1.0, 2.0]})
    assert data.units == {"x": "µm", "y": "?", "t": "s", "heading": "?"}


def test_trajectory_drops_the_padding():
    data = ragged(commands={"heading": [np.arange(n) for n in (2, 3, 4)]})
    for index, piece in enumerate(data):
        assert len(piece.times) == len(piece.commands["heading"]) == index + 2
        np.testing.assert_array_equal(piece.states, table(index + 2, 10.0 * index))
    np.testing.assert_array_equal(data.trajectory(-1).states, piece.states)


def test_selected_and_joined_trajectories_remember_where_from():
    data = ragged(provenance={"seed": 1})
    some = data.select([2, 0])
    np.testing.assert_array_equal(some.lengths, [4, 2])
    np.testing.assert_array_equal(some.states[:, 0, 0], [20.0, 0.0])
    assert some.provenance == {"seed": 1, "selection": [2, 0]}
    short = some.select([1])
    assert short.times.shape == (1, 2)
    assert short.provenance["selection"] == [0]
    data = ragged(commands={"heading": [np.arange(n) for n in (2, 3, 4)]})
    again = concatenate([data.select([0]), data.select([1, 2])])
    assert again.provenance["concatenated"][1] == {"selection": [1, 2]}
    same = dataclasses.replace(again, provenance=data.provenance)
    assert eqx.tree_equal(same, data)


@pytest.mark.parametrize(("fraction", "num_train"), [(0.01, 1), (0.5, 4), (0.99, 7)])
def test_split_parts_the_trajectories(fraction, num_train):
    data = ragged(8)
    train, held_out = split(data, fraction, key=jax.random.key(0))
    assert len(train) == num_train
    firsts = np.concatenate([train.states[:, 0, 0], held_out.states[:, 0, 0]])
    np.testing.assert_array_equal(np.sort(firsts), data.states[:, 0, 0])


def test_split_depends_on_its_key_alone():
    parts = [
        split(ragged(8), 0.5, key=jax.random.key(seed)).train.provenance["selection"]
        for seed in (0, 0, 1)
    ]
    assert parts[0] == parts[1] != parts[2]


def test_simulation_says_how_it_was_made(paper_trajectories):
    data = paper_trajectories
    assert data.states.shape == (1, 501, 4)
    assert data.num_observed == 2004
    assert data.units == dict.fromkeys(("x", "y", "vx", "vy", "t"), "1")
    np.testing.assert_array_equal(data.states[0, 0], paper().starts[0])
    assert data.provenance == {
        "scenario": "paper",
        "system": system_text(paper()),
        "noise": 0.0,
        "key": None,
        "solver": "Dopri8",
        "rtol": 1e-11,
        "atol": 1e-11,
        "pinav": __version__,
    }


def test_simulation_needs_a_key_for_noise_of_its_size_and_float64(paper_trajectories):
    noisy = dataclasses.replace(paper(), observation=Observation(noise=0.25))
    key = jax.random.key(7)
    data = simulate(noisy, key=key)
    residual = data.states - paper_trajectories.states
    np.testing.assert_allclose(residual.std(), 0.25, rtol=0.05)
    np.testing.assert_allclose(residual.mean(), 0.0, atol=0.02)
    assert data.provenance["key"] == jax.random.key_data(key).tolist()
    assert data.provenance["noise"] == 0.25
    with told(r"'paper' adds noise of 0.25; pass key="):
        simulate(noisy)
    coarse = dataclasses.replace(paper(), starts=jnp.zeros((1, 4), jnp.float32))
    with told(r"jax.config.update\(\"jax_enable_x64\""):
        simulate(coarse)


BAD_ARRAYS = [
    ({"states": [1.0, 2.0, 3.0]}, r"states: expected an array with 2 .* got 1 axes"),
    ({"times": [], "states": []}, r"states: expected an array with 2 axes"),
    ({"states": [[1.0, 2.0], [3.0], [4.0, 5.0]]}, r"states: expected rows of eq"),
    ({"states": [["a", "b"]] * 3}, r"states: expected numbers, got <U1"),
    ({"states": [[None, 1.0]] * 3}, r"expected numbers, got object"),
    (
        {"states": table(4)},
        r"states of trajectory 0: .*\(3, 2\) for 3 times .*\(4, 2\)",
    ),
    ({"channels": ("x",)}, r"expected shape \(3, 1\) .* channels x; got \(3, 2\)"),
    ({"observed": [[True, False]]}, r"observed of trajectory 0: .*\(3, 2\) .*\(1, 2\)"),
    ({"observed": np.ones((3, 2))}, r"observed: expected booleans, got float64"),
    ({"commands": {"f": [1.0, 2.0]}}, r"command 'f' of trajectory 0: .* shape \(3,\)"),
    ({"commands": {"f": [1, 2, INF]}}, r"command 'f' of trajectory 0, row 2: .* inf"),
    ({"times": (0.0, NAN, 1.0)}, r"times of trajectory 0, row 1: .* number, got nan"),
    (
        {"times": (0.0, 1.0, 1.0)},
        r"times of .* 0, row 2: time 1.0 after 1.0 is repeated",
    ),
    ({"times": (0.0, 1.0, 0.5)}, r"row 2: time 0.5 after 1.0 is out of order; .*sort"),
    ({"times": (0.0,)}, r"trajectory 0: expected two or more samples, got 1"),
    ({"channels": ()}, r"channels: expected names such as"),
    ({"channels": "xy"}, r"channels: .* got 'xy'"),
    ({"channels": ("x", "x")}, r"'x': stands twice"),
    ({"commands": {"x": [0.0] * 3}}, r"channel 'x': stands twice"),
    ({"channels": ("t", "y")}, r"'t': .*; rename it"),
    ({"channels": (" x", "y")}, r"expected no space or #"),
    ({"channels": ("x\n", "y")}, r"printable names"),
    ({"units": {"z": "m"}}, r"units: 'z' is no channel; expected some of x, y, t"),
    ({"provenance": {"array": np.ones(2)}}, r"provenance: expected JSON values"),
    ({"provenance": {"noise": NAN}}, r"provenance: expected JSON values"),
]
KEY = jax.random.key(0)
HOLED = [table(2), [[0.0, 1.0], [2.0, NAN]]]
BAD_CALLS = [
    (
        lambda: Trajectories.from_arrays([[0.0, 1.0]], [table(2)] * 2, channels=XY),
        r"times: expected one array for each of the 2 trajectories, got 1",
    ),
    (
        lambda: Trajectories.from_arrays([[0.0, 1.0]] * 2, HOLED, channels=XY),
        r"states of trajectory 1, column 1 \(y\), row 1: .*got nan; .*observed=",
    ),
    (lambda: ragged().select([]), r"expected one or more whole numbers"),
    (
        lambda: ragged().select([True, False, True]),
        r"expected one or more whole numbers, got \[True",
    ),
    (lambda: ragged().trajectory(3), r"trajectory 3: there are 3, counted from 0"),
    (
        lambda: split(ragged(), -0.5, key=KEY),
        r"split fraction: expected between 0 and 1, got -0.5",
    ),
    (
        lambda: split(ragged(1), 0.5, key=KEY),
        r"split: expected two or more trajectories, got 1",
    ),
    (lambda: concatenate([]), r"concatenate: expected one or more"),
    (
        lambda: concatenate([one(), one(channels=("x", "z"))]),
        r"concatenate: channels differ, \('x', 'y'\) and \('x', 'z'\)",
    ),
    (lambda: concatenate([one(), one(units={"x": "m"})]), r"concatenate: units differ"),
    (
        lambda: concatenate([one(), one(commands={"f": [0.0] * 3})]),
        r"concatenate: units differ",
    ),
]


@defects("arrays, message", BAD_ARRAYS)
def test_bad_arrays_are_named(arrays, message):
    with told(message):
        one(**arrays)


@defects("make, message", BAD_CALLS)
def test_bad_calls_are_named(make, message):
    with told(message):
        make()


def test_channels_that_nobody_observed_can_be_added():
    data = Trajectories.from_arrays(
        [[0.0, 1.0, 2.0], [0.0, 1.0]],
        [np.ones((3, 1)), np.ones((2, 1))],
        channels=("x",),
        units={"x": "um", "t": "s"},
        commands={"f": [[1.0, 2.0, 3.0], [4.0, 5.0]]},
    )
    wide = with_missing_channels(data, {"vx": "um/s"})
    assert wide.channels == ("x", "vx")
    assert wide.units == {**data.units, "vx": "um/s"}
    np.testing.assert_array_equal(wide.states[..., :1], data.states)
    np.testing.assert_array_equal(wide.observed[..., 0], data.observed[..., 0])
    assert not wide.observed[..., 1].any()
    np.testing.assert_array_equal(wide.commands["f"], data.commands["f"])
    with told("channel 'x': stands twice"):
        with_missing_channels(data, {"x": "um"})
