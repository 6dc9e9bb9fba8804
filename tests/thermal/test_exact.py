"""Exact solutions: printed values, and the equations that they must solve."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate
from validation.heat import exact
from validation.heat.checks import Check, table
from validation.heat.exact import SET_S, Medium
from validation.heat.exact.controls import (
    discrete_eigenmode_rate,
    eigenmode_rate,
    heated_sphere_by_rate,
    least_energy,
    least_energy_control,
    lumped_by_perfusion,
    on_off_cycle,
    perfused_slab_flux,
    perfused_slab_sensitivities,
    saturate_and_ride,
)

from pinav.report import as_text

BARE = Medium(SET_S.conductivity, SET_S.capacity)
TUMOUR = Medium(0.55, 1045.0 * 3600.0, 8.33e-4 * 4.18e6)
MUSCLE = Medium(0.5, 1050.0 * 3600.0, 4.5e-4 * 4.18e6)
DRAWN = Medium(0.37, 3.1e6, 2100.0)


def test_the_slab_at_its_printed_places_and_times():
    x = np.array([0, 0.01, 0.015, 0.02, 0.029])
    steady = [4.4993138827, 4.1891786814, 3.7452468156, 3.0079100343, 0.4346318575]
    found = exact.perfused_slab(x, np.inf, SET_S, 2e4, 0.03)
    assert found == pytest.approx(steady, abs=1e-9)
    early = {60: (0.3080809506, 0.3073813177), 300: (1.3701754993, 1.2240584589)}
    for t, values in early.items():
        found = exact.perfused_slab(x[[0, 3]], t, SET_S, 2e4, 0.03)
        assert found == pytest.approx(values, abs=1e-9)
    flux = perfused_slab_flux(SET_S, 2e4, 0.03)
    assert flux == pytest.approx(227.03473628, abs=1e-7)


def test_the_skin_at_its_printed_places():
    medium = Medium(0.5, 1.0, 0.5 * SET_S.perfusion)
    x = np.array([0, 0.005, 0.01, 0.02])
    found = exact.skin(x, medium, 420.0, 0.03, 10.0, 25.0)
    printed = [34.2855074069, 35.0883501689, 35.6870816191, 36.4873546934]
    assert found == pytest.approx(printed, abs=1e-9)


@pytest.mark.parametrize(
    ("medium", "t", "printed"),
    [
        (BARE, 60, (4.22135333047, 1.8380672652, 0.093022911222)),
        (BARE, 600, (7.9216912076, 4.64003722769, 1.44846207869)),
        (BARE, np.inf, (10, 20 / 3, 10 / 3)),
        (SET_S, 60, (4.12116510247, 1.7914583839, 0.0890717592941)),
        (SET_S, 600, (7.16564026654, 4.05801621753, 1.13122463495)),
        (SET_S, np.inf, (7.51911155248, 4.39422616391, 1.42102394134)),
    ],
)
def test_the_heated_sphere_at_its_printed_places(medium, t, printed):
    places = (0.0, 0.005, 0.01)
    found = [exact.heated_sphere(r, t, medium, 4e5, 0.005) for r in places]
    assert found == pytest.approx(printed, abs=1e-10)


def test_power_in_intervals_adds_up():
    """A power switched on and off is the sum of its intervals, and of two steps."""
    r, t, radius = 0.004, 400.0, 0.005
    edges, powers = (0.0, 100.0, 250.0, 600.0), (1.0, 0.3, 0.8)
    found = exact.heated_sphere(r, t, SET_S, 4e5, radius, edges=edges, powers=powers)
    steps = sum(
        change * exact.heated_sphere(r, t - start, SET_S, 4e5, radius)
        for start, change in ((0.0, 1.0), (100.0, -0.7), (250.0, 0.5))
    )
    assert found == pytest.approx(steps, rel=1e-10)


def test_two_conductivities_reduce_to_one():
    """With equal media the transient is that of the heated sphere."""
    for r in (0.0, 0.002, 0.008):
        found = exact.two_conductivities(r, 90.0, BARE, BARE, 4e5, 0.005)
        assert found == pytest.approx(
            exact.heated_sphere(r, 90.0, BARE, 4e5, 0.005), rel=1e-9
        )


def test_two_conductivities_become_steady_and_fit_at_the_edge():
    inner, outer = Medium(0.778, 1660.0 * 2540.0), Medium(0.642, 1000.0 * 3720.0)
    case = (inner, outer, 6.15e6, 3.15e-3)
    late = exact.two_conductivities(0.001, 1e9, *case)
    assert late == pytest.approx(
        exact.two_conductivities(0.001, np.inf, *case), rel=1e-4
    )
    below, above = (
        exact.two_conductivities(3.15e-3 * factor, 20.0, *case)
        for factor in (1 - 1e-9, 1 + 1e-9)
    )
    assert below == pytest.approx(above, rel=1e-6)


def test_perfused_spheres_solve_their_equation():
    """k θ'' + 2k θ'/r = Wθ − Q on both sides, and the heat flux is continuous."""
    case = (TUMOUR, MUSCLE, (1.0579e5, 700.0), (0.01, 0.05))
    for r, medium, source in ((0.006, TUMOUR, 1.0579e5), (0.02, MUSCLE, 700.0)):
        h = 1e-4
        low, middle, high = (
            exact.perfused_spheres(r + d, np.inf, *case) for d in (-h, 0, h)
        )
        laplacian = (high - 2 * middle + low) / h**2 + (high - low) / (r * h)
        balance = medium.conductivity * laplacian
        balance += source - medium.perfusion * middle
        assert abs(balance) < 1e-3 * source + 1
    edge = [exact.perfused_spheres(0.01 + d, np.inf, *case) for d in (-1e-6, 0.0, 1e-6)]
    inflow, outflow = 0.55 * (edge[1] - edge[0]), 0.5 * (edge[2] - edge[1])
    assert inflow == pytest.approx(outflow, rel=1e-3)
    assert exact.perfused_spheres(0.05, np.inf, *case) == pytest.approx(0, abs=1e-12)


def test_perfused_spheres_start_at_zero_and_become_steady():
    case = (TUMOUR, MUSCLE, (1e5, 700.0), (0.01, 0.05))
    early = exact.perfused_spheres(0.0, 1.0, *case)
    assert early == pytest.approx(1e5 / TUMOUR.capacity, rel=1e-2)
    late = exact.perfused_spheres(0.0, 1e6, *case)
    assert late == pytest.approx(exact.perfused_spheres(0.0, np.inf, *case), rel=1e-9)


def test_the_point_source_is_the_limit_of_a_small_sphere():
    for t in (300.0, np.inf):
        radius, r = 2e-4, 0.005
        source = 0.1 / (4 / 3 * np.pi * radius**3)
        sphere = exact.heated_sphere(r, t, SET_S, source, radius)
        point = exact.point_source(r, t, SET_S, 0.1)
        assert sphere == pytest.approx(point, rel=1e-3)


def test_gaussian_spots_at_their_printed_values():
    decay = [3.62066884808, 1.77207135697, 0.867308507335]
    bare = [4.89432044553, 2.39543726236, 1.17240375692]
    late = [9.67690710702, 4.98677872125, 2.97940012824]
    for dim in (1, 2, 3):
        args = (10.0, 0.005, dim)
        found = exact.gaussian_decay(0.0, 300.0, SET_S, *args)
        assert found == pytest.approx(decay[dim - 1], abs=1e-10)
        found = exact.gaussian_decay(0.0, 300.0, BARE, *args)
        assert found == pytest.approx(bare[dim - 1], abs=1e-10)
        found = exact.gaussian_source(0.0, 1800.0, SET_S, 1e5, 0.005, dim)
        assert found == pytest.approx(late[dim - 1], abs=1e-9)


def box_case(perfused):
    x = (np.arange(128) - 64) * 1e-3
    squares = x[:, None] ** 2 + x[None] ** 2
    medium = Medium(0.52, 1079.0 * 3540.0, perfused * 1060.0 * 36.17)
    return np.exp(-squares / 0.004**2), medium


@pytest.mark.parametrize(
    ("perfused", "printed"),
    [
        (1.0, (0.0363422387, 0.0251395007, 0.0006807052)),
        (0.0, (0.1637956986, 0.1133045798, 0.0030679616)),
    ],
)
def test_the_periodic_box_at_its_printed_places(perfused, printed):
    rise, medium = box_case(perfused)
    found = exact.periodic_box(rise, np.zeros_like(rise), 150.0, medium, 1e-3)
    values = found[64, 64], found[70, 64], found.mean()
    assert values == pytest.approx(printed, abs=1e-10)


def test_the_periodic_box_balances_its_heat():
    rise, medium = box_case(perfused=0.0)
    source = 3e4 * np.roll(rise, (30, 30), (0, 1))
    found = exact.periodic_box(rise, source, 150.0, medium, 1e-3)
    gained = rise.mean() + 150.0 * source.mean() / medium.capacity
    assert found.mean() == pytest.approx(gained, rel=1e-12)


def test_lumped_rises_at_their_printed_times():
    found = [exact.lumped_rise(t, SET_S, 3e4) for t in (60, 600, 1800)]
    assert found == pytest.approx([0.4621214258, 3.5762955047, 6.6045278075], abs=1e-9)
    assert exact.lumped_forced(0.0, SET_S, 3e4, 600.0) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("medium", [SET_S, DRAWN], ids=["set S", "drawn"])
def test_the_forced_rise_solves_its_equation(medium):
    def rate(t, rise):
        power = 3e4 * np.sin(np.pi * t / 600.0) ** 2
        return power / medium.capacity - medium.rate * rise

    solved = scipy.integrate.solve_ivp(rate, (0, 1500), [0.0], rtol=1e-11, atol=1e-12)
    found = exact.lumped_forced(1500.0, medium, 3e4, 600.0)
    assert found == pytest.approx(float(solved.y[0, -1]), rel=1e-8)


def test_the_nonlinear_rise_is_the_linear_one_without_nonlinearity():
    found = exact.lumped_nonlinear(
        900.0, SET_S.capacity, 3e4, lambda x: SET_S.perfusion * x
    )
    assert found == pytest.approx(exact.lumped_rise(900.0, SET_S, 3e4), rel=1e-9)


def test_the_cycle_repeats_itself():
    high, low, mean = on_off_cycle(SET_S, 3e4, 50.0, 100.0)
    cooled = high * np.exp(-SET_S.rate * 100.0)
    assert low == pytest.approx(cooled)
    heated = low * np.exp(-SET_S.rate * 50.0) + exact.lumped_rise(50.0, SET_S, 3e4)
    assert heated == pytest.approx(high)
    assert low < mean < high


def slope(function, value):
    step = 1e-5 * value
    return (function(value + step) - function(value - step)) / (2 * step)


def drawn(name):
    return lambda value: dataclasses.replace(DRAWN, **{name: value})


def sphere(medium, radius=0.005, r=0.0, t=np.inf):
    return exact.heated_sphere(r, t, medium, 4e5, radius)


def slab(medium, length=0.03):
    return float(exact.perfused_slab(np.zeros(1), np.inf, medium, 2e4, length)[0])


@pytest.mark.parametrize(
    ("own", "solution", "name", "size"),
    [
        (exact.heated_sphere_sensitivities(DRAWN, 4e5, 0.005), sphere, "radius", 0.005),
        (perfused_slab_sensitivities(DRAWN, 2e4, 0.03), slab, "length", 0.03),
    ],
    ids=["sphere", "slab"],
)
def test_sensitivities_are_derivatives(own, solution, name, size):
    """Against central differences of the closed forms, by every constant."""
    for constant in ("conductivity", "perfusion"):
        change, value = drawn(constant), getattr(DRAWN, constant)
        expected = slope(lambda v, c=change: solution(c(v)), value)
        assert own[constant] == pytest.approx(expected, rel=1e-6)
    by_size = slope(lambda v: solution(DRAWN, v), size)
    assert own[name] == pytest.approx(by_size, rel=1e-6)


def test_sensitivities_over_time_are_derivatives_and_as_printed():
    by_rate = heated_sphere_by_rate(0.003, 300.0, DRAWN, 4e5, 0.005)
    change = drawn("perfusion")
    by_perfusion = slope(lambda v: sphere(change(v), r=0.003, t=300.0), 2100.0)
    assert by_rate / DRAWN.capacity == pytest.approx(by_perfusion, rel=1e-6)
    printed = {600.0: -970.300882889, 1800.0: -4263.10206162}
    for t, value in printed.items():
        found = lumped_by_perfusion(t, SET_S, 3e4) * 1050.0 * 3617.0
        assert found == pytest.approx(value, rel=1e-9)


def test_the_ramp_dose_at_its_printed_values():
    assert exact.ramp_dose(37, 45, 10, 37) == pytest.approx(6.3115706661, abs=1e-9)
    assert exact.ramp_dose(37, 45, 10, 39) == pytest.approx(6.3082685992, abs=1e-9)


def test_the_least_energy_control_arrives():
    decay, gain, rises, end = 1e-3, 1 / 3.78e6, (0.0, 6.0), 1800.0

    def control(t):
        return least_energy_control(t, decay, gain, rises, end)

    arrived, _ = scipy.integrate.quad(
        lambda t: np.exp(-decay * (end - t)) * gain * control(t), 0, end
    )
    energy, _ = scipy.integrate.quad(lambda t: control(t) ** 2, 0, end)
    assert arrived == pytest.approx(6.0, rel=1e-9)
    assert energy == pytest.approx(least_energy(decay, gain, rises, end), rel=1e-9)
    constant = decay * 6.0 / (gain * -np.expm1(-decay * end))
    assert energy < constant**2 * end


def test_saturating_reaches_the_limit_and_holds_it():
    decay, gain = 1e-3, 1 / 3.78e6
    switch, hold = saturate_and_ride(decay, gain, 6.0, 5e4)
    assert gain * 5e4 / decay * -np.expm1(-decay * switch) == pytest.approx(6.0)
    assert -decay * 6.0 + gain * hold == pytest.approx(0, abs=1e-15)


def test_eigenmodes_of_the_grid_approach_those_of_the_slab():
    true = eigenmode_rate(SET_S, 3, 0.03)
    errors = [discrete_eigenmode_rate(SET_S, 3, 0.03, n) - true for n in (32, 64)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=1e-2)


def test_cylinder_and_ball_vanish_at_their_surface_and_solve_their_equation():
    for solution, factor in ((exact.perfused_cylinder, 1), (exact.perfused_ball, 2)):
        h = 1e-4
        r = np.array([0.01 - h, 0.01, 0.01 + h, 0.02])
        low, middle, high, edge = solution(r, DRAWN, 2e4, 0.02)
        assert edge == pytest.approx(0, abs=1e-12)
        laplacian = (high - 2 * middle + low) / h**2
        laplacian += factor * (high - low) / (2 * h * 0.01)
        balance = DRAWN.conductivity * laplacian + 2e4 - DRAWN.perfusion * middle
        assert abs(balance) < 1.0


def test_a_check_outside_its_tolerance_is_marked():
    bad = Check("a case", 1.0, 2.0, 0.5, "K")
    assert "NO" in as_text(table([bad]))
    assert bad.error == 1.0
