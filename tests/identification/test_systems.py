"""Commands of a system's programme, and which systems identification fits."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

from pinav.errors import InputError
from pinav.identification import needs_kalman_filter, record_commands
from pinav.identification.commanded_fit import fit_commanded
from pinav.scenarios import scenario
from pinav.systems import read_system
from pinav.trajectories import simulate

GALLERY = Path(__file__).parents[2] / "examples" / "systems"


@pytest.fixture(scope="module")
def roller():
    return read_system(GALLERY / "roller.toml")


@pytest.fixture(scope="module")
def driven(roller):
    return simulate(roller, key=jax.random.key(0))


def test_positions_alone_get_the_commands_of_the_programme(roller, driven):
    bare = dataclasses.replace(driven, commands={})
    recorded = record_commands(roller, bare)
    times = np.asarray(roller.times)
    steps = np.array(roller.swimmer.propulsion.programme.frequency)
    np.testing.assert_array_equal(
        recorded.commands["frequency"][0],
        steps[np.searchsorted([2.0, 4.0, 6.0], times, side="right")],
    )
    assert recorded.commands.keys() == driven.commands.keys()
    for name, values in driven.commands.items():
        np.testing.assert_array_equal(recorded.commands[name], values)
        assert recorded.units[name] == driven.units[name]


def test_recorded_commands_must_be_those_of_the_programme(roller, driven):
    commands = {**driven.commands, "heading": driven.commands["heading"] + 0.1}
    other = dataclasses.replace(driven, commands=commands)
    with pytest.raises(InputError, match="another heading than the programme"):
        record_commands(roller, other)


def test_a_known_programme_alone_needs_no_filter(roller):
    helical = read_system(GALLERY / "helical.toml")
    assert needs_kalman_filter(roller)  # it wanders
    assert not needs_kalman_filter(helical)
    unbound = dataclasses.replace(helical.swimmer.propulsion, programme=None)
    swimmer = dataclasses.replace(helical.swimmer, propulsion=unbound)
    assert needs_kalman_filter(dataclasses.replace(helical, swimmer=swimmer))


def test_a_wandering_velocity_is_fitted_beside_commands_or_nothing(roller, driven):
    propulsion = scenario("paper").swimmer.propulsion
    swimmer = dataclasses.replace(roller.swimmer, propulsion=propulsion)
    system = dataclasses.replace(roller, swimmer=swimmer, learn=())
    with pytest.raises(InputError, match="or no propulsion beside a wandering"):
        fit_commanded(system, driven, None)
