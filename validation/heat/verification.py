"""The solver against exact solutions, on this installation: one row for each case."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from validation.heat import exact
from validation.heat.checks import (
    AMPLITUDE,
    Check,
    checks_along,
    powers,
    reference_model,
)
from validation.heat.exact import SET_S, Medium
from validation.heat.steady_checks import (
    interface_checks,
    order_checks,
    radius_checks,
    rest_checks,
)
from validation.heat.waveform import Waveform

from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import (
    Dirichlet,
    Insulated,
    Robin,
    Sides,
    around,
    outer,
)
from pinav.thermal.dose import cem43_segment
from pinav.thermal.grids import CartesianGrid, RadialGrid
from pinav.thermal.perfusion import ConstantPerfusion, RegionalPerfusion, lang
from pinav.thermal.protocols import plan_steps
from pinav.thermal.quantities import Number
from pinav.thermal.solve import run, solve
from pinav.thermal.sources import LinearResponse, PowerSource
from pinav.thermal.starts import HeatState
from pinav.thermal.steppers import RKL2, Rosenbrock
from pinav.thermal.tissues import Blood, Tissue, mix

STEADY = 4e4
"""A time [s] after which perfused tissue no longer changes."""

CLOSED = (Sides(Insulated(), Insulated()),)
"""Both ends of a slab insulated."""


def verify() -> list[Check]:
    """All cases."""
    return [check for case in CASES.values() for check in case()]


Solution = Callable[[np.ndarray], Any]
"""Exact rises [K] at places [m]."""


def _steady(
    case: str, model: Bioheat, solution: Solution, tolerance: float
) -> Iterator[Check]:
    protocol = powers((0.0, STEADY), [1.0])
    end = solve(model, protocol, stepper=Rosenbrock(500.0)).final.temperature
    yield from checks_along(f"{case}, steady", model, end, solution, tolerance)


def _slabs() -> Iterator[Check]:
    slab = reference_model(RadialGrid.slab(0.03, 320), 2e4)

    def rise(r: np.ndarray, t: float = np.inf) -> Any:
        return exact.perfused_slab(r, t, SET_S, 2e4, 0.03)

    yield from _steady("perfused slab", slab, rise, 1e-4)
    times = (60.0, 300.0, 1800.0)
    found = solve(slab, powers((0.0, 1800.0), [1.0]), save_at=times)
    for t, values in zip(times, found.observed, strict=True):
        name = f"perfused slab, {t:g} s"
        yield from checks_along(name, slab, values, partial(rise, t=t), 1e-3)
    sides = (Sides(Robin(10.0, 25.0), Dirichlet(37.0)),)
    skin = reference_model(RadialGrid.slab(0.03, 320), 420.0, sides, 0.525)
    half = Medium(0.5, SET_S.capacity, 0.5 * SET_S.perfusion)
    constants = half, 420.0, 0.03, 10.0, 25.0
    yield from _steady("skin", skin, lambda r: exact.skin(r, *constants) - 37.0, 1e-3)


def _round() -> Iterator[Check]:
    for name, make, true in (
        ("cylinder", RadialGrid.cylinder, exact.perfused_cylinder),
        ("ball", RadialGrid.sphere, exact.perfused_ball),
    ):
        model = reference_model(make(0.03, 320), 2e4)
        solution = partial(true, medium=SET_S, source=2e4, radius=0.03)
        yield from _steady(f"perfused {name}", model, solution, 2e-4)


def _heated_spheres() -> Iterator[Check]:
    grid = RadialGrid.sphere(0.05, 400)
    for name, perfusion in (("bare", 0.0), ("perfused", 1.05)):
        model = reference_model(grid, 4e5 * grid.ball(0.005), perfusion=perfusion)
        end = solve(model, powers((0.0, 600.0), [1.0]), stepper=Rosenbrock(2.0)).final
        medium = Medium(0.5, SET_S.capacity, 3617.0 * perfusion)
        case = 600.0, medium, 4e5, 0.005
        yield from checks_along(
            f"heated sphere, {name}, 600 s",
            model,
            end.temperature,
            _at_each(exact.heated_sphere, *case),
            2e-3,
            points=(0.0, 0.004, 0.01),
        )


def _at_each(function: Callable[..., float], *constants: Any) -> Solution:
    """The exact solution of one place, at many."""
    return lambda places: [function(float(r), *constants) for r in places]


def _two_media() -> Iterator[Check]:
    """With k∇²T in place of ∇·(k∇T) the centre is 12 % low, on any grid."""
    radius = 3.15e-3
    grid = RadialGrid.sphere(10 * radius, 400)
    fraction = grid.ball(radius)
    inner, outside = Tissue(0.778, 1660.0, 2540.0), Tissue(0.642, 1000.0, 3720.0)
    tissue = mix((fraction, 1 - fraction), (inner, outside))
    model = reference_model(grid, 6.15e6 * fraction, None, 0.0, tissue)
    media = Medium(0.778, 1660.0 * 2540.0), Medium(0.642, 3.72e6)
    for end, step, edge in ((1e6, 1e4, 10 * radius), (60.0, 0.5, np.inf)):
        found = solve(model, powers((0.0, end), [1.0]), stepper=Rosenbrock(step)).final
        late = end > 1e5
        true = partial(exact.two_conductivities, outer_radius=edge)
        constants = np.inf if late else end, *media, 6.15e6, radius
        yield from checks_along(
            f"two conductivities, {'steady' if late else '60 s'}",
            model,
            found.temperature,
            _at_each(true, *constants),
            2e-2,
            points=(0.0,),
            every=1 if late else 20,
        )


def two_shells(count: int, *, cut: bool = True) -> tuple[Bioheat, tuple[Any, ...]]:
    """A perfused tumour in perfused muscle with sources, and its exact solution's case.

    Args:
        count: of cells.
        cut: a cell has its share of the tumour; otherwise it is in or out as a whole.
    """
    grid = RadialGrid.sphere(0.05, count)
    fraction = grid.ball(0.01) if cut else jnp.round(grid.ball(0.01))
    shares, laws = (fraction, 1 - fraction), map(ConstantPerfusion, (0.833, 0.45))
    model = Bioheat(
        grid,
        mix(shares, (Tissue(0.55, 1045.0, 3600.0), Tissue(0.5, 1050.0, 3600.0))),
        Blood(1000.0, 4180.0),
        RegionalPerfusion(shares, tuple(laws)),
        (PowerSource(1.0579e5 * fraction + 700.0 * (1 - fraction), AMPLITUDE),),
        outer(Dirichlet(37.0)),
    )
    media = (
        Medium(0.55, 1045.0 * 3600.0, 0.833 * 4180.0),
        Medium(0.5, 1050.0 * 3600.0, 0.45 * 4180.0),
    )
    return model, (*media, (1.0579e5, 700.0), (0.01, 0.05))


def _two_shells() -> Iterator[Check]:
    model, case = two_shells(400)
    for t, tolerance, every in ((np.inf, 1e-3, 1), (300.0, 5e-3, 20)):
        steady = np.isinf(t)
        end, step = (STEADY, 500.0) if steady else (t, 7.5)
        found = solve(model, powers((0.0, end), [1.0]), stepper=Rosenbrock(step)).final
        yield from checks_along(
            f"two perfused shells, {'steady' if steady else '300 s'}",
            model,
            found.temperature,
            _at_each(exact.perfused_spheres, t, *case),
            tolerance,
            points=(0.0, 0.005, 0.02),
            every=every,
        )


def _point() -> Iterator[Check]:
    grid = RadialGrid.sphere(0.05, 400)
    # All power in the innermost cell: a point, as far as the grid can show one.
    model = reference_model(grid, jnp.zeros(400).at[0].set(0.1 / grid.volumes[0]))
    points = np.asarray(grid.centers)[[16, 40, 80]]
    times = (300.0, 1800.0, STEADY)
    found = solve(model, powers((0.0, STEADY), [1.0]), save_at=times)
    for t, values in zip((*times[:2], np.inf), found.observed - 37.0, strict=True):
        for cell, r in zip((16, 40, 80), points, strict=True):
            right = float(exact.point_source(float(r), t, SET_S, 0.1))
            name = f"point source, {t:g} s, {1e3 * r:g} mm"
            yield Check(name, float(values[cell]), right, 1e-3 * right, "K")


def _spots() -> Iterator[Check]:
    grid = CartesianGrid.cubes((64, 64), 1e-3)
    power = 1e5 * jnp.exp(-0.5 * (grid.distances() / 0.005) ** 2)
    model = reference_model(grid, power, around(grid, Insulated()))
    temperature = solve(model, powers((0.0, 300.0), [1.0])).final.temperature
    r = float(grid.distances()[32, 32])
    true = exact.gaussian_source(r, 300.0, SET_S, 1e5, 0.005, 2)
    middle = float(temperature[32, 32]) - 37
    yield Check("Gaussian spot, 2-D, 300 s", middle, true, 2e-2, "K")
    x = (np.arange(128) - 64) * 1e-3
    start = np.exp(-(x[:, None] ** 2 + x[None] ** 2) / 0.004**2)
    medium = Medium(0.52, 1079.0 * 3540.0, 10.6 * 3617.0)
    box = CartesianGrid.cubes((128, 128), 1e-3)
    tissue = Tissue(0.52, 1079.0, 3540.0)
    sides = around(box, Insulated())
    decaying = Bioheat(box, tissue, Blood(1060.0), ConstantPerfusion(10.6), (), sides)
    begin = HeatState(jnp.asarray(0.0), jnp.asarray(37 + start), jnp.zeros(box.shape))
    off = powers((0.0, 150.0), [0.0])
    temperature = solve(decaying, off, start=begin).final.temperature
    true = exact.periodic_box(start, np.zeros_like(start), 150.0, medium, 1e-3)
    for i in (64, 70):
        value = float(temperature[i, 64]) - 37.0
        yield Check(f"box, 150 s, cell {i}", value, float(true[i, 64]), 1.5e-3, "K")


def _lumped() -> Iterator[Check]:
    # Uniform, so that the fewest cells there are have the lumped solution.
    model = reference_model(RadialGrid.slab(0.01, 3), 3e4, CLOSED)
    for name, stepper in (("RKL2", RKL2(5, 10.0)), ("Rosenbrock", Rosenbrock(10.0))):
        plain = solve(model, powers((0.0, 600.0), [1.0]), stepper=stepper)
        rise = float(plain.final.temperature[0]) - 37.0
        true = exact.lumped_rise(600.0, SET_S, 3e4)
        yield Check(f"lumped, {name}, 600 s", rise, true, 1e-4, "K")
        wave = Waveform(
            function=lambda t: AMPLITUDE * jnp.sin(jnp.pi * t / 600.0),
            edges=(0.0, 1500.0),
            frequency=1e5,
        )
        forced = solve(model, wave, stepper=stepper)
        rise = float(forced.final.temperature[0]) - 37.0
        true = exact.lumped_forced(1500.0, SET_S, 3e4, 600.0)
        yield Check(f"lumped, forced, {name}, 1500 s", rise, true, 5e-4, "K")
    warm = eqx.tree_at(lambda m: m.perfusion, model, lang("muscle"))
    solution = solve(warm, powers((0.0, 1200.0), [1.0]), stepper=Rosenbrock(5.0))
    true = exact.lumped_nonlinear(1200.0, SET_S.capacity, 3e4, muscle_sink)
    rise = float(solution.final.temperature[0]) - 37.0
    yield Check("lumped, perfusion of muscle, 1200 s", rise, true, 1e-3, "K")
    dose = solve(model, powers((0.0, 1800.0), [1.0])).final.dose[0]
    yield Check("lumped, dose, 1800 s", float(dose), 12.8317342298, 5e-3, "min")


def muscle_sink(rise: Number) -> float:
    """Heat [W m⁻³] that the perfusion of muscle takes at a rise [K]."""
    below = min(rise - 8.0, 0.0)
    return 3617.0 * (0.45 + 3.55 * np.exp(-(below**2) / 12)) * rise


def _doses() -> Iterator[Check]:
    edges = jnp.linspace(37.0, 45.0, 11)
    for cutoff in (37.0, 39.0):
        dose = float(cem43_segment(edges[:-1], edges[1:], 60.0, cutoff).sum())
        true = exact.ramp_dose(37.0, 45.0, 10.0, cutoff)
        yield Check(f"dose of a ramp from {cutoff:g} °C", dose, true, 1e-8, "min")
    slp = float(LinearResponse(14e-9).slp(1e4, 1e5)) / 1e3
    yield Check("linear response, 14 nm", slp, 53.10271, 1e-4, "W/g")


def sensitivity_ratios(count: int) -> dict[str, float]:
    """Derivatives of the centre of a heated sphere over the exact ones, by name."""
    protocol = powers((0.0, STEADY), [1.0])
    schedule = plan_steps(protocol, 1000.0)
    probe = RadialGrid.sphere(0.005 * 405 / 25.5, count).interpolation([0.0])[0]

    def rise(numbers: Array) -> Array:
        k, perfusion, radius, power = numbers
        grid = RadialGrid.sphere(0.005 * 405 / 25.5, count)
        plain = reference_model(grid, power * grid.ball(radius))
        model = eqx.tree_at(
            lambda m: (m.tissue.conductivity, m.perfusion.value),
            plain,
            (k, perfusion / 3617.0),
        )
        solution = run(model, protocol, schedule, stepper=Rosenbrock(), observe=jnp.max)
        return probe @ solution.final.temperature

    at = jnp.array([SET_S.conductivity, SET_S.perfusion, 0.005, 4e5])
    gradient = np.asarray(jax.jit(jax.grad(rise))(at))
    true = exact.heated_sphere_sensitivities(SET_S, 4e5, 0.005)
    names = ("conductivity", "perfusion", "radius", "source")
    found = zip(names, gradient, strict=True)
    return {name: float(derivative / true[name]) for name, derivative in found}


def _sensitivities() -> Iterator[Check]:
    for name, ratio in sensitivity_ratios(405).items():
        yield Check(f"sensitivity to {name}, relative", ratio, 1.0, 1e-3, "1")


CASES: dict[str, Callable[[], Iterator[Check]]] = {
    "slabs": _slabs,
    "round": _round,
    "heated spheres": _heated_spheres,
    "two media": _two_media,
    "two shells": _two_shells,
    "point": _point,
    "spots": _spots,
    "lumped": _lumped,
    "rests": rest_checks,
    "interfaces": interface_checks,
    "orders": order_checks,
    "radii": radius_checks,
    "doses": _doses,
    "sensitivities": _sensitivities,
}
"""Each yields its checks."""
