"""Flights that learn on the way, for `test_adaptive`: worlds, pairs, and processes.

`python -m validation.adaptive_flights gate 3001 3101 2 > rows.jsonl` flies fifty worlds
and writes a line for each; rows of several machines can be put together.
"""

import dataclasses
import functools
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.actuation import LinearResponse
from pinav.arguments import Scalar, Vector
from pinav.commands.design.job import DESIGNS
from pinav.commands.navigate.job import online_task
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.forces import AbstractForce, LinearDrag, PlaneWaves, ZeroForce
from pinav.navigation import (
    CommandLimits,
    Disc,
    ReachGoal,
    Rectangle,
    RollingActuator,
    SteeredSwimmer,
    Task,
)
from pinav.navigation.adaptive.flight import Flight, fly, score_force
from pinav.navigation.adaptive.prior import with_truth
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.strategies import MEAN_FORCE, with_known
from pinav.navigation.belief.belief import Frame
from pinav.navigation.design.campaign import run_campaign
from pinav.navigation.design.candidates import Experiment
from pinav.navigation.trials.situation import (
    Situation,
    advance_compiled,
    begin,
    observe_compiled,
)
from pinav.numerics import ONE_CORE

Result = TypeVar("Result")

WAVES = 60
"""Plane waves of a random field."""

NOISE = 0.02
"""Standard deviation of the observed positions [L]."""


class Row(msgspec.Struct, frozen=True):
    """What happened in one flight.

    Attributes:
        world: name of the task.
        number: seed of its noise; of a gate, also of the world.
        delay: from command to thrust [T].
        arrival: time of the first visit [T], infinite where it did not arrive.
        oracle: the same of one who knows the force; 0 where none flew.
        second: the same with the map of the first visit; 0 where none flew.
        clearance: least distance from forbidden places [L].
        violated: whether one was entered.
        changed: commands that the filter changed.
        stalls: frames at which no progress was noticed.
        error: of the force over the visited path, relative.
        cover: fraction of true forces in their bands of 95 %.
        consistency: mean squared error of the position over its variance.
        frame: 99 % quantile of the computing time of a frame [s].
        command: median of a command [s].
        replan: median of a plan [s].
    """

    world: str
    number: int
    delay: float
    arrival: float
    oracle: float
    second: float
    clearance: float
    violated: bool
    changed: int
    stalls: int
    error: float
    cover: float
    consistency: float
    frame: float
    command: float
    replan: float


class Swirl(AbstractForce):
    """A current whose stream function is a potential: the force, turned by 90 degrees.

    Attributes:
        waves: the potential.
    """

    waves: PlaneWaves

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Float[Array, "2"]:
        force = self.waves(t, x, v)
        return jnp.array([-force[1], force[0]])


def random_waves(draw: np.random.Generator, sd: float, length: float) -> PlaneWaves:
    """A Gaussian random field.

    Args:
        draw: of its waves.
        sd: standard deviation of each component of the force.
        length: length scale of the potential [L].
    """
    vectors = draw.standard_normal((WAVES, 2)) / length
    size = sd * length * np.sqrt(2 / WAVES)
    phases = draw.uniform(0, 2 * np.pi, WAVES)
    return PlaneWaves(np.full(WAVES, size), vectors, phases)


def gate_task(number: int) -> Task:
    """A random field, a gate of two discs across the way, and one disc beside it.

    Of even number: inertia, and a potential. Of odd number: none, and a current. Each
    component of the force has a standard deviation of 0.1 to 0.4 of the greatest
    thrust; the gate is 0.8 to 1.6 wide, between discs of radius 1 to 1.8.
    """
    draw = np.random.default_rng([1802, number])
    thrust = float(draw.uniform(0.6, 1.2))
    waves = random_waves(draw, thrust * draw.uniform(0.1, 0.4), draw.uniform(1.5, 4.0))
    if number % 2:
        truth = OverdampedSwimmer(ZeroForce(), Swirl(waves), 1.0)
        noise, rest = 0.02, []
    else:
        drag = LinearDrag(float(draw.uniform(0.3, 0.8)))
        truth, noise, rest = Swimmer(ZeroForce(), drag, waves), 0.1, [0.0, 0.0]
    gap, across = draw.uniform(0.8, 1.6), draw.uniform(5.0, 7.0)
    along, radius = draw.uniform(5.5, 7.0), draw.uniform(1.0, 1.8)
    middles = [across - radius - gap / 2, across + radius + gap / 2]
    gate = [Disc([along, middle], radius) for middle in middles]
    away = draw.choice([-1, 1]) * draw.uniform(5.0, 6.0)
    aside = [draw.uniform(4.5, 6.5), across + away]
    actuator = RollingActuator(thrust * jnp.eye(2), LinearResponse())
    task = Task(
        name="gate",
        truth=SteeredSwimmer(truth, actuator),
        start=jnp.array([1.5, draw.uniform(4, 8), *rest]),
        objective=ReachGoal([10.5, draw.uniform(4, 8)], 0.3),
        limits=CommandLimits(1.0),
        arena=Rectangle([-1.0, -1.0], [13.0, 13.0]),
        keep_out=(*gate, Disc(aside, 1.2)),
        step=0.1,
        time_limit=40.0,
        noise=noise,
        sensor_noise=NOISE,
    )
    # Numbers of Python are part of a compiled program, arrays are its arguments.
    arrays = jax.tree.map(jnp.asarray, task)
    return dataclasses.replace(
        arrays, limits=task.limits, noise=task.noise, sensor_noise=NOISE
    )


def fly_row(world: str, number: int, *, delay: float, oracle: bool, visits: int) -> Row:
    """One swimmer: with the truth known, without, and again with the map.

    Args:
        world: `gate`, or a task of the package.
        number: seed of the noise; of a gate, also of the world.
        delay: from command to thrust [T].
        oracle: whether the oracle flies, too.
        visits: 2 for a second one.
    """
    if world == "gate":
        task = gate_task(number)
    else:
        task = online_task(world, position_noise=NOISE, delay=delay)
    adaptive, key = AdaptiveController.of(task), jax.random.key(number)
    first, belief, _ = fly(adaptive, key=key)
    known = fly(with_truth(adaptive), key=key).flight if oracle else None
    informed = dataclasses.replace(adaptive, known=belief)
    again = fly(informed, key=key).flight if visits > 1 else None
    return Row(
        world,
        number,
        delay,
        first.arrival_time,
        known.arrival_time if known else 0.0,
        again.arrival_time if again else 0.0,
        min(flight.clearance for flight in (first, again) if flight),
        any(flight.violated for flight in (first, again) if flight),
        first.changed,
        first.stalls,
        first.force_error,
        first.cover,
        first.consistency,
        quantile(first, "learn_times", 0.99),
        quantile(first, "command_times", 0.5),
        quantile(first, "replan_times", 0.5),
    )


class Lesson(msgspec.Struct, frozen=True):
    """What was learned while a swimmer was driven about.

    Attributes:
        world: name of the task.
        number: seed of its noise.
        error: of the force over the visited path, relative.
        cover: fraction of true forces in their bands of 95 %.
        consistency: mean squared error of the position over its variance.
        frame: 99 % quantile of the computing time of a frame [s].
    """

    world: str
    number: int
    error: float
    cover: float
    consistency: float
    frame: float


def wander(world: str, number: int) -> Lesson:
    """Sixteen time units at full thrust, to the goal by a heading that wanders.

    The heading departs from that of the goal by a random walk of 0.47 rad in a unit of
    time; there is no plan, and no filter of commands.
    """
    task = online_task(world, position_noise=NOISE, delay=0.0)
    task = dataclasses.replace(task, time_limit=16.0)
    adaptive, key = AdaptiveController.of(task), jax.random.key(number)
    draw = np.random.default_rng([1801, number])
    now, turned = begin(task), 0.0
    path, scores, times = [], [], []
    sensing = [jax.random.fold_in(key, 2 * k) for k in range(200)]
    belief = adaptive.believe(frame_of(task, now, np.zeros(2), sensing[0]))
    assert isinstance(task.objective, ReachGoal)
    while not bool(now.ended(task)):
        step = int(now.step)
        turned += 0.15 * draw.standard_normal()
        way = np.asarray(task.objective.goal) - belief.state.mean[:2]
        heading = float(np.arctan2(way[1], way[0]) + turned)
        command = jnp.array([task.limits.max_frequency, heading])
        pushes = jax.random.fold_in(key, 2 * step + 1)
        now, allowed = advance_compiled(task, task.truth, now, command, pushes)
        thrust = np.asarray(task.truth.actuator(allowed), float)
        frame = frame_of(task, now, thrust, sensing[int(now.step)])
        began = time.perf_counter()
        belief = belief.after(with_known(frame, belief, adaptive.physics))
        times.append(time.perf_counter() - began)
        state = belief.state
        error = np.asarray(now.state[:2], float) - state.mean[:2]
        scores.append(error @ np.linalg.solve(state.covariance[:2, :2], error) / 2)
        path.append(np.asarray(now.state[:2], float))
    return Lesson(
        world,
        number,
        *score_force(np.stack(path), belief, task),
        float(np.mean(scores)),
        float(np.quantile(times[2:], 0.99)),
    )


def frame_of(
    task: Task, now: Situation, thrust: Float[np.ndarray, "2"], key: PRNGKeyArray
) -> Frame:
    """The position that a camera tells, with its error."""
    position = np.asarray(observe_compiled(task, now, key).state[:2], float)
    return Frame(task.step * int(now.step), position, task.position_sd, thrust)


class Ending(msgspec.Struct, frozen=True):
    """How a campaign of designed trajectories ended.

    Attributes:
        world: name of the task.
        number: seed of its noise.
        design: how trajectories were chosen.
        trajectories: until the end.
        finished: whether the belief says that the force along the way is known.
        bound: of its relative error, by the belief.
        error: the true one.
    """

    world: str
    number: int
    design: str
    trajectories: int
    finished: bool
    bound: float
    error: float


def end_campaign(world: str, design: str, number: int) -> Ending:
    """A campaign of trajectories of five time units, released anywhere.

    Args:
        world: name of the task.
        design: a key of `DESIGNS`.
        number: seed of the noise.
    """
    task = online_task(world, position_noise=NOISE, delay=0.0)
    adaptive = AdaptiveController.of(task, MEAN_FORCE)
    experiment = Experiment(task, task.arena, 5.0)
    campaign = run_campaign(
        adaptive,
        DESIGNS[design],
        experiment,
        accuracy=0.1,
        most=24,
        key=jax.random.key(number),
    )
    last = campaign.decisions[-1]
    assert last.true_error is not None
    return Ending(
        world,
        number,
        design,
        len(campaign.paths),
        campaign.finished,
        last.error,
        last.true_error,
    )


def quantile(flight: Flight, times: str, level: float) -> float:
    """Of computing times, without the first ones, in which programs are compiled."""
    return float(np.quantile(getattr(flight, times)[2:], level))


def fly_rows(
    world: str,
    numbers: range,
    *,
    delay: float = 0.0,
    oracle: bool = True,
    visits: int = 1,
) -> Iterator[Row]:
    """Flights of `fly_row`, in as many processes as there are cores.

    `PINAV_PROCESSES` sets another number.
    """
    one = functools.partial(fly_row, world, delay=delay, oracle=oracle, visits=visits)
    return _in_processes(one, numbers)


def wander_rows(world: str, numbers: range) -> Iterator[Lesson]:
    """Drives of `wander`, in processes like those of `fly_rows`."""
    return _in_processes(functools.partial(wander, world), numbers)


def endings(world: str, design: str, numbers: range) -> Iterator[Ending]:
    """Campaigns of `end_campaign`, in processes like those of `fly_rows`."""
    return _in_processes(functools.partial(end_campaign, world, design), numbers)


def _in_processes(one: Callable[[int], Result], numbers: range) -> Iterator[Result]:
    processes = int(os.environ.get("PINAV_PROCESSES", os.cpu_count() or 1))
    os.environ.update(ONE_CORE)  # which the processes inherit
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, spawn, _begin) as pool:
        yield from pool.map(one, numbers)


def _begin() -> None:
    jax.config.update("jax_enable_x64", val=True)


def main() -> None:
    """Fly the numbers `first, stop, step` of a world, and write a line for each."""
    world, first, stop, step, *rest = sys.argv[1:]
    delay, visits = float(rest[0]) if rest else 0.0, int(rest[1]) if rest[1:] else 1
    numbers = range(int(first), int(stop), int(step))
    rows = fly_rows(world, numbers, delay=delay, oracle=world != "gate", visits=visits)
    for row in rows:
        print(json.dumps(msgspec.to_builtins(row)), flush=True)


if __name__ == "__main__":
    main()
