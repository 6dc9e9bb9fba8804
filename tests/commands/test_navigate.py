"""`pinav navigate`: its settings, its words, and a run from end to end."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from pinav import actuation, forces, navigation
from pinav.commands import NAVIGATE
from pinav.commands.navigate import NavigateSettings
from pinav.commands.navigate.job import navigation_problem
from pinav.commands.results import keep, sections_of
from pinav.commands.settings import numbers
from pinav.commands.steering import system_task
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.figures.images import save_pictures
from pinav.fitting.environments.summary import ModelChoice
from pinav.learning.learned import Learned
from pinav.runs import RunFolder
from pinav.systems import System
from pinav.trajectories import Trajectories


def settings(**changes):
    return NavigateSettings(start="0.5,1", goal="9.5,9.5", **changes)


def test_places_are_numbers_with_commas():
    assert settings().places() == ((0.5, 1.0), (9.5, 9.5))
    assert numbers("--keep-out", "-1, 2.5,0.3", 3) == (-1.0, 2.5, 0.3)
    assert numbers("--to", "1,2,3", 2, 3) == (1.0, 2.0, 3.0)
    for bad in ("1", "1,2,3,4", "1,x", "nan,1", ""):
        with pytest.raises(InputError, match="--from: expected 2 or 3 numbers with co"):
            NavigateSettings(start=bad, goal="1,2").check()


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
def test_a_run_from_a_fit_to_report(tmp_path, fitted_run, printed, refused):
    ends = ("--from", "0.5,1", "--to", "9.5,9.5")
    words = ("navigate", fitted_run("kernel")[0], *ends, "--out", tmp_path / "out")
    metrics = json.loads(printed(*words, "--seeds", "3", "--json"))
    assert metrics["controllers"]["learned"]["success"]["value"] == 1.0
    assert metrics["regret"]["learned"]["value"] < 1.3
    assert 0 <= metrics["plan"]["unreachable"] < 1
    found = metrics["suggestion"]
    assert found["sd_after"] <= found["sd_after_random"] <= found["sd"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "data:image/gif;base64," in page
    assert (tmp_path / "out" / "suggestion.csv").exists()
    refused(words, "already holds a run")
    blocked = (*words, "--overwrite", "--keep-out", "0.5,1,0.4")
    refused(blocked, "start: expected a free place")


def run_of(folder, swimmer, dim=2):
    """The run of a swimmer, as far as navigation needs it."""
    channels = ("x", "y", "z")[:dim]
    path = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 1.0], [2.0, 1.0, 0.0]])
    data = Trajectories.from_arrays(
        [np.arange(3.0)],
        [path[:, :dim]],
        channels=channels,
        units=dict.fromkeys((*channels, "t"), "1"),
    )
    made = RunFolder.create(folder / "run", {"run": {"command": "fit"}}, overwrite=True)
    system = System("robot", swimmer, dim)
    return Learned(made, system, data, {"model": swimmer}, ModelChoice(), None)


def rolling_run(folder, **propulsion):
    """The run of a robot that rolls, in a drift along x."""
    rolling = forces.RollingPropulsion(**propulsion)
    drift = forces.UniformFlow(jnp.array([0.3, 0.0]))
    return run_of(folder, OverdampedSwimmer(rolling, forces.ZeroForce(), 1.0, drift))


def space_run(folder, mobility=1.0):
    """The run of a swimmer in three dimensions, carried by a known flow."""
    none, flow = forces.ZeroForce(), forces.UniformFlow([0.2, 0.0, 0.1])
    return run_of(folder, OverdampedSwimmer(none, none, mobility, flow), 3)


def test_a_recording_gives_a_rolling_robot_in_its_drift(tmp_path):
    run = rolling_run(
        tmp_path,
        gain=jnp.array([[2.0, -0.5], [0.5, 2.0]]),
        response=actuation.SaturatingResponse(4.0),
        delay=0.15,
        lag=0.05,
    )
    problem = navigation_problem(
        settings(arena="-5,-5,15,15", keep_out=("4,4,1",)), run
    )
    command = jnp.array([3.0, np.pi / 2])
    rate = problem.model(0.0, jnp.zeros(2), command)
    effective = 3.0 / np.sqrt(1 + (3.0 / 4.0) ** 2)
    np.testing.assert_allclose(rate, [0.3 - 0.5 * effective, 2.0 * effective])
    assert problem.task.limits.max_frequency == 10.0
    assert problem.task.delay == pytest.approx(0.2)
    assert float(problem.task.keep_out[0].distance(jnp.array([4.0, 6.0]))) == 1.0


class SquareResponse(actuation.AbstractResponse):
    def __call__(self, frequency):
        return frequency**2


class SquarePropulsion(forces.AbstractCommandedForce):
    """A propulsion of which no command knows: its speed grows with the square of f."""

    programme: actuation.AbstractProgramme | None = None

    @property
    def actuator(self):
        return actuation.RollingActuator(jnp.eye(2), SquareResponse())

    @property
    def lateness(self):
        return 0.3

    def __call__(self, t, x, v):
        return jnp.zeros(2)

    def drive_by(self, times, commands):
        return self


def test_a_propulsion_brings_its_own_actuator(tmp_path):
    robot = OverdampedSwimmer(SquarePropulsion(), forces.ZeroForce(), 1.0)
    task = system_task(
        settings(), System("square", robot, 2, environment=forces.ZeroForce())
    )
    rate = task.truth(0.0, jnp.zeros(2), jnp.array([3.0, 0.0]))
    np.testing.assert_allclose(rate, [9.0, 0.0])
    assert task.delay == 0.3


def test_an_arena_holds_both_ends_and_not_the_wall(tmp_path):
    run = rolling_run(tmp_path, gain=jnp.eye(2))
    arena = navigation_problem(settings(), run).task.arena
    for place in ([0.5, 1.0], [9.5, 9.5]):
        assert float(arena.distance(jnp.array(place))) < -1.0
    mobility = forces.WallMobility(0.5, 1.0, forces.Plane([0.0, 0.0, 1.0], -1.0))
    run = space_run(tmp_path, mobility)
    wall = navigation_problem(NavigateSettings(**IN_SPACE), run).task.keep_out[-1]
    np.testing.assert_allclose(wall.distance(jnp.array([3.0, 2.0, 1.0])), 1.5)


IN_SPACE = {"start": "0,0,0", "goal": "2,1,1", "time_limit": 8.0}


def test_a_run_in_space_gives_a_task_in_space(tmp_path):
    chosen = NavigateSettings(**IN_SPACE, thrust=1.5, keep_out=("1,1,-1,0.5",))
    problem = navigation_problem(chosen, space_run(tmp_path))
    assert problem.task.dim == 3
    assert not problem.task.inertial
    np.testing.assert_allclose(problem.thrust, 1.5)
    np.testing.assert_allclose(problem.task.keep_out[0].center, [1.0, 1.0, -1.0])
    upward = problem.model(0.0, jnp.zeros(3), jnp.array([1.0, 0.3, np.pi / 2]))
    np.testing.assert_allclose(upward, [0.2, 0.0, 1.6], atol=1e-9)
    for place in ([0.0, 0.0, 0.0], [2.0, 1.0, 1.0]):
        assert float(problem.task.arena.distance(jnp.array(place))) < 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": "0,0"}, "--from: expected 3 numbers with commas"),
        ({"goal": "1,1"}, "--to: expected 3 numbers"),
        ({"arena": "0,0,1,1"}, "--arena: expected 6 numbers"),
        ({"keep_out": ("0,0,1",)}, "--keep-out: expected 4 numbers"),
    ],
)
def test_places_of_another_dimension_are_refused(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        navigation_problem(NavigateSettings(**(IN_SPACE | change)), space_run(tmp_path))


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
def test_a_fit_in_space_is_navigated_from_plan_to_report(tmp_path):
    folder = RunFolder.create(
        tmp_path / "there", {"run": {"command": "navigate"}}, overwrite=True
    )
    way = navigation.Way((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), time_limit=8.0, noise=0.02)
    result = navigation.navigate(space_run(tmp_path), way, seeds=2)
    assert result.controllers["learned"].success.value == 1.0
    keep(NAVIGATE, folder, result)
    drawn = [save_pictures(s, folder.path) for s in sections_of(NAVIGATE, folder)]
    assert [section.heading for section in drawn] == ["Outcome", "Closed loop"]
    assert (folder.path / "figures" / "navigate-closed-loop.png").exists()


def test_a_way_has_the_dimension_of_the_fit(tmp_path):
    with pytest.raises(InputError, match="Way: expected places of 3 coordinates, got"):
        navigation.navigate(space_run(tmp_path), navigation.Way((0.0, 0.0), (1.0, 1.0)))
    with pytest.raises(InputError, match="Way: expected start and goal with as many"):
        navigation.navigate(
            space_run(tmp_path), navigation.Way((0.0, 0.0, 0.0), (1.0, 1.0))
        )
