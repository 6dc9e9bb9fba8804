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
from pinav.thermal import design
from pinav.thermal.grids import RadialGrid
from pinav.thermal.optimise import optimise
from pinav.thermal.protocols import HfLimit, Piecewise
from pinav.thermal.sources import LinearResponse, ParticleSource
from pinav.thermal.steppers import Rosenbrock

pytestmark = pytest.mark.slow

DECAY, GAIN, END, POWER = 1e-3, 1 / 3.78e6, 1800.0, 5e4
COUNT = 9
EDGES = tuple(np.linspace(0.0, END, COUNT + 1))
STEPPER = Rosenbrock(20.0)


def lumped():
    """Tissue with θ' = −λθ + b u, u = `POWER` (H/H0)²."""
    perfusion = DECAY * 3.78e6 / 3617.0
    return reference_model(RadialGrid.slab(0.01, 3), POWER, CLOSED, perfusion)


def half_power(model):
    protocol = Piecewise.constant(EDGES, np.full(COUNT, 5e3), 1e5)
    return design.Run(model, protocol)


def improve(base, *variables, maximise, subject_to, **options):
    return optimise(
        base,
        variables,
        maximise=maximise,
        subject_to=subject_to,
        **{"stepper": STEPPER} | options,
    )


def powers_of(found):
    """The power in each interval, where that at the largest amplitude is `POWER`."""
    return POWER * (np.asarray(found.run.protocol.starts) / 1e4) ** 2


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
    found = improve(
        half_power(lumped()),
        design.free_amplitudes(1e4, COUNT, 0.7),
        maximise=Energy(),
        subject_to=[design.Constraint("arrival", Coldness(), -43.0, "°C", 0.1)],
        tolerance=1e-9,
    )
    middles = (np.array(EDGES[1:]) + np.array(EDGES[:-1])) / 2
    true = [least_energy_control(t, DECAY, GAIN, (0.0, 6.0), END) for t in middles]
    assert powers_of(found) == pytest.approx(true, rel=1e-2)
    least = least_energy(DECAY, GAIN, (0.0, 6.0), END)
    assert -found.value * POWER**2 == pytest.approx(least, rel=5e-3)
    assert found.constraints[0].active


def test_most_dose_saturates_and_then_rides_the_limit():
    switch, hold = saturate_and_ride(DECAY, GAIN, 8.0, POWER)
    found = improve(
        half_power(lumped()),
        design.free_amplitudes(1e4, COUNT, 0.5),
        maximise=design.log_d90(jnp.ones(3)),
        subject_to=[design.max_temperature(45.0)],
        tolerance=1e-8,
    )
    powers, whole = powers_of(found), int(switch // (END / COUNT))
    assert powers[:whole] == pytest.approx(np.full(whole, POWER), rel=1e-3)
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
    kept = {}
    for product in (5e8, 5e9):
        found = improve(
            half_power(model),
            design.free_amplitudes(1e4, COUNT, 0.3),
            maximise=design.log_d90(target),
            subject_to=[
                design.max_temperature(46.0),
                design.limit_constraint(HfLimit(product, "own limit")),
                design.healthy_dose(50.0, 1 - target),
            ],
        )
        kept[product] = {own.name: own.active for own in found.constraints}
    assert kept[5e8]["own limit"]
    assert not kept[5e8]["maximum temperature"]
    assert kept[5e9]["maximum temperature"] or kept[5e9]["healthy tissue dose"]
    assert not kept[5e9]["own limit"]


def test_placement_of_the_particles_gains_dose_at_equal_power():
    model, target = tumour(1.5e5)
    total = float(jnp.sum(1.5e5 * target * model.grid.volumes))
    amplitude = design.free_amplitudes(2e4, COUNT, 0.4)
    placement = design.free_placement(design.shells(model, 0.008, 3, total))
    alone, placed = (
        improve(
            half_power(model),
            *variables,
            maximise=design.log_d90(target),
            subject_to=[design.max_temperature(46.0)],
        )
        for variables in ((amplitude,), (amplitude, placement))
    )
    assert placed.value > alone.value + 0.1
    field = placed.run.model.sources[0].power
    assert float(jnp.sum(field * model.grid.volumes)) == pytest.approx(total)


def test_a_pattern_of_bursts_can_be_scaled():
    model, target = tumour()
    particles = ParticleSource(3.0 * target, LinearResponse(14e-9))
    found = improve(
        design.Run(
            eqx.tree_at(lambda m: m.sources, model, (particles,)),
            Piecewise.on_off(5e3, 1e5, on=100.0, off=100.0, duration=600.0),
        ),
        design.free_scale(2.0, 0.5),
        maximise=design.log_d90(target),
        subject_to=[design.limit_constraint(HfLimit(1e9))],
    )
    assert found.constraints[0].active
    pattern = np.asarray(found.run.protocol.starts)
    assert pattern[1::2] == pytest.approx(0.0)


def test_what_cannot_be_kept_or_freed_is_said():
    model, target = tumour()
    base, dose = half_power(model), design.log_d90(target)
    amplitudes = design.free_amplitudes(1e3, COUNT)
    cold = design.Constraint("an impossible warmth", Coldness(), -60.0, "°C")
    with pytest.raises(FitError, match="run was found that satisfies: an impossible"):
        improve(base, amplitudes, maximise=dose, subject_to=[cold], max_iterations=5)
    with pytest.raises(InputError, match="variables: expected one or more, got none"):
        improve(base, maximise=dose, subject_to=[])
    with pytest.raises(InputError, match="optimise initial: expected 9 numbers"):
        improve(base, amplitudes, maximise=dose, subject_to=[], initial=np.ones(2))
    with pytest.raises(InputError, match="free_amplitudes: expected a largest"):
        design.free_amplitudes(0.0, 3)
    bare = design.Run(
        eqx.tree_at(lambda m: m.sources, model, (Energy(),)), base.protocol
    )
    with pytest.raises(InputError, match="expected particles or a power density"):
        design.free_placement(jnp.ones((2, 24))).apply(jnp.ones(2), bare)
