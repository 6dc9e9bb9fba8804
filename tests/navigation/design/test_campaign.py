"""Campaigns: what is chosen, recorded, learned, and when it is enough."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation.steering_worlds import frame_at, vortex

from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.forces import GaussianBarrier, LinearDrag, ZeroForce
from pinav.navigation import CommandLimits, Disc, Experiment, Rectangle
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.strategies import MEAN_FORCE
from pinav.navigation.belief.belief import Frame
from pinav.navigation.design.campaign import (
    decide,
    learn,
    record,
    run_campaign,
)
from pinav.navigation.design.candidates import (
    CandidateTrajectories,
    GridDesign,
    InformedDesign,
    RandomDesign,
    Stage,
    expected_sd,
    imagine,
    suggest_next,
)

NOISE, KEY = 0.02, jax.random.key(1)


def experiment_of(problem, duration=3.0, region=None):
    return Experiment(problem, problem.arena if region is None else region, duration)


@pytest.fixture(scope="module")
def adaptive():
    return AdaptiveController.of(vortex(), MEAN_FORCE, points=21)


@pytest.fixture(scope="module")
def belief(adaptive):
    return adaptive.believe(frame_at(*np.asarray(adaptive.task.start)))


def straight(experiment, start, heading):
    """A single programme of full frequency with one heading."""
    knots = np.ones(len(experiment.knots))
    frequency = experiment.task.limits.max_frequency * knots
    return CandidateTrajectories(
        jnp.asarray(start, float), jnp.asarray(frequency), jnp.asarray(heading * knots)
    )


def rms(belief, way):
    """Root mean square of the deviation of the force along a way."""
    return np.sqrt(np.mean(belief.force(way)[1] ** 2))


WAY = np.linspace([2.0, 2.0], [4.0, 2.0], 20)


def test_nothing_recorded_is_nothing_known(adaptive, belief):
    decision = decide(adaptive, belief)
    assert decision.true_error == pytest.approx(1.0)
    assert 0.9 < decision.error < 1.2
    assert not decision.certain(0.5)
    ends = decision.way[[0, -1]]
    np.testing.assert_allclose(ends[0], adaptive.task.start, atol=0.3)
    steps = np.linalg.norm(np.diff(decision.way, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.05)


def test_a_record_is_the_true_path_with_the_error_of_the_sensor():
    problem = vortex(noise=0.0)
    chosen = straight(experiment_of(problem), [3.0, 5.0], 0.4)
    frames, path = record(experiment_of(problem), chosen, key=KEY)
    assert [f.time for f in frames] == pytest.approx(
        problem.step * np.arange(len(path))
    )
    errors = np.stack([f.position for f in frames]) - path
    assert np.std(errors) == pytest.approx(NOISE, rel=0.3)
    # The rate of the path is the thrust and the current at its middle.
    command = jnp.array([chosen.frequency[0], 0.4])
    middles = jnp.asarray((path[1:] + path[:-1]) / 2)
    known = jax.vmap(lambda x: problem.truth(0.0, x, command))(middles)
    np.testing.assert_allclose(np.diff(path, axis=0) / problem.step, known, atol=5e-3)
    np.testing.assert_allclose(frames[1].thrust, problem.truth.actuator(command))


def test_a_record_ends_at_the_edge_of_the_arena():
    problem = vortex(noise=0.0)
    experiment, edge = experiment_of(problem, duration=8.0), problem.arena.upper
    chosen = straight(experiment, [float(edge[0]) - 0.3, 5.0], 0.0)
    frames, path = record(experiment, chosen, key=KEY)
    assert len(frames) == len(path) < 0.5 * experiment.duration / problem.step
    assert np.all(path <= np.asarray(edge))


def test_what_was_recorded_lowers_the_error_there(adaptive, belief):
    experiment = experiment_of(adaptive.task)
    way, later = decide(adaptive, belief).way, belief
    heading = float(np.arctan2(*(way[-1] - way[0])[::-1]))
    for k in range(3):
        chosen = straight(experiment, way[k * len(way) // 3], heading)
        frames, _ = record(experiment, chosen, key=jax.random.key(k))
        later = learn(adaptive, later, frames)
    assert rms(later, way) < 0.5 * rms(belief, way)


def test_a_candidate_along_the_way_tells_more_than_one_elsewhere(adaptive, belief):
    experiment, now = experiment_of(adaptive.task), rms(belief, WAY)
    stage = Stage(adaptive, experiment, belief, WAY)
    edge = float(adaptive.task.arena.upper[0]) - 0.05
    on, far, leaves = (
        expected_sd(stage, straight(experiment, start, 0.0))
        for start in ([2.0, 2.0], [2.0, 8.0], [edge, 5.0])
    )
    assert on < 0.6 * now
    assert far == pytest.approx(now, rel=0.05)
    assert leaves == np.inf


@pytest.mark.parametrize("environment", ["current", "barrier"])
def test_what_is_expected_is_what_frames_along_the_expected_path_teach(environment):
    """The filter that leads and sees what it expected is as sure as was expected."""
    changes = {"noise": 0.05, "sensor_noise": 0.03}
    swimmer = None
    if environment == "barrier":
        swimmer = Swimmer(
            ZeroForce(), LinearDrag(0.5), GaussianBarrier(1.0, [5.0, 5.0], 1.0)
        )
    adaptive = AdaptiveController.of(
        vortex(swimmer, **changes), MEAN_FORCE, points=13, speeds=5
    )
    belief = adaptive.believe(frame_at(2.0, 2.0))
    way = np.linspace([2.0, 2.0], [4.0, 2.5], 9)
    experiment = experiment_of(adaptive.task)
    candidate = experiment.draw(1, key=jax.random.key(3))[0]
    stage = Stage(adaptive, experiment, belief, way)
    later, path = imagine(stage, candidate)
    step, sd = 2 * adaptive.task.step, adaptive.task.position_sd / np.sqrt(2)
    commands = experiment.commands(candidate, step * (np.arange(len(path) - 1) + 0.5))
    alone = dataclasses.replace(belief, filters=(belief.best,), longest=step)
    frames = [Frame(0.0, path[0], sd, np.zeros(2))]
    for k, command in enumerate(commands):
        thrust = np.asarray(adaptive.task.truth.actuator(command))
        frames.append(Frame(step * (k + 1), path[k + 1], sd, thrust))
    taught = learn(adaptive, alone, frames, sd)
    np.testing.assert_allclose(taught.force(way), later.force(way), atol=1e-9)
    known = rms(taught, way)
    assert expected_sd(stage, candidate) == pytest.approx(known, rel=1e-9)


def test_less_noise_tells_more(adaptive, belief):
    sds = []
    for noise in (0.002, 0.02, 0.2, 20.0):
        problem = dataclasses.replace(adaptive.task, sensor_noise=noise)
        doubtful = dataclasses.replace(adaptive, task=problem)
        experiment = experiment_of(problem)
        stage = Stage(doubtful, experiment, belief, WAY)
        sds.append(expected_sd(stage, straight(experiment, [2.0, 2.0], 0.0)))
    assert np.all(np.diff(sds) > 0)
    assert sds[-1] == pytest.approx(rms(belief.best, WAY), rel=0.01)


def test_random_programmes_obey_limits_and_region():
    limits = CommandLimits(1.0, max_turning_rate=1.2)
    problem = vortex(Swimmer(ZeroForce(), LinearDrag(0.5), ZeroForce()), limits=limits)
    experiment = experiment_of(problem, 8.0, Rectangle([0.0, 0.0], [1.0, 1.0]))
    drawn = experiment.draw(50, key=jax.random.key(10))
    varied = experiment.vary(drawn[0], 50, key=jax.random.key(11))
    for made in (drawn, varied):
        assert np.all((made.frequency >= 0) & (made.frequency <= 1.0))
        assert np.all(np.abs(np.diff(made.heading)) <= 1.2 + 1e-12)
        assert np.all(made.starts[:, 2:] == 0)
        assert np.all((made.starts[:, :2] >= 0) & (made.starts[:, :2] <= 1))
    assert np.abs(np.diff(drawn.heading)).max() == pytest.approx(1.2)
    np.testing.assert_array_equal(varied.starts, np.tile(drawn.starts[:1], (50, 1)))
    with pytest.raises(InputError, match="Experiment.duration: expected > 0"):
        experiment_of(problem, duration=0.0)


def test_a_grid_fills_the_region_evenly(adaptive, belief):
    experiment = experiment_of(adaptive.task, region=Rectangle([1.0, 2.0], [5.0, 4.0]))
    chosen = [
        GridDesign().choose(Stage(adaptive, experiment, belief, WAY, count), key=KEY)
        for count in range(36)
    ]
    share = (np.stack([one.starts for one in chosen]) - [1.0, 2.0]) / [4.0, 2.0]
    assert np.all((share >= 0) & (share <= 1))
    cells = np.floor(share * [2, 3]).astype(int)
    counts = np.unique(cells, axis=0, return_counts=True)[1]
    assert len(counts) == 6
    assert counts.max() - counts.min() <= 2
    headings = np.array([float(one.heading[0]) for one in chosen])
    quarters = np.bincount((headings // (np.pi / 2)).astype(int))
    assert quarters.min() >= 7


def test_nobody_is_released_in_a_disc():
    disc = Disc([5.0, 5.0], 2.0)
    adaptive = AdaptiveController.of(vortex(keep_out=(disc,)), MEAN_FORCE, points=21)
    belief = adaptive.believe(frame_at(1.0, 5.0))

    def stage(half, count=0):
        region = Rectangle([5.0 - half] * 2, [5.0 + half] * 2)
        experiment = experiment_of(adaptive.task, region=region)
        return Stage(adaptive, experiment, belief, WAY, count)

    for design in (GridDesign(), RandomDesign()):
        for count in range(4):
            chosen = design.choose(stage(2.5, count), key=jax.random.key(count))
            assert np.linalg.norm(np.asarray(chosen.starts) - 5.0) > 2.0
    with pytest.raises(InputError, match="release: expected a place outside"):
        RandomDesign().choose(stage(1.0), key=KEY)


def test_a_suggestion_tells_more_than_random_programmes_or_there_is_none(
    adaptive, belief
):
    region = Rectangle([0.5, 4.5], [1.5, 5.5])
    experiment = experiment_of(adaptive.task, 0.8, region)
    way = np.linspace([1.0, 5.0], [3.0, 5.0], 9)
    found = suggest_next(Stage(adaptive, experiment, belief, way), key=KEY)
    assert found.sd_after < found.sd_after_random < found.sd
    assert found.sd == pytest.approx(rms(belief, way))
    np.testing.assert_array_equal(found.path[0], found.start)
    assert found.times[-1] == 0.8
    assert len(found.times) == len(found.frequency) == len(found.heading)
    assert np.all(found.frequency <= adaptive.task.limits.max_frequency)
    cell = Rectangle([0.9, 4.9], [1.1, 5.1])
    caged = dataclasses.replace(
        adaptive, task=dataclasses.replace(adaptive.task, arena=cell)
    )
    stage = Stage(caged, experiment_of(caged.task, 0.8), belief, way)
    assert suggest_next(stage, key=KEY) is None


@pytest.mark.slow
def test_a_campaign_ends_when_the_way_is_known(adaptive):
    design = InformedDesign(candidates=6, variations=2, rounds=1)
    campaign = run_campaign(
        adaptive,
        design,
        experiment_of(adaptive.task, duration=5.0),
        accuracy=0.6,
        most=8,
        key=jax.random.key(3),
    )
    assert campaign.finished
    assert campaign.right
    assert len(campaign.decisions) == len(campaign.paths) + 1
    assert not any(d.certain(0.6) for d in campaign.decisions[:-1])


def test_bad_requests_are_refused(adaptive):
    asked = (adaptive, RandomDesign(), experiment_of(adaptive.task))
    with pytest.raises(InputError, match="accuracy: expected between 0 and 1, got 1.0"):
        run_campaign(*asked, key=KEY, accuracy=1.0, most=3)
    with pytest.raises(InputError, match="most: expected 1 or more, got 0"):
        run_campaign(*asked, key=KEY, accuracy=0.1, most=0)
