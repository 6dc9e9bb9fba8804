"""Laws of a run: heat is kept, gradients agree, runs go on, bad input is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals
from validation.heat import exact
from validation.heat.checks import powers as switched
from validation.heat.checks import reference_model as medium
from validation.heat.exact import SET_S
from validation.heat.verification import sensitivity_ratios

from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import Dirichlet, Robin, Sides, around, outer
from pinav.thermal.dose import value_exceeded_by
from pinav.thermal.grids import CartesianGrid, RadialGrid
from pinav.thermal.perfusion import RegionalPerfusion, lang
from pinav.thermal.protocols import Piecewise, plan_steps
from pinav.thermal.solve import default_stepper, probes_at, run, solve
from pinav.thermal.sources import EddySource, PowerSource
from pinav.thermal.starts import AT_REST, HeatState
from pinav.thermal.steppers import RKL2, Rosenbrock
from pinav.thermal.tissues import Blood, Tissue, mix


def heated_tumour(grid, side):
    """A tumour in muscle, with perfusion that follows the temperature."""
    share = grid.ball(0.008)
    shares, muscle = (share, 1 - share), Tissue(0.49, 1090.0, 3421.0, 700.0)
    return Bioheat(
        grid,
        mix(shares, (Tissue(0.55, 1045.0, 3600.0), muscle)),
        Blood(),
        RegionalPerfusion(shares, (lang("tumour"), lang("muscle"))),
        (PowerSource(2.2e5 * share, 1e4), EddySource(0.4, 0.1)),
        outer(side) if len(grid.shape) == 1 else around(grid, side),
    )


GRIDS = {
    "sphere": lambda: RadialGrid.sphere(0.03, 60),
    "cylinder": lambda: RadialGrid.cylinder(0.03, 60),
    "plane": lambda: CartesianGrid.cubes((20, 20), 2e-3),
    "space": lambda: CartesianGrid.cubes((10, 10, 10), 3e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize("make", GRIDS.values(), ids=GRIDS)
@pytest.mark.parametrize("side", [Dirichlet(37.0), Robin(15.0, 25.0)])
def test_heat_in_is_heat_out_or_stored(make, side):
    model = heated_tumour(make(), side)
    protocol = Piecewise.ramp((0, 300, 900), [0.0, 1.1e4, 0.9e4], 1e5)
    energy = solve(model, protocol).energy
    assert float(energy.imbalance) < 1e-10
    assert float(energy.brought) > 0
    assert float(energy.perfused) > 0


@pytest.mark.slow
def test_reverse_mode_is_forward_mode_is_central_differences():
    """Log dose, probe and T90 by solver, perfusion, dose and protocol."""
    model = heated_tumour(RadialGrid.sphere(0.03, 30), Dirichlet(37.0))
    edges = (0.0, 130.0, 300.0)
    schedule = plan_steps(Piecewise.constant(edges, [1.0, 1.0], 1e5), 10.0)
    options = {"stepper": Rosenbrock(), "observe": probes_at(model, [0.004])}
    target = model.grid.ball(0.008) * model.grid.volumes

    def scaled(model):
        power = model.sources[0].power
        return model.tissue.conductivity, model.perfusion.laws[1].gain, power

    @jax.jit
    def outcome(numbers):
        values = zip(scaled(model), numbers[:3], strict=True)
        own = eqx.tree_at(scaled, model, tuple(value * by for value, by in values))
        protocol = Piecewise.constant(edges, 1.5e4 * numbers[3:], 1e5)
        found = run(own, protocol, schedule, **options)
        return jnp.stack(
            [
                found.observed[-1, 0],
                jnp.log(jnp.sum(found.final.dose * target)),
                value_exceeded_by(found.final.temperature, target, 0.9),
                jnp.log(value_exceeded_by(found.final.dose, target, 0.9)),
                jnp.max(found.hottest),
            ]
        )

    at, step = jnp.array([1.0, 1.0, 1.0, 1.0, 0.8]), 1e-5
    forward = np.asarray(jax.jit(jax.jacfwd(outcome))(at))
    reverse = np.asarray(jax.jit(jax.jacrev(outcome))(at))
    scale = np.abs(forward).max(axis=1, keepdims=True)
    assert np.all(np.abs(forward - reverse) <= 1e-10 * scale)
    shifts = step * jnp.eye(len(at))
    columns = [(outcome(at + s) - outcome(at - s)) / (2 * step) for s in shifts]
    assert np.all(np.abs(forward - np.stack(columns, axis=1)) <= 1e-6 * scale)
    assert np.all(scale > 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kept", "cells"), [(1, 12), (10**9, 13)], ids=["blocks", "whole"]
)
def test_a_run_is_differentiated_in_blocks_or_whole(monkeypatch, kept, cells):
    """As central differences say, by what the walls, blood and the energy share.

    Grids differ, so that none runs what was compiled for the other.
    """
    monkeypatch.setattr("pinav.thermal.solve.MANY_VALUES", kept)
    model = heated_tumour(RadialGrid.sphere(0.03, cells), Robin(20.0, 25.0))
    protocol = Piecewise.constant((0.0, 70.0, 160.0), [1.5e4, 0.7e4], 1e5)
    options = {"stepper": Rosenbrock(20.0), "observe": jnp.mean}
    schedule = plan_steps(protocol, 20.0)

    def outcome(scale):
        own = eqx.tree_at(lambda m: m.blood.arterial, model, 37.0 * scale)
        found = run(own, protocol, schedule, start=AT_REST.state(model), **options)
        taken = jnp.log(jnp.abs(found.energy.perfused))
        return found.observed[-1] + jnp.log(jnp.sum(found.final.dose)) + taken

    at, step = jnp.asarray(0.999), 1e-6
    difference = float(outcome(at + step) - outcome(at - step)) / (2 * step)
    assert float(jax.grad(outcome)(at)) == pytest.approx(difference, rel=1e-6)
    compiled = float(eqx.filter_jit(outcome)(at))
    assert float(outcome(at)) == pytest.approx(compiled, rel=1e-12)


@pytest.mark.slow
def test_reverse_mode_in_the_plane():
    """Through the stages of RKL2, in blocks."""
    model = heated_tumour(CartesianGrid.cubes((12, 12), 2.5e-3), Robin(20.0, 25.0))
    protocol = Piecewise.constant((0.0, 100.0), [1.2e4], 1e5)
    options = {"stepper": RKL2(5), "observe": jnp.max}
    schedule = plan_steps(protocol, 20.0)

    def outcome(power):
        own = eqx.tree_at(lambda m: m.sources[0].scale, model, power)
        found = run(own, protocol, schedule, **options)
        return jnp.log(jnp.sum(found.final.dose)) + found.observed[-1]

    reverse, forward = (
        float(jax.jit(mode(outcome))(jnp.asarray(1.1)))
        for mode in (jax.grad, jax.jacfwd)
    )
    assert reverse == pytest.approx(forward, rel=1e-10)


@pytest.mark.slow
def test_exact_sensitivities_at_second_order():
    """By k, W, R and Q within 1e-3 at some 400 cells, far from the outer wall.

    The radius ends in the middle of a cell on both grids: the derivative by it is that
    of the cell it cuts, which elsewhere is off by a share of the cell's width.
    """
    errors = [
        np.abs(np.array([*sensitivity_ratios(n).values()]) - 1) for n in (135, 405)
    ]
    assert np.all(errors[1] < 1e-3)
    assert np.all(np.log(errors[0] / errors[1]) / np.log(3.0) > 1.9)


@pytest.mark.slow
def test_the_sensitivity_to_power_in_an_interval_is_the_adjoint_kernel():
    grid, edges = RadialGrid.sphere(0.05, 400), (0.0, 120.0, 300.0)
    model = medium(grid, 4e5 * grid.ball(0.005))
    options = {"stepper": Rosenbrock(), "observe": probes_at(model, [0.0])}
    schedule = plan_steps(switched(edges, [1.0, 1.0]), 5.0)

    def outcome(powers):
        protocol = Piecewise.constant(edges, 1e4 * jnp.sqrt(powers), 1e5)
        return run(model, protocol, schedule, **options).observed[-1, 0]

    found = jax.grad(outcome)(jnp.ones(2))
    true = exact.heated_sphere_kernels(0.0, 300.0, SET_S, 0.005, edges)
    assert np.asarray(found) == pytest.approx(4e5 * np.array(true), rel=1e-3)


@pytest.mark.slow
def test_a_run_goes_on_from_its_state():
    """Two runs one after the other are one run, dose included."""
    model = heated_tumour(RadialGrid.sphere(0.03, 30), Dirichlet(37.0))
    protocol = Piecewise.constant((0, 200, 400), [1.5e4, 1.2e4], 1e5)
    whole = solve(model, protocol, save_at=[200.0, 400.0])
    first = solve(model, Piecewise.constant((0, 200), [1.5e4], 1e5))
    second = solve(model, protocol, start=first.final)
    assert float(second.final.time) == 400.0
    for found, true in (
        (second.final.temperature, whole.final.temperature),
        (second.final.dose, whole.final.dose),
        (first.final.temperature, whole.observed[0]),
    ):
        assert np.asarray(found) == pytest.approx(np.asarray(true), rel=1e-12)


@pytest.mark.slow
def test_the_axes_of_a_box_are_alike():
    """A plane that is a slab along its second axis agrees with it."""
    closed = outer(Dirichlet(0.0))[0].low
    sides = (Sides(Robin(50.0, 20.0), Dirichlet(37.0)),)
    slab = medium(RadialGrid.slab(0.02, 10), 0.0, sides, lang("fat"))
    box = CartesianGrid((3, 10), (1e-3, 2e-3))
    plane = medium(box, 0.0, (Sides(closed, closed), *sides), lang("fat"))
    protocol = Piecewise.constant((0.0, 600.0), [0.0], 1e5)

    def end(model, **options):
        return np.asarray(solve(model, protocol, **options).final.temperature)

    along, across = (end(model, stepper=RKL2(5, 10.0)) for model in (slab, plane))
    assert across == pytest.approx(np.tile(along, (3, 1)), rel=1e-12)
    assert end(slab) == pytest.approx(along, abs=2e-3)


BLAND = medium(RadialGrid.sphere(0.03, 30), 0.0)
HOUR = Piecewise.constant((0.0, 3600.0), [0.0], 1e5)
PLANE = CartesianGrid.cubes((20, 20), 5e-4)
HEATED_PLANE = heated_tumour(PLANE, Dirichlet(37.0))


test_bad_input_is_refused_in_one_line = refusals(
    (lambda: Tissue(-0.5, 1.0, 1.0), r"Tissue.conductivity: expected > 0 W/\(m K\)"),
    (lambda: Tissue(0.5, 1e3, 0.0), r"Tissue.specific_heat: expected > 0 J/\(kg K\)"),
    (lambda: Tissue(0.5, 1e3, 1e3, -1.0), r"Tissue.metabolic: expected >= 0 W/m³"),
    (lambda: Blood(0.0), r"Blood.density: expected > 0 kg/m³, got 0"),
    (lambda: Robin(0.0, 20.0), r"Robin.exchange: expected > 0 W/\(m² K\), got 0.0"),
    (lambda: RadialGrid.sphere(0.03, 2), r"sphere radius: expected 3 cells"),
    (lambda: RadialGrid.slab(-1.0, 9), r"slab length: expected a length > 0 m"),
    (lambda: CartesianGrid((9,), (0.0,)), r"expected 3 cells or more of positive"),
    (lambda: CartesianGrid((9, 9), (1.0,)), r"one to three axes with a spacing"),
    (
        lambda: BLAND.grid.ball(0.01, center=[0.0]),
        r"a ball is centred at 0; use a CartesianGrid",
    ),
    (lambda: probes_at(BLAND, [0.01, 0.04]), r"probe at 0.04 m: expected between"),
    (
        lambda: PLANE.interpolation([[0.001, 0.02]]),
        r"probe at \[0.001, 0.02\] m: expected inside the grid",
    ),
    (
        lambda: eqx.tree_at(lambda m: m.sides, BLAND, ()).__check_init__(),
        r"Bioheat.sides: expected 1, one pair",
    ),
    (
        lambda: medium(PLANE, 0.0, tissue=Tissue(jnp.ones(3), 1.0, 1.0)),
        r"Bioheat.tissue.conductivity: expected a number or the shape \(20, 20\)",
    ),
    (lambda: RKL2(4), r"RKL2.stages: expected odd and >= 3, got 4"),
    (lambda: RKL2(9, 0.0), r"RKL2.longest: expected > 0, got 0.0"),
    (lambda: Rosenbrock(-1.0), r"Rosenbrock.longest: expected > 0, got -1.0"),
    (
        lambda: solve(HEATED_PLANE, HOUR, stepper=RKL2(3, 20.0)),
        r"RKL2.longest: expected <= .* s, which 3 stages hold stable .* got 20 s",
    ),
    (
        lambda: solve(HEATED_PLANE, HOUR, stepper=Rosenbrock()),
        r"Rosenbrock: expected a grid with one axis, got 2; use RKL2",
    ),
    (
        lambda: solve(BLAND, HOUR, save_at=[4000.0]),
        r"saved time 4000 s: expected after 0 and up to 3600 s",
    ),
    (lambda: solve(BLAND, HOUR, save_every=0.0), r"save_every: expected a time > 0"),
    (
        lambda: solve(
            BLAND, HOUR, start=HeatState(jnp.asarray(1e4), jnp.ones(30), jnp.ones(30))
        ),
        r"schedule start: expected within 0 and 3600 s, got 10000",
    ),
    (
        lambda: solve(BLAND, HOUR, start=HeatState.at(jnp.ones(9))),
        r"start: expected a temperature of shape \(30,\), .*, got \(9,\)",
    ),
)


def test_the_stepper_suits_the_grid():
    assert isinstance(default_stepper(BLAND), Rosenbrock)
    assert isinstance(default_stepper(HEATED_PLANE), RKL2)


@pytest.mark.parametrize(("size", "stages"), [(4e-3, 3), (1e-3, 5), (3e-4, 15)])
def test_stages_are_the_fewest_for_the_time_they_cover(size, stages):
    grid = CartesianGrid.cubes((5, 5, 5), size)
    model = heated_tumour(grid, Dirichlet(37.0))
    chosen = RKL2.for_model(model)
    assert chosen.stages == stages
    cost = chosen.stages / chosen.longest_step(model)
    for other in (3, 5, 7, 9, 11, 13, 15):
        assert other / RKL2(other).longest_step(model) >= 0.999 * cost
