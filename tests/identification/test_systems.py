"""Commands of a system's programme, and which systems identification fits."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.identification.conftest import as_recording

from pinav import actuation, forces, systems
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.evaluation import predict
from pinav.identification import (
    candidates,
    needs_kalman_filter,
    record_commands,
    selection,
)
from pinav.identification.commanded_fit import fit_commanded
from pinav.identification.drive import drive_of
from pinav.identification.estimates import estimates
from pinav.identification.parameters import (
    DISTURBANCE,
    NOISE_PLACES,
    Prior,
    coordinates_of,
    stated_noise,
)
from pinav.identification.tracks import Blocks, one_track
from pinav.trajectories import simulate

GALLERY = Path(__file__).parents[2] / "examples" / "systems"


@pytest.fixture(scope="module")
def roller():
    return systems.read_system(GALLERY / "roller.toml")


@pytest.fixture(scope="module")
def driven(roller):
    return simulate(roller, key=jax.random.key(0))


def test_positions_alone_get_the_commands_of_the_programme(roller, driven):
    recorded = record_commands(roller, dataclasses.replace(driven, commands={}))
    steps = np.array(roller.swimmer.propulsion.programme.frequency)
    place = np.searchsorted([2.0, 4.0, 6.0], np.asarray(roller.times), side="right")
    np.testing.assert_array_equal(recorded.commands["frequency"][0], steps[place])
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
    helical = systems.read_system(GALLERY / "helical.toml")
    assert needs_kalman_filter(roller)  # it wanders
    assert not needs_kalman_filter(helical)
    unbound = dataclasses.replace(helical.swimmer.propulsion, programme=None)
    swimmer = dataclasses.replace(helical.swimmer, propulsion=unbound)
    assert needs_kalman_filter(dataclasses.replace(helical, swimmer=swimmer))


class Sprint(forces.AbstractCommandedForce):
    """A propulsion that identification has never heard of: a speed that levels off."""

    speed: float
    delay: float
    programme: actuation.AbstractProgramme | None = None

    @property
    def actuator(self):
        raise NotImplementedError

    @property
    def lateness(self):
        return float(self.delay)

    def __call__(self, t, x, v):
        raise NotImplementedError

    def drive_by(self, times, commands):
        angle = commands["heading"]
        direction = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
        thrust = self.speed * jnp.tanh(commands["frequency"])[:, None] * direction
        return forces.ScheduledThrust(times, thrust, thrust, self.delay, 0.0)


def sprinter(*learn, speed=4.0, delay=0.2):
    swimmer = OverdampedSwimmer(
        Sprint(speed, delay), forces.ZeroForce(), 0.5, forces.UniformFlow([0.3, -0.2])
    )
    return systems.System(
        "sprinter", swimmer, 2, learn=learn, observation=systems.Observation(0.02)
    )


def observed(system, duration=40.0):
    """Positions of a system under turning commands, seen with an error."""
    times, random = np.arange(0, duration, 0.1), np.random.default_rng(5)
    commands = {
        "frequency": np.where(times % 8 < 5, 1.0, 0.4),
        "heading": np.cumsum(random.normal(0, 0.2, len(times))),
    }
    still = as_recording((times, np.zeros((len(times), 2)), commands))
    states, _ = predict(system.swimmer, still)
    seen = np.asarray(states) + 0.02 * random.normal(size=still.states.shape)
    return dataclasses.replace(still, states=seen)


def test_any_propulsion_drives_a_path_as_it_drives_a_swimmer():
    system = sprinter(systems.FreeNumber("propulsion.delay", systems.Normal(0.2, 0.1)))
    data = observed(system)
    with jax.enable_x64(new_val=True):
        blocks = jax.tree.map(jnp.asarray, Blocks.of(one_track(data, "sprinter")))
        path, late = (
            drive_of(system.swimmer, system.learn).displacements(
                jnp.array([delay]), blocks
            )
            for delay in (0.23, 0.24)
        )
    swimmer = dataclasses.replace(sprinter(delay=0.23).swimmer, flow=forces.ZeroFlow())
    (states,), _ = predict(swimmer, data)
    moved = np.asarray(states) - states[0]
    np.testing.assert_allclose(path[: len(moved)], moved, atol=1e-4)
    assert np.abs(late - path).max() < 0.05  # no step of the way jumps with the delay


def test_recorded_commands_drive_a_propulsion_that_has_a_programme(driven):
    system, track = sprinter(), one_track(driven, "sprinter")
    programme = actuation.HeldProgramme(*(jnp.ones(1),) * 3)
    propulsion = dataclasses.replace(system.swimmer.propulsion, programme=programme)
    swimmer = dataclasses.replace(system.swimmer, propulsion=propulsion)
    with jax.enable_x64(new_val=True):
        blocks = jax.tree.map(jnp.asarray, Blocks.of(track))
        stated, recorded = (
            drive_of(one).displacements(jnp.zeros(0), blocks)
            for one in (swimmer, system.swimmer)
        )
    np.testing.assert_array_equal(stated, recorded)


@pytest.mark.parametrize(
    ("prior", "low"),
    [(systems.Normal(0.2, 0.3), 0.0), (systems.LogNormal(1, 0.3), -1.5)],
)
def test_a_delay_is_positive_in_its_own_coordinate(prior, low, driven):
    learn = systems.FreeNumber("propulsion.delay", prior)
    drive = drive_of(sprinter().swimmer, [learn])
    bounds = Prior.of(one_track(driven, "sprinter"), drive.parameters).bounds()
    np.testing.assert_allclose(bounds[0, 0], low)


@pytest.mark.slow
def test_any_propulsion_is_fitted_by_its_own_drive():
    learn = (
        systems.FreeNumber("propulsion.speed", systems.LogNormal(3.0, 1.0)),
        systems.FreeNumber("propulsion.delay", systems.Normal(0.2, 0.2)),
        systems.FreeNumber("flow.velocity"),
    )
    data = observed(sprinter(speed=4.0, delay=0.25))
    fit = fit_commanded(sprinter(*learn, speed=3.0), data, None)
    speed, delay = (fit.constants[f"propulsion.{name}"] for name in ("speed", "delay"))
    for found, truth in ((speed, 4.0), (delay, 0.25)):
        assert abs(found.value - truth) < 4 * found.sd
        assert found.sd < 0.1 * truth
    np.testing.assert_allclose(fit.model.flow.velocity, [0.3, -0.2], atol=0.1)
    np.testing.assert_allclose(fit.posterior.model.propulsion.speed, speed.value)


@pytest.mark.slow
def test_another_propulsion_is_a_candidate_by_its_entry(monkeypatch):
    learn = (
        systems.FreeNumber("propulsion.speed", systems.LogNormal(3.0, 1.0)),
        systems.FreeNumber("propulsion.delay", systems.LogNormal(0.2, 1.0)),
        systems.FreeNumber("flow.velocity"),
    )
    several = (*candidates.CANDIDATES, lambda: sprinter(*learn))
    monkeypatch.setattr(selection, "CANDIDATES", several)
    track = one_track(observed(sprinter(delay=0.25)), "sprinter")
    chosen = selection.select_model(track)
    assert chosen.chosen == "sprinter"
    assert chosen.row("sprinter").velocity_r2 > 0.9
    numbers = estimates(chosen.best)
    for name, truth in {"propulsion.speed": 4.0, "delay": 0.25}.items():
        assert abs(numbers[name].value - truth) < 4 * numbers[name].sd
    (piece,) = chosen.held_out.pieces
    bands = chosen.predictor.forecast(piece)
    assert bands.slopes.shape == (len(piece.times), 2, 4)
    elapsed, drift = piece.times - piece.times[0], chosen.best.model.flow.velocity
    moved = bands.slopes[:, :, 0] * numbers["propulsion.speed"].value
    np.testing.assert_allclose(moved + np.outer(elapsed, drift), bands.path, atol=1e-2)


@pytest.mark.parametrize("path", ["propulsion.speed", "propulsion.delay"])
def test_a_number_of_another_propulsion_needs_a_prior(path):
    with pytest.raises(InputError, match="expected a prior Normal or LogNormal"):
        drive_of(sprinter().swimmer, [systems.FreeNumber(path)])


def test_a_wandering_velocity_stands_beside_a_propulsion_without_commands(roller):
    propulsion = forces.ConstantForce([0.7, -0.1])
    swimmer = dataclasses.replace(roller.swimmer, propulsion=propulsion)
    drive = drive_of(swimmer)
    times = jnp.arange(0.0, 5.0, 0.5)
    blocks = Blocks(times, jnp.zeros((10, 2)), *(jnp.zeros(10),) * 6)
    path = drive.displacements(jnp.zeros(0), blocks)
    velocity = swimmer.mobility(jnp.zeros(2), propulsion.force)
    np.testing.assert_allclose(path, jnp.outer(times, velocity), atol=1e-6)


@pytest.mark.parametrize("slow", [0.0, 0.3])
def test_a_drift_that_changes_is_none_where_a_system_states_none(roller, slow):
    """A slow velocity of 0 was taken for one that nothing is known of."""
    wandering = systems.WanderingVelocity(still=0.0, driven=0.2, memory=1.0, slow=slow)
    noise = stated_noise(dataclasses.replace(roller, wandering=wandering))
    stated = coordinates_of(DISTURBANCE, roller.swimmer, noise)
    assert np.isnan(stated[NOISE_PLACES["wandering.still"]])  # it is learned
    found = np.exp(stated[NOISE_PLACES["wandering.slow"]])
    assert found == pytest.approx(max(slow, 1e-9))
