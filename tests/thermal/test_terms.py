"""Each term of the heat equation beside the others, and what plans are made of."""

import dataclasses
import itertools
from dataclasses import MISSING

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from tests import heat_cases
from tests.heat_cases import small
from tests.samples import stand_in

from pinav.evaluation import normal_quantile
from pinav.thermal import design, quantities
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import (
    BOUNDARIES,
    Dirichlet,
    Insulated,
    Periodic,
    Robin,
    Sides,
)
from pinav.thermal.case import read_case
from pinav.thermal.dose import LIVER_DAMAGE
from pinav.thermal.grids import CartesianGrid, RadialGrid
from pinav.thermal.learned_tissue import Forecast
from pinav.thermal.learning import PerfusionCurve
from pinav.thermal.perfusion import TabulatedPerfusion
from pinav.thermal.planned_run import tissue_beyond
from pinav.thermal.protocols import HfLimit, Piecewise, plan_steps
from pinav.thermal.readings import Readings
from pinav.thermal.setup import Setup
from pinav.thermal.solve import Solution, solve
from pinav.thermal.sources import PowerSource
from pinav.thermal.starts import HeatState
from pinav.thermal.steppers import RKL2, Rosenbrock
from pinav.thermal.tissue_fit import (
    TissueFit,
    describe_constant,
    mean_perfusion,
    quantities_of,
)
from pinav.thermal.tissues import Blood, Tissue

RNG = np.random.default_rng(8)
BLOOD = Blood(1060.0, 3600.0, 36.5)
PROTOCOL = Piecewise.ramp([0.0, 20.0, 30.0], [4e3, 1e4, 6e3], 1e5)
FLOW = ((30.0, 42.0, 60.0), (0.8, 3.0, 1.0))


def plane(shape):
    """A plane that is periodic along x, between a film and a wall."""
    sides = (Periodic(), Sides(Robin(90.0, 21.0), Dirichlet(34.0)))
    grid = CartesianGrid(shape, (2e-3, 1.5e-3))
    return grid, sides, np.full(shape, 3e-6)


def ball(shape):
    """A ball that is cooled by a film."""
    grid, sides = (
        RadialGrid.sphere(0.012, shape[0]),
        Sides(Insulated(), Robin(90.0, 21.0)),
    )
    edges = np.linspace(0, 0.012, shape[0] + 1)
    return grid, (sides,), 4 * np.pi / 3 * np.diff(edges**3)


def exchange(shape, k):
    """Conductances [W/K] between cells, and to what is outside with its warmth."""
    inner, outer = [], []
    at = np.arange(k.size).reshape(shape)
    if len(shape) == 1:
        h = 0.012 / shape[0]
        areas = 4 * np.pi * (h * np.arange(1, shape[0] + 1)) ** 2
        for i in range(shape[0] - 1):
            inner.append((i, i + 1, areas[i] / (h / 2 / k[i] + h / 2 / k[i + 1])))
        outer.append((shape[0] - 1, areas[-1] / (1 / 90 + h / 2 / k[-1]), 21.0))
        return inner, outer
    flat, (nx, ny) = k.ravel(), shape
    for i in range(nx):
        for j in range(ny):
            a, b = at[i, j], at[(i + 1) % nx, j]
            inner.append((a, b, 1.5e-3 / (1e-3 / flat[a] + 1e-3 / flat[b])))
            if j + 1 < ny:
                b = at[i, j + 1]
                inner.append((a, b, 2e-3 / (0.75e-3 / flat[a] + 0.75e-3 / flat[b])))
        outer.append((at[i, 0], 2e-3 / (1 / 90 + 0.75e-3 / k[i, 0]), 21.0))
        outer.append((at[i, -1], 2e-3 / (0.75e-3 / k[i, -1]), 34.0))
    return inner, outer


@pytest.mark.parametrize(
    ("make", "shape", "stepper"),
    [(plane, (3, 4), RKL2(5, 0.25)), (ball, (5,), Rosenbrock(0.25))],
    ids=["plane", "ball"],
)
def test_a_run_with_every_term_is_that_of_another_solver(make, shape, stepper):
    grid, sides, volumes = make(shape)
    k, rho, c, metabolic, power = (
        size * RNG.uniform(0.5, 1.5, shape) for size in (0.5, 1000, 3500, 5e3, 2e5)
    )
    tissue = Tissue(*map(jnp.asarray, (k, rho, c, metabolic)))
    flow = TabulatedPerfusion(FLOW[0], jnp.asarray(FLOW[1]))
    source = PowerSource(jnp.asarray(power), 1e4, 0.7)
    model = Bioheat(grid, tissue, BLOOD, flow, (source,), sides)
    inner, outer = exchange(shape, k)
    start = RNG.uniform(35, 40, shape)

    def amplitude(t):
        return np.interp(t, [0, 20, 30], [4e3, 1e4, 6e3])

    def flows(t, at):
        heat = metabolic + 0.7 * power * (amplitude(t) / 1e4) ** 2
        taken = 3600 * np.interp(at, *FLOW) * (at - 36.5)
        return (heat * volumes.reshape(shape)).ravel(), taken.ravel() * volumes.ravel()

    def rates(t, at):
        brought, taken = flows(t, at.reshape(shape))
        gain, lost = brought - taken, 0.0
        for a, b, g in inner:
            gain[a] += g * (at[b] - at[a])
            gain[b] -= g * (at[b] - at[a])
        for a, g, warmth in outer:
            gain[a] -= g * (at[a] - warmth)
            lost += g * (at[a] - warmth)
        return gain / (rho * c).ravel() / volumes.ravel(), (
            *map(sum, (brought, taken)),
            lost,
        )

    exact = solve_ivp(
        lambda t, y: np.append(*rates(t, y[: k.size])),
        (0, 30),
        np.append(start.ravel(), np.zeros(3)),
        t_eval=[20.0, 30.0],
        max_step=0.5,
        rtol=1e-9,
    )
    run = solve(
        model,
        PROTOCOL,
        stepper=stepper,
        save_at=[20.0, 30.0],
        start=HeatState.at(jnp.asarray(start)),
        damage=LIVER_DAMAGE,
    )
    assert np.allclose(
        np.asarray(run.observed).reshape(2, -1), exact.y[: k.size].T, atol=3e-4
    )
    energy = [run.energy.brought, run.energy.perfused, run.energy.lost]
    assert np.allclose(energy, exact.y[k.size :, -1], rtol=1e-3)
    change = (np.asarray(run.final.temperature) - start) * rho * c
    stored = (change * volumes.reshape(shape)).sum()
    assert np.isclose(float(run.energy.stored), stored)
    assert np.isclose(energy[0] - energy[1] - energy[2], stored, rtol=1e-4)
    assert float(run.energy.imbalance) < 1e-10
    assert float(run.final.time) == 30.0


def test_steps_end_where_the_field_switches_and_where_it_is_watched():
    schedule = plan_steps(PROTOCOL, 8.0, save_at=[5.0, 30.0], start=2.0)
    used = schedule.steps > 0
    starts, steps = schedule.starts[used], schedule.steps[used]
    expected = [2, 5, 12.5, 20, 25]
    assert starts.tolist() == expected
    assert (starts + steps).tolist() == [*expected[1:], 30]
    assert schedule.intervals[used].tolist() == [0, 0, 0, 1, 1]
    assert (
        (starts + steps)[schedule.saved].tolist() == schedule.times.tolist() == [5, 30]
    )
    assert np.allclose(PROTOCOL.amplitude(jnp.asarray(25.0), jnp.asarray(1)), 8e3)
    assert PROTOCOL.until(20.0).edges == (0.0, 20.0)
    assert PROTOCOL.largest == 1e4


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    """A ball of the examples, with two numbers to be learned."""
    folder = tmp_path_factory.mktemp("case")
    learn = {"kind": "constant", "power_scale": True}
    return folder, Setup.read(small("tumour", folder, {"learn": learn}))


def test_the_numbers_of_a_plan_act_on_field_and_particles(setup):
    _, of_case = setup
    kept = Piecewise.constant([0, 1, 2, 3], [1e3, 2e3, 3e3], 2e5)
    run = design.Run(of_case.model, kept)
    free = design.free_amplitudes(8e3, 2, 0.5, before=1)
    assert np.allclose(free.start, 0.25)
    changed = free.apply(jnp.array([0.25, 1.0]), run).protocol
    assert np.allclose(changed.starts, [1e3, 4e3, 8e3])
    assert np.allclose(changed.ends, changed.starts)
    scaled = design.free_scale(2.0).apply(jnp.array([0.25]), run).protocol
    assert np.allclose(scaled.ends, [500, 1000, 1500])
    limit = design.limit_constraint(HfLimit(4e8))
    assert np.allclose(limit.quantity(run, None), [2e8, 4e8, 6e8])
    assert np.allclose(limit.excess(jnp.asarray([2e8, 6e8])), [-0.5, 0.5])
    volumes = of_case.model.grid.volumes
    shells = design.shells(of_case.model, 0.01, 3, 7.0)
    assert np.allclose(shells.reshape(3, -1) @ volumes.ravel(), 7.0)
    centers = np.asarray(of_case.model.grid.distances())
    width = of_case.model.grid.cell_sizes[0]
    for index, shell in enumerate(np.asarray(shells)):
        seen = centers[shell > 0]
        assert seen.min() > index * 0.01 / 3 - width
        assert seen.max() < (index + 1) * 0.01 / 3 + width
    moved = design.free_placement(shells)
    alone = moved.apply(jnp.array([1.0, 0.0, 0.0]), run).model.sources[0]
    even = moved.apply(jnp.full(3, 0.3), run).model.sources[0]
    grid = of_case.model.grid
    assert np.allclose(alone.shape(grid), shells[0], atol=1e-3 * float(shells[0].max()))
    assert np.allclose(even.shape(grid), shells.mean(axis=0))
    assert np.isclose(even.level(1e4, 1e5), of_case.model.sources[0].level(1e4, 1e5))


def test_doses_are_bounded_by_their_logarithm():
    run = stand_in(design.Run)
    dose = jnp.array([9.0, 30.0, 4.0])
    final = HeatState(jnp.asarray(1.0), dose, dose)
    end = stand_in(Solution, hottest=jnp.array([41.0, 44.0]), final=final)
    healthy = design.healthy_dose(2.0, jnp.array([0.4, 0.5, 0.6]))
    assert float(healthy.quantity(run, end)) == 4.0
    assert np.isclose(healthy.excess(jnp.asarray(4.0)), np.log(2))
    hottest = design.max_temperature(43.0)
    assert np.allclose(hottest.excess(hottest.quantity(run, end)), [-2, 1])


def test_tissue_beyond_a_margin_is_counted_from_the_rim(setup, tmp_path):
    _, of_ball = setup
    far = np.asarray(tissue_beyond(of_ball, 0.003))
    distance = np.asarray(of_ball.model.grid.distances()) - of_ball.body.radius
    half = of_ball.model.grid.cell_sizes[0] / 2
    assert np.all(far[distance > 0.003 + half] == 1)
    assert np.all(far[distance < 0.003 - half] == 0)
    case = heat_cases.write(
        tmp_path, heat_cases.voxels(), {"labels.npy": heat_cases.LABELS}
    )
    of_voxels = Setup.read(case)
    inside = np.argwhere(heat_cases.LABELS == 4)
    far = np.asarray(tissue_beyond(of_voxels, 0.0031))
    for place in np.ndindex(heat_cases.SHAPE):
        steps = (inside - place) * heat_cases.SIZE
        away = np.linalg.norm(steps, axis=1).min() - 1e-3 >= 0.0031
        assert far[place] == (away and heat_cases.LABELS[place] != 4)


def test_learned_numbers_are_named_and_are_those_of_the_model(setup):
    folder, of_case = setup
    fit = TissueFit.of(read_case(folder / "tumour.toml")[0], of_case, folder)
    names, values = quantities_of(fit)
    source, grid = of_case.model.sources[0], of_case.model.grid
    amplitude = of_case.protocol.largest
    density = np.asarray(source.shape(grid) * source.level(amplitude, 1e5))
    known = np.asarray(values(of_case.model))
    assert names[-1] == "power of the source [W]"
    assert np.isclose(known[-1], (density * np.asarray(grid.volumes)).sum())
    rest = [mean_perfusion(of_case, name, of_case.arterial) for name in fit.names]
    assert np.allclose(known[:-1], rest)
    first, second = fit.names
    for path, words in {
        "perfusion.laws[1].value": f"perfusion of {second} [kg/(m³ s)]",
        "perfusion.laws[0].log_level": f"log perfusion of {first}",
        "sources[0].shift[1]": "shift of the spot along y [m]",
        "sources[0].scale": "factor of the power",
    }.items():
        assert describe_constant(path, of_case) == words


def test_a_forecast_is_judged_after_the_fit_alone():
    values = np.array([[40.0], [41.0], [42.0], [43.0]])
    off = np.array([[9.0], [9.0], [1.9], [2.0]])
    told = Forecast(np.arange(1.0, 5.0), values, np.ones((4, 1)), 2.0, values + off)
    assert told.error == 2.0
    assert told.covered == 0.5
    assert told.largest_sd == 1.0
    sd = np.array([0.1, 0.1, 0.1])
    true = 2 * np.exp([0.195, -0.195, 0.2])
    curve = PerfusionCurve(
        np.array([37.0, 40.0, 43.0]), np.full(3, 2.0), sd, (37.0, 43.0), true
    )
    assert np.isclose(curve.covered, 2 / 3)
    assert np.allclose(
        np.log(curve.band / 2), np.outer([-1, 1], normal_quantile() * sd)
    )
    shorter = PerfusionCurve(curve.temperatures, curve.values, sd, (37.0, 40.0), true)
    assert shorter.covered == 1.0


def test_readings_count_in_units_of_their_noise():
    values = np.array([[37.0, 40.0], [41.0, np.nan]])
    data = Readings(np.array([1.0, 2.0]), values, noise=np.array([0.5, 2.0]))
    assert np.isclose(data.spread, np.std([74.0, 20.0, 82.0]))
    assert data.until(1.0).values.tolist() == [[37.0, 40.0]]


def test_the_rate_of_damage_follows_a_temperature_that_changes():
    harm = float(LIVER_DAMAGE.segment(jnp.asarray(45.0), jnp.asarray(45.4), 10.0))
    exact, _ = quad(
        lambda t: float(LIVER_DAMAGE.rate(jnp.asarray(45 + 0.04 * t))), 0, 10
    )
    assert np.isclose(harm, exact, rtol=1e-7)


@pytest.mark.parametrize(
    ("numbers", "taken", "refused"),
    [
        (quantities.Length, 10, 0),
        (quantities.Time, 1e7, 0),
        (quantities.Reference, 1e6, 0),
        (quantities.Conductivity, 1e3, 0),
        (quantities.Exchange, 1e6, 0),
        (quantities.Fraction, 1, 0),
        (quantities.Siemens, 100, 0),
        (quantities.Amplitude, 0, -1e-9),
        (quantities.Metabolic, 0, -1e-9),
        (quantities.Noise, 0, 100.1),
        (quantities.Arterial, 10, 9.9),
        (quantities.Density, 50, 49.9),
        (quantities.SpecificHeat, 10, 9.9),
        (quantities.Frequency, 1e3, 999),
        (quantities.Cells, 3, 2),
    ],
    ids=str,
)
def test_ranges_hold_their_bounds(numbers, taken, refused):
    assert quantities.within("it", numbers, taken) == taken
    with pytest.raises(ValueError, match="it: "):
        quantities.within("it", numbers, refused)


@pytest.mark.parametrize("pair", list(itertools.combinations(BOUNDARIES, 2)))
def test_the_keys_of_a_side_tell_its_boundary(pair):
    """`read_module` takes the first class whose fields the keys of a table name."""
    fields = [dataclasses.fields(kind) for kind in pair]
    needed = {f.name for part in fields for f in part if f.default is MISSING}
    both = set.intersection(*({f.name for f in part} for part in fields))
    assert needed - both or not any(fields)
