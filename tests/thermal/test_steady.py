"""Steady states, starts and sides: exact solutions, agreement with runs, gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from validation.heat.checks import AMPLITUDE, powers
from validation.heat.checks import reference_model as medium
from validation.heat.verification import CLOSED

from pinav.errors import InputError
from pinav.thermal.boundaries import (
    AbstractBoundary,
    Dirichlet,
    Insulated,
    Passage,
    Periodic,
    Robin,
    Sides,
    outer,
)
from pinav.thermal.dose import LIVER_DAMAGE
from pinav.thermal.grids import CartesianGrid, RadialGrid
from pinav.thermal.perfusion import RegionalPerfusion, lang
from pinav.thermal.solve import solve
from pinav.thermal.sources import EddySource, axis_distance
from pinav.thermal.starts import (
    AtSteadyState,
    HeatState,
    find_steady_state,
    steady_state,
)
from pinav.thermal.steppers import Rosenbrock

ENDS = (Sides(Insulated(), Robin(10.0, 25.0)),)


@pytest.mark.slow
def test_a_steady_state_with_nonlinear_perfusion_is_where_a_run_ends():
    grid = RadialGrid.sphere(0.04, 40)
    share = grid.ball(0.01)
    law = RegionalPerfusion((share, 1 - share), (lang("tumour"), lang("muscle")))
    model = medium(grid, 1.2e5 * share, outer(Robin(20.0, 25.0)), law)
    run = solve(model, powers((0.0, 1e5), [1.0]), stepper=Rosenbrock(200.0))
    steady = find_steady_state(model, AMPLITUDE)
    assert jnp.allclose(steady.temperature, run.final.temperature, atol=1e-5)
    assert int(steady.iterations) < 20


@pytest.mark.slow
def test_the_derivative_of_a_steady_state_in_both_modes():
    slab = medium(RadialGrid.slab(0.03, 40), 2e4)

    def hottest(numbers):
        model = eqx.tree_at(
            lambda m: (m.perfusion.value, m.tissue.conductivity), slab, tuple(numbers)
        )
        return steady_state(model, AMPLITUDE).temperature[0]

    at, step = jnp.array([1.05, 0.5]), 1e-4
    forward, reverse = jax.jacfwd(hottest)(at), jax.grad(hottest)(at)
    shifts = step * jnp.eye(2)
    central = jnp.stack([hottest(at + s) - hottest(at - s) for s in shifts])
    assert jnp.allclose(forward, reverse, rtol=1e-9)
    assert jnp.allclose(forward, central / (2 * step), rtol=1e-6)


@pytest.mark.slow
def test_a_box_with_periodic_and_insulated_sides_is_a_slab():
    grid = CartesianGrid.cubes((30, 4, 3), 1e-3)
    across = Sides(Insulated(), Insulated())
    box = medium(grid, 2e4, (*ENDS, Periodic(), across))
    slab = medium(CartesianGrid.cubes((30,), 1e-3), 2e4, ENDS)
    flat = steady_state(slab, AMPLITUDE).temperature
    full = steady_state(box, AMPLITUDE).temperature
    assert jnp.allclose(full, flat[:, None, None] + jnp.zeros(grid.shape), atol=1e-7)


@pytest.mark.slow
def test_a_periodic_box_does_not_know_where_it_begins():
    grid = CartesianGrid.cubes((12, 10), 2e-3)
    shape = 1e5 * np.exp(-0.5 * (np.asarray(grid.distances()) / 4e-3) ** 2)
    ends = (Periodic(), Sides(Insulated(), Dirichlet(37.0)))
    protocol = powers((0.0, 60.0), [1.0])
    first = solve(medium(grid, shape, ends), protocol)
    moved = solve(medium(grid, np.roll(shape, 5, axis=0), ends), protocol)
    rolled = np.roll(np.asarray(first.final.temperature), 5, axis=0)
    assert np.allclose(rolled, moved.final.temperature, atol=1e-9)
    assert float(first.energy.imbalance) < 1e-10


class Flux(AbstractBoundary):
    """A prescribed flux into the tissue [W m⁻²], as a boundary of one's own."""

    flux: float

    def passage(self, area, resistance):
        return Passage(jnp.zeros_like(area), inflow=self.flux * area)


@pytest.mark.parametrize("low", [Dirichlet(37.0), Robin(80.0, 37.0)])
@pytest.mark.parametrize("across", [(), (Periodic(),)], ids=["slab", "plane"])
def test_a_prescribed_flux_needs_no_other_change(across, low):
    """The rise is that of a constant flux through wall and tissue, exact on a grid."""
    size, count, flux = 1e-3, 20, 150.0
    shape = (count, *(3 for _ in across))
    model = medium(
        CartesianGrid.cubes(shape, size), 0.0, (Sides(low, Flux(flux)), *across), 0.0
    )
    film = 0.0 if isinstance(low, Dirichlet) else 1 / low.exchange
    resistance = film + (np.arange(count) + 0.5) * size / 0.5
    rise = np.moveaxis(np.asarray(find_steady_state(model).temperature) - 37.0, 0, -1)
    assert rise == pytest.approx(np.broadcast_to(flux * resistance, rise.shape))
    heated = solve(model, powers((0.0, 60.0), [0.0]))
    area = float(model.grid.faces(0)[0].sum())
    assert float(heated.energy.brought) == pytest.approx(60.0 * flux * area)
    assert float(heated.energy.imbalance) < 1e-10


def test_ends_that_meet_need_another_axis_and_heat_must_be_able_to_leave():
    grid = RadialGrid.slab(0.03, 10)
    with pytest.raises(InputError, match="ends that do not meet on a grid with one"):
        medium(grid, 2e4, (Periodic(),))
    with pytest.raises(InputError, match="heat must be able to leave"):
        find_steady_state(medium(grid, 2e4, CLOSED, 0.0), AMPLITUDE)


def test_a_run_from_the_steady_state_without_a_field_stays_there():
    model = medium(RadialGrid.slab(0.03, 20), 2e4, ENDS)
    off = powers((0.0, 600.0), [0.0])
    rest = AtSteadyState().state(model).temperature
    run = solve(model, off, start=AtSteadyState())
    assert float(rest.min()) < 36.0
    assert jnp.allclose(run.final.temperature, rest, atol=1e-8)


def test_damage_is_accumulated_beside_the_dose():
    model = medium(RadialGrid.slab(0.03, 3), 0.0, CLOSED, 0.0)
    off = powers((0.0, 600.0), [0.0])
    warm = {"start": HeatState.at(jnp.full(3, 45.0)), "save_every": 300.0}
    run = solve(model, off, damage=LIVER_DAMAGE, observe_dose=jnp.max, **warm)
    rate = float(LIVER_DAMAGE.rate(jnp.asarray(45.0)))
    assert jnp.allclose(run.final.damage, 600.0 * rate, rtol=1e-9)
    assert jnp.allclose(run.observed_dose, jnp.array([20.0, 40.0]))
    assert solve(model, off, **warm).final.damage is None


def test_eddy_power_grows_with_the_square_of_the_radius():
    grid = RadialGrid.cylinder(0.1, 20)
    source = EddySource(0.4)
    level = source.level(4.85e3, 1e5)
    # 1.649740e4 W/m³ at 15 cm
    expected = 1.649740e4 * (grid.centers / 0.15) ** 2
    assert jnp.allclose(source.shape(grid) * level, expected, rtol=1e-6)
    box = CartesianGrid.cubes((4, 4, 3), 0.01)
    distance = axis_distance(box, (0.005, 0.005))
    assert jnp.allclose(distance[:, 0, 2], jnp.array([0.0, 0.01, 0.02, 0.03]))
    with pytest.raises(InputError, match="expected a cylinder or a box"):
        axis_distance(RadialGrid.sphere(0.1, 20))


def test_tissue_without_heat_rests_at_the_arterial_temperature():
    grid, ends = CartesianGrid.cubes((4, 3), 1e-3), (Periodic(), Periodic())
    model = medium(grid, 0.0, ends, lang("muscle"))
    assert jnp.allclose(steady_state(model).temperature, 37.0)
