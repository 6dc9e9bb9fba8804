"""Departures from stated physics: their equations, and wrong worlds that are named."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.actuation import HeldProgramme
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.fitting import fit_bayes
from pinav.fitting.checks.departures import departures, weigh_departures
from pinav.fitting.environments.force_prior import regress, with_weights
from pinav.fitting.environments.rates import ForceSamples
from pinav.forces import (
    GaussianBarrier,
    KernelPotential,
    LinearDrag,
    RollingPropulsion,
    ZeroForce,
    forces_at,
    kernel_centers,
)
from pinav.systems import Observation, RingStarts, System
from pinav.trajectories import simulate, with_velocities

TIMES = jnp.linspace(0.0, 6.0, 61)
RNG = np.random.default_rng(11)
PROGRAMME = HeldProgramme(
    jnp.arange(0.0, 8.0, 2.0), jnp.ones(4), jnp.asarray(RNG.uniform(-3.0, 3.0, 4))
)


def swimmer(thrust=1.0, damping=0.36, turn=0.0, delay=0.0, mirror=1.0, *, inertia=True):
    cos, sin = np.cos(turn), np.sin(turn)
    gain = thrust * np.diag([1.0, mirror]) @ np.array([[cos, -sin], [sin, cos]])
    propulsion = RollingPropulsion(jnp.asarray(gain), programme=PROGRAMME, delay=delay)
    if inertia:
        return Swimmer(propulsion, LinearDrag(damping), ZeroForce())
    return OverdampedSwimmer(propulsion, ZeroForce(), 1.0)


def system(true, count):
    rule = RingStarts((5.0, 5.0), 5.0, 2.0, (1.5, 3.5), count=count)
    return System(
        name="hill",
        swimmer=true,
        dim=2,
        environment=GaussianBarrier(5.0, [5.0, 5.0], 2.5),
        observation=Observation(noise=0.02),
        rule=rule,
        times=TIMES,
    ).with_starts(count=count)


def weigh(stated, true, count=4):
    """Departures from stated physics about the true states and force, best first."""
    world = system(true, count)
    data = simulate(world, key=jax.random.key(1)).only(("x", "y"))
    clean = dataclasses.replace(world, observation=Observation(noise=0.0))
    states = simulate(clean, key=jax.random.key(1)).states
    centers = kernel_centers(data.positions.reshape(-1, 2), spacing=1.2, margin=1.2)
    kernels = KernelPotential.with_zero_weights(centers, 1.8)
    places = np.asarray(centers)
    forces = np.asarray(forces_at(world.environment, np.zeros(len(places)), places))
    samples = ForceSamples(places, places, forces)
    learned = with_weights(kernels, regress(kernels, samples)[0])
    model = stated.with_environment(learned)
    if isinstance(true, Swimmer):
        data = with_velocities(data)
    return sorted(weigh_departures(model, states, data), key=lambda one: -one.gain)


def test_in_other_units_of_time_the_forces_are_those_of_the_true_ones():
    model = swimmer()
    rates = [
        one
        for one in departures(model, 2, np.array([[0.0, 6.0]]), 1.0)
        if one.name == "unit of time"
    ]
    t, v = 3.0, jnp.array([0.7, -0.2])
    x = jnp.zeros(2)
    for one in rates:
        rate = float(one.clause(np.zeros(0)).split()[2])
        # In true time t/k the velocity is k v, and an acceleration counts 1/k².
        true = model.propulsion(t / rate, x, v) + model.drag(t / rate, x, rate * v)
        stated = model.propulsion(t, x, v) + model.drag(t, x, v)
        changed = stated + one.forces(t, x, v)[0]
        np.testing.assert_allclose(changed, true / rate**2, atol=1e-12)


def test_a_swimmer_without_inertia_has_no_drag_to_depart_from():
    model = swimmer(inertia=False)
    names = {one.name for one in departures(model, 2, np.array([[0.0, 6.0]]), 1.0)}
    assert "thrust" in names
    assert not names & {"drag", "drag by speed"}
    still = OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0)
    names = {one.name for one in departures(still, 2, np.array([[0.0, 6.0]]), 1.0)}
    assert names == {"push", "course"}


@pytest.mark.parametrize("inertia", [True, False])
def test_right_physics_are_not_contradicted(inertia):
    assert weigh(swimmer(inertia=inertia), swimmer(inertia=inertia))[0].gain < 5.0


def test_a_thrust_that_is_stated_twice_too_large_is_named_with_its_factor():
    first = weigh(swimmer(thrust=2.0), swimmer())[0]
    assert first.name in ("thrust", "heading")  # which holds the former
    assert first.gain > 50.0
    factor = float(first.clause.split("is ")[1].split(" ")[0])
    assert factor == pytest.approx(0.5, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stated", "true", "name"),
    [
        ({"damping": 0.72}, {}, "drag"),
        ({}, {"turn": 0.5}, "heading"),
        ({}, {"delay": 0.4}, "delay"),
        ({}, {"mirror": -1.0}, "axes"),
        ({"thrust": 0.0}, {}, "push"),
        ({"thrust": 2.0, "inertia": False}, {"inertia": False}, "thrust"),
        ({"inertia": False}, {"inertia": False, "turn": 0.5}, "heading"),
        ({"inertia": False}, {"inertia": False, "mirror": -1.0}, "axes"),
    ],
)
def test_wrong_worlds_are_named(stated, true, name):
    first = weigh(swimmer(**stated), swimmer(**true))[0]
    assert first.gain > 10.0
    assert first.name == name or {first.name, name} == {"thrust", "heading"}


@pytest.mark.slow
def test_about_a_fit_under_wrong_physics_the_number_is_named_too():
    data = simulate(system(swimmer(), 4), key=jax.random.key(1)).only(("x", "y"))
    centers = kernel_centers(data.positions.reshape(-1, 2), spacing=1.2, margin=1.2)
    kernels = KernelPotential.with_zero_weights(centers, 1.8)
    model = swimmer(thrust=2.0).with_environment(kernels)
    fit = fit_bayes(model, data, max_iterations=12, throw=False)
    told = weigh_departures(fit.model, np.asarray(fit.states), with_velocities(data))
    first = max(told, key=lambda one: one.gain)
    assert first.name in ("thrust", "heading")
    assert first.gain > 50.0
