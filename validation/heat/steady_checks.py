"""Steady states, sides and interfaces against exact solutions, and their orders."""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from validation.heat import exact
from validation.heat.checks import AMPLITUDE, Check, checks_at, reference_model
from validation.heat.exact import SET_S, Medium

from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import Dirichlet, Periodic, Robin, Sides, outer
from pinav.thermal.grids import CartesianGrid, RadialGrid
from pinav.thermal.perfusion import ConstantPerfusion
from pinav.thermal.solve import probes_at
from pinav.thermal.sources import PowerSource
from pinav.thermal.starts import steady_state
from pinav.thermal.tissues import Blood, Tissue, mix

Comparison = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Points [m], rises there by the solver [K], and the exact ones."""


def _slab(count: int) -> Comparison:
    """A perfused slab, one end insulated, the other at the temperature of blood."""
    points = np.array([0.0, 0.01, 0.02])
    slab = reference_model(RadialGrid.slab(0.03, count), 2e4)
    rise = probes_at(slab, points)(steady_state(slab, AMPLITUDE).temperature) - 37.0
    true = exact.perfused_slab(points, np.inf, SET_S, 2e4, 0.03)
    return points, np.asarray(rise), np.asarray(true)


def _strip(count: int) -> Comparison:
    """Skin: cooled on one side, at the temperature of blood on the other, periodic."""
    grid = CartesianGrid.cubes((count, 3), 0.03 / count)
    fluid = Sides(Robin(10.0, 25.0), Dirichlet(37.0))
    strip = reference_model(grid, 420.0, (fluid, Periodic()), 0.525)
    half = Medium(0.5, SET_S.capacity, 0.5 * SET_S.perfusion)
    places = np.array([0, 20 * count // 64, 40 * count // 64])
    points = (places + 0.5) * 0.03 / count
    true = exact.skin(points, half, 420.0, 0.03, 10.0, 25.0) - 37.0
    rise = steady_state(strip, AMPLITUDE).temperature[places, 1] - 37.0
    return points, np.asarray(rise), np.asarray(true)


def _jump(fraction: float, count: int = 400) -> Comparison:
    """A heated ball with a third of the conductivity of what is around it.

    Args:
        fraction: of a cell, by which its surface is beyond a face.
        count: of cells; a tenth of them is in the ball.
    """
    radius = 3.15e-3
    media = Medium(0.2, 1660.0 * 2540.0), Medium(0.642, 3.72e6)
    end = radius / (count / 10 + fraction) * count
    grid = RadialGrid.sphere(end, count)
    ball = grid.ball(radius)
    tissues = Tissue(0.2, 1660.0, 2540.0), Tissue(0.642, 1000.0, 3720.0)
    model = Bioheat(
        grid,
        mix((ball, 1 - ball), tissues),
        Blood(),
        ConstantPerfusion(0.0),
        (PowerSource(6.15e5 * ball, AMPLITUDE),),
        outer(Dirichlet(37.0)),
    )
    points = radius + np.array([-0.6, 0.0, 0.6]) * end / count
    rise = probes_at(model, points)(steady_state(model, AMPLITUDE).temperature) - 37.0
    true = [
        exact.two_conductivities(
            float(r), np.inf, *media, 6.15e5, radius, outer_radius=end
        )
        for r in points
    ]
    return points, np.asarray(rise), np.asarray(true)


def rest_checks() -> Iterator[Check]:
    """The solver of steady states; a cooled and a periodic side."""
    yield from checks_at("perfused slab, steady solver", *_slab(320), 1e-4)
    yield from checks_at("skin of a periodic strip, steady", *_strip(64), 1e-3)


def interface_checks() -> Iterator[Check]:
    """Temperatures beside a threefold jump of the conductivity, wherever it lies."""
    for fraction in (0.0, 0.3, 0.5):
        name = f"beside a jump, {fraction:g} of a cell from a face"
        yield from checks_at(name, *_jump(fraction), 4e-3)


def order_checks() -> Iterator[Check]:
    """By what power of two the largest error falls with cells of half the size."""
    cases: dict[str, tuple[Callable[[int], Comparison], int]] = {
        "steady solver": (_slab, 40),
        "cooled and periodic sides": (_strip, 32),
        "beside a jump, in a cell": (lambda count: _jump(0.5, count), 200),
    }
    for name, (compare, count) in cases.items():
        coarse, fine = (
            float(np.abs(rise - true).max())
            for _, rise, true in (compare(count), compare(2 * count))
        )
        order = float(np.log2(coarse / fine))
        yield Check(f"order in space, {name}", order, 2.0, 0.1, "1")


def radius_checks() -> Iterator[Check]:
    """By the radius of a heated ball, with its surface on a face, near one, and in."""
    true = exact.heated_sphere_sensitivities(SET_S, 4e5, 0.005)["radius"]
    for fraction in (0.0, 1e-9, 0.1, 0.5, 0.75):
        end = 0.005 / (20 + fraction) * 200

        def rise(radius: Array, end: float = end) -> Array:
            grid = RadialGrid.sphere(end, 200)
            model = reference_model(grid, 4e5 * grid.ball(radius))
            return (
                grid.interpolation([0.0])[0]
                @ steady_state(model, AMPLITUDE).temperature
            )

        ratio = float(jax.grad(rise)(jnp.asarray(0.005)) / true)
        name = f"sensitivity to a radius {fraction:g} of a cell from a face, relative"
        yield Check(name, ratio, 1.0, 2e-3, "1")
