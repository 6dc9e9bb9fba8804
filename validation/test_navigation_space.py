"""Navigation in three dimensions: the box of obstacles with its true force.

No learned model is judged here yet: only what the truth gives, and physics alone.
"""

import time

import jax
import jax.numpy as jnp

from pinav.actuation import LinearResponse
from pinav.navigation import (
    CommandLimits,
    ReachGoal,
    Rectangle,
    RollingActuator,
    SteeredSwimmer,
    Task,
    controller,
    physics_only,
    regret,
    run_many,
    summary,
    tabulate_model,
    time_to_go,
)
from pinav.scenarios import scenario

RUNS = 20


def box_task():
    """From one corner of the scenario `box` to the other, with a thrust of 1."""
    truth = scenario("box").true_swimmer
    return Task(
        name="box",
        truth=SteeredSwimmer(truth, RollingActuator(jnp.eye(3), LinearResponse())),
        start=jnp.array([1.0, 1.0, 1.0]),
        objective=ReachGoal([9.0, 9.0, 9.0], 0.3),
        limits=CommandLimits(1.0),
        arena=Rectangle([-1.0] * 3, [11.0] * 3),
        keep_out=(),
        step=0.1,
        time_limit=40.0,
        noise=0.1,
    )


def test_the_true_force_leads_through_the_box():
    task, keys = box_task(), jax.random.split(jax.random.key(0), RUNS)
    models = {"truth": task.truth, "physics only": physics_only(task.truth)}
    episodes = {}
    for name, model in models.items():
        episodes[name] = run_many(task, controller(task, model), keys)
        outcome = summary(episodes[name], task)
        print(name, outcome.success, outcome.arrival, outcome.clearance)
    print("regret", regret(episodes["physics only"], episodes["truth"]))
    assert episodes["truth"].reached.all()


def test_a_plan_in_space_takes_seconds():
    """Processor time, with everything compiled before."""
    task = box_task()
    time_to_go(task, task.truth, tables=tabulate_model(task, task.truth))
    began = time.process_time()
    plan = time_to_go(task, task.truth, tables=tabulate_model(task, task.truth))
    taken = time.process_time() - began
    print("plan", float(plan.at(task.start)), "processor time", taken)
    assert taken < 20.0  # ten seconds on two cores
