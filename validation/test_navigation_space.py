"""Navigation in space with models learned from 16 noisy recordings of positions.

The truth and physics alone stand beside each model. Scenarios, fits and tasks were made
on even keys of the starts; the key that judges here is odd.
"""

import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.actuation import LinearResponse
from pinav.evaluation import force_error_at_samples
from pinav.fitting import fit_bayes, kernel_environment
from pinav.forces import KernelPotential, PlaneWaves, WallMobility
from pinav.navigation import (
    Behind,
    CommandLimits,
    Episodes,
    ReachGoal,
    Rectangle,
    RollingActuator,
    SteeredSwimmer,
    Task,
    controller,
    physics_only,
    regret,
    run,
    run_many,
    summary,
    tabulate_model,
    time_to_go,
)
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import simulate

RUNS, KEY = 20, 1
"""Runs of each controller, and the key of the recordings."""


class Journey(NamedTuple):
    """A way through a scenario, with a thrust of 1.

    Attributes:
        scenario: its name.
        start: where it begins [L].
        goal: where it ends [L].
        arena: two corners [L].
        tolerance: distance from the goal that counts as there [L].
        step: of the commands [T].
        noise: of the true swimmer [L T^-1/2].
    """

    scenario: str
    start: tuple[float, ...]
    goal: tuple[float, ...]
    arena: tuple[list[float], list[float]]
    tolerance: float
    step: float
    noise: float

    def task(self, system: System) -> Task:
        """The task; what the mobility knows of a wall must not be touched."""
        truth = system.true_swimmer
        wall = getattr(truth, "mobility", None)
        touched = ()
        if isinstance(wall, WallMobility):
            touched = (Behind(wall.wall, wall.radius),)
        return Task(
            name=self.scenario,
            truth=SteeredSwimmer(truth, RollingActuator(jnp.eye(3), LinearResponse())),
            start=jnp.array(self.start),
            objective=ReachGoal(list(self.goal), self.tolerance),
            limits=CommandLimits(1.0),
            arena=Rectangle(*self.arena),
            keep_out=touched,
            step=self.step,
            time_limit=40.0,
            noise=self.noise,
        )


JOURNEYS = {
    "box": Journey(
        "box", (1.0,) * 3, (9.0,) * 3, ([-1.0] * 3, [11.0] * 3), 0.3, 0.1, 0.1
    ),
    "above-wall": Journey(
        "above-wall",
        (10.0, 10.0, 10.0),
        (90.0, 90.0, 10.0),
        ([-5.0, -5.0, 5.0], [105.0, 105.0, 45.0]),
        3.0,
        0.2,
        0.3,
    ),
    "tube": Journey(
        "tube",
        (110.0, 0.0, 0.0),
        (10.0, 0.0, 0.0),
        ([0.0, -40.0, -40.0], [120.0, 40.0, 40.0]),
        3.0,
        0.2,
        0.3,
    ),
    "bifurcation": Journey(
        "bifurcation",
        (8.0, 0.0, 0.0),
        (103.0, 25.0, 0.0),
        ([0.0, -60.0, -40.0], [120.0, 60.0, 40.0]),
        3.0,
        0.2,
        0.3,
    ),
}
"""Ways whose models are judged."""

WORST_REGRET = 1.08
"""Of a learned model against the truth."""


@pytest.mark.parametrize("name", JOURNEYS)
def test_a_learned_model_leads_through_space(name):
    starts, noise = jax.random.split(jax.random.key(KEY))
    system = scenario(name, starts)
    data = simulate(system, key=noise)
    kernels = kernel_environment(KernelPotential, data, dim=3)
    began = time.perf_counter()
    fit = fit_bayes(system.swimmer.with_environment(kernels), data)
    seconds = time.perf_counter() - began
    field = system.true_swimmer.environment
    error = force_error_at_samples(fit.model.environment, field, data)
    print(f"{name}: force error at the samples {error:.2%}, {seconds:.0f} s")

    task = JOURNEYS[name].task(system)
    truth, keys = task.truth, jax.random.split(jax.random.key(KEY), RUNS)
    draws = fit.posterior.samples(8, key=jax.random.key(KEY))
    models = {
        "truth": (truth, ()),
        "learned": (
            SteeredSwimmer(fit.model, truth.actuator),
            [SteeredSwimmer(draw, truth.actuator) for draw in draws],
        ),
        "physics only": (physics_only(truth), ()),
    }
    episodes: dict[str, Episodes] = {}
    for which, (model, samples) in models.items():
        steering = controller(task, model, samples=samples)
        episodes[which] = run_many(task, steering, keys)
        outcome = summary(episodes[which], task)
        print(which, outcome, regret(episodes[which], episodes["truth"]))
    steering = controller(task, models["learned"][0])
    compute = run(task, steering, key=keys[0]).compute[1:]
    print(f"control step: median {1e3 * np.median(compute):.1f} ms")
    assert error < 0.10
    assert seconds < 90.0
    assert episodes["learned"].reached.mean() >= 0.98
    late = regret(episodes["learned"], episodes["truth"])
    assert late.value < WORST_REGRET


@pytest.mark.parametrize("key", [1, 3])
def test_random_fields_in_space(key):
    """A potential of length scale 2.2, as smooth as can be, from 64 recordings."""
    rng = np.random.default_rng(key)
    field = PlaneWaves(
        np.full(WAVES, np.sqrt(2 / WAVES)),
        rng.normal(size=(WAVES, 3)) / 2.2,
        rng.uniform(0.0, 2 * np.pi, WAVES),
    )
    starts, noise = jax.random.split(jax.random.key(key))
    system = scenario("box", starts, count=64).with_truth(field)
    data = simulate(system, key=noise)
    kernels = kernel_environment(KernelPotential, data, dim=3)
    began = time.perf_counter()
    fit = fit_bayes(system.swimmer.with_environment(kernels), data, throw=False)
    seconds = time.perf_counter() - began
    error = force_error_at_samples(fit.model.environment, field, data)
    print(f"field {key}: {fit.outcome}, error {error:.2%}, {seconds:.0f} s")
    assert error < 0.10
    assert seconds < 90.0


WAVES = 100
"""Of a random field."""


def test_a_plan_in_space_takes_seconds():
    """Processor time, with everything compiled before."""
    task = JOURNEYS["box"].task(scenario("box"))
    time_to_go(task, task.truth, tables=tabulate_model(task, task.truth))
    began = time.process_time()
    plan = time_to_go(task, task.truth, tables=tabulate_model(task, task.truth))
    taken = time.process_time() - began
    print("plan", float(plan.at(task.start)), "processor time", taken)
    assert taken < 20.0  # ten seconds on two cores
