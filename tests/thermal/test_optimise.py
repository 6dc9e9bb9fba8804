"""Protocols under limits: controls with known answers, and constraints that bind."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from validation.heat.checks import reference_model
from validation.heat.exact.controls import (
    least_energy,
    least_energy_control,
    saturate_and_ride,
)
from validation.heat.verification import CLOSED

from pinav.errors import FitError, InputError
from pinav.fitting import Outcome
from pinav.thermal.design import (
    Constraint,
    Run,
    free_amplitudes,
    free_placement,
    free_scale,
    healthy_dose,
    limit_constraint,
    log_d90,
    max_temperature,
    shells,
)
from pinav.thermal.grids import RadialGrid
from pinav.thermal.optimise import optimise
from pinav.thermal.protocols import HfLimit, Piecewise
from pinav.thermal.rosenbrock import Rosenbrock
from pinav.thermal.sources import LinearResponse, ParticleSource

pytestmark = pytest.mark.slow

DECAY, GAIN, END = 1e-3, 1 / 3.78e6, 1800.0
COUNT = 9
EDGES = tuple(np.linspace(0.0, END, COUNT + 1))
STEPPER = Rosenbrock(20.0)


def lumped(power):
    """Tissue with θ' = −λθ + b u, u = power (H/H0)²."""
    perfusion = DECAY * 3.78e6 / 3617.0
    return reference_model(RadialGrid.slab(0.01, 3), power, CLOSED, perfusion)


def half_power(model):
    protocol = Piecewise.constant(EDGES, np.full(COUNT, 5e3), 1e5)
    return Run(model, protocol)


class Energy(eqx.Module):
    """Minus the integral of the squared power."""

    def __call__(self, run, solution):
        amplitudes = run.protocol.starts
        return -jnp.sum((amplitudes / 1e4) ** 4) * END / COUNT


class Coldness(eqx.Module):
    """Minus the final temperature."""

    def __call__(self, run, solution):
        return -solution.final.temperature[0]


def test_least_energy_is_that_of_the_exact_control():
    power = 5e4
    arrive = Constraint("arrival", Coldness(), -43.0, "°C", 0.1)
    found = optimise(
        half_power(lumped(power)),
        [free_amplitudes(1e4, COUNT, 0.7)],
        maximise=Energy(),
        subject_to=[arrive],
        stepper=STEPPER,
        tolerance=1e-9,
    )
    powers = power * (np.asarray(found.run.protocol.starts) / 1e4) ** 2
    middles = (np.array(EDGES[1:]) + np.array(EDGES[:-1])) / 2
    true = [least_energy_control(t, DECAY, GAIN, (0.0, 6.0), END) for t in middles]
    assert powers == pytest.approx(true, rel=1e-2)
    least = least_energy(DECAY, GAIN, (0.0, 6.0), END)
    assert -found.value * power**2 == pytest.approx(least, rel=5e-3)
    assert found.constraints[0].active


def test_most_dose_saturates_and_then_rides_the_limit():
    power = 5e4
    switch, hold = saturate_and_ride(DECAY, GAIN, 8.0, power)
    found = optimise(
        half_power(lumped(power)),
        [free_amplitudes(1e4, COUNT, 0.5)],
        maximise=log_d90(jnp.ones(3)),
        subject_to=[max_temperature(45.0)],
        stepper=STEPPER,
        tolerance=1e-8,
    )
    powers = power * (np.asarray(found.run.protocol.starts) / 1e4) ** 2
    whole = int(switch // (END / COUNT))
    assert powers[:whole] == pytest.approx(np.full(whole, power), rel=1e-3)
    assert powers[whole + 1 :] == pytest.approx(hold, rel=2e-2)
    (kept,) = found.constraints
    assert kept.name == "maximum temperature"
    assert kept.active
    assert kept.value <= 45.0 + 1e-3
    assert np.sum((found.numbers < 1e-6) | (found.numbers > 1 - 1e-6)) >= whole
    assert found.outcome is Outcome.CONVERGED
    assert found.value > found.start_value


def tumour(power=4e5):
    grid = RadialGrid.sphere(0.04, 24)
    target = grid.ball(0.008)
    return reference_model(grid, power * target, perfusion=0.5), target


def test_what_binds_is_named():
    """A tight field limit binds in place of the temperature, and the other way."""
    model, target = tumour()
    base = half_power(model)
    kept = {}
    for product in (5e8, 5e9):
        found = optimise(
            base,
            [free_amplitudes(1e4, COUNT, 0.3)],
            maximise=log_d90(target),
            subject_to=[
                max_temperature(46.0),
                limit_constraint(HfLimit(product, "own limit")),
                healthy_dose(50.0, 1 - target),
            ],
            stepper=STEPPER,
        )
        kept[product] = {own.name: own.active for own in found.constraints}
    assert kept[5e8]["own limit"]
    assert not kept[5e8]["maximum temperature"]
    assert kept[5e9]["maximum temperature"] or kept[5e9]["healthy tissue dose"]
    assert not kept[5e9]["own limit"]


def test_placement_of_the_particles_gains_dose_at_equal_power():
    model, target = tumour(1.5e5)
    total = float(jnp.sum(1.5e5 * target * model.grid.volumes))
    patterns = shells(model, 0.008, 3, total)
    base = half_power(model)
    options = {
        "maximise": log_d90(target),
        "subject_to": [max_temperature(46.0)],
        "stepper": STEPPER,
    }
    amplitude = free_amplitudes(2e4, COUNT, 0.4)
    alone = optimise(base, [amplitude], **options)
    placed = optimise(base, [amplitude, free_placement(patterns)], **options)
    assert placed.value > alone.value + 0.1
    field = placed.run.model.sources[0].power
    assert float(jnp.sum(field * model.grid.volumes)) == pytest.approx(total)


def test_a_pattern_of_bursts_can_be_scaled():
    model, target = tumour()
    particles = ParticleSource(3.0 * target, LinearResponse(14e-9))
    base = Run(
        eqx.tree_at(lambda m: m.sources, model, (particles,)),
        Piecewise.on_off(5e3, 1e5, on=100.0, off=100.0, duration=600.0),
    )
    found = optimise(
        base,
        [free_scale(2.0, 0.5)],
        maximise=log_d90(target),
        subject_to=[limit_constraint(HfLimit(1e9))],
        stepper=STEPPER,
    )
    assert found.constraints[0].active
    pattern = np.asarray(found.run.protocol.starts)
    assert pattern[1::2] == pytest.approx(0.0)


def test_what_cannot_be_kept_or_freed_is_said():
    model, target = tumour()
    base = half_power(model)
    cold = Constraint("an impossible warmth", Coldness(), -60.0, "°C")
    with pytest.raises(FitError, match="run was found that satisfies: an impossible"):
        optimise(
            base,
            [free_amplitudes(1e3, COUNT)],
            maximise=log_d90(target),
            subject_to=[cold],
            stepper=STEPPER,
            max_iterations=5,
        )
    with pytest.raises(InputError, match="variables: expected one or more, got none"):
        optimise(base, [], maximise=log_d90(target), subject_to=[])
    with pytest.raises(InputError, match="optimise initial: expected 9 numbers"):
        optimise(
            base,
            [free_amplitudes(1e3, COUNT)],
            maximise=log_d90(target),
            subject_to=[],
            stepper=STEPPER,
            initial=np.ones(2),
        )
    with pytest.raises(InputError, match="free_amplitudes: expected a largest"):
        free_amplitudes(0.0, 3)
    bare = Run(eqx.tree_at(lambda m: m.sources, model, (Energy(),)), base.protocol)
    with pytest.raises(InputError, match="expected particles or a power density"):
        free_placement(jnp.ones((2, 24))).apply(jnp.ones(2), bare)
