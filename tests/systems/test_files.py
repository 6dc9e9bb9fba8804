"""Systems there and back through TOML, and the gallery of examples."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.forces.examples import FORCES

from pinav.actuation import (
    HeldProgramme,
    LinearResponse,
    SaturatingResponse,
    SlippingResponse,
    StepOutResponse,
)
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.forces import (
    GaussianBarrier,
    HarmonicTrap,
    InFlow,
    IsotropicTensor,
    KernelPotential,
    LinearDrag,
    NeuralForce,
    Plane,
    RollingPropulsion,
    SumForce,
    Tube,
    UniformFlow,
    ZeroForce,
    paper_force,
)
from pinav.scenarios import SCENARIOS, find_system, scenario
from pinav.systems import (
    CoastingStarts,
    Flat,
    FreeNumber,
    LogNormal,
    Normal,
    Observation,
    RingStarts,
    System,
    UniformStarts,
    Units,
    WanderingVelocity,
    parse_system,
    read_system,
    system_text,
    write_system,
)
from pinav.trajectories import simulate

GALLERY = Path(__file__).parents[2] / "examples" / "systems"


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_comes_back_exactly(name, tmp_path):
    system = scenario(name)
    write_system(system, tmp_path / "system.toml")
    again = find_system(str(tmp_path / "system.toml"))
    assert eqx.tree_equal(system, again, typematch=True)
    assert system_text(again) == system_text(system)
    assert again.name == name


@pytest.mark.parametrize("path", sorted(GALLERY.glob("*.toml")), ids=lambda p: p.stem)
def test_the_gallery_is_read_comes_back_and_simulates(path):
    system = read_system(path)
    assert eqx.tree_equal(parse_system(system_text(system)), system, typematch=True)
    short = eqx.tree_at(
        lambda s: (s.starts, s.times), system, (system.starts[:2], system.times[:6])
    )
    data = simulate(short, key=jax.random.key(0))
    assert np.isfinite(data.states).all()
    assert system.units.items() <= data.units.items()
    assert "?" not in data.units.values()


def test_the_own_force_of_the_gallery_is_named_and_comes_back(tmp_path):
    system = find_system(f"{GALLERY / 'own_force.py'}:screened")
    write_system(system, tmp_path / "system.toml")
    assert eqx.tree_equal(read_system(tmp_path / "system.toml"), system)
    data = simulate(eqx.tree_at(lambda s: s.times, system, system.times[:3]), key=KEY)
    assert data.provenance["system"] is None  # data never name code to run


KEY = jax.random.key(5)

IN_PYTHON = "network of position", "network of the paper", "neural potential"
"""Examples of forces that no file can state."""


@pytest.mark.parametrize("name", FORCES)
def test_every_force_comes_back_exactly(name):
    system = scenario("paper").with_truth(FORCES[name]())
    if name in IN_PYTHON:
        with pytest.raises(InputError, match=r"truth\..* a file|in a file"):
            system_text(system)
        return
    again = parse_system(system_text(system))
    assert eqx.tree_equal(again, system, typematch=True)


numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
positive = st.floats(1e-3, 1e3)
point = st.tuples(numbers, numbers).map(lambda pair: jnp.array(pair))
barriers = st.builds(GaussianBarrier, numbers, point, positive)
forces = barriers | st.lists(barriers, min_size=2, max_size=3).map(
    lambda terms: SumForce(tuple(terms))
)
zero = st.just(ZeroForce())
responses = st.one_of(
    st.just(LinearResponse()),
    st.builds(SaturatingResponse, positive),
    st.builds(StepOutResponse, positive),
    st.builds(SlippingResponse, positive, st.floats(0.05, 0.95)),
)
propulsions = zero | st.builds(
    RollingPropulsion,
    st.tuples(point, point).map(jnp.stack),
    responses,
    st.none() | st.builds(HeldProgramme, st.just(jnp.array([0.0, 1.5])), point, point),
    positive,
)
flows = st.builds(UniformFlow, point)
drags = st.builds(LinearDrag, positive)
inert = st.builds(
    Swimmer, propulsions, drags | st.builds(InFlow, drags, flows), zero, forces
)
overdamped = st.builds(
    OverdampedSwimmer,
    propulsions,
    zero,
    st.builds(IsotropicTensor, positive),
    flows,
    forces,
)
priors = st.one_of(
    st.just(Flat()),
    st.builds(Normal, numbers, positive),
    st.builds(LogNormal, positive, positive),
)
RULES = (
    RingStarts(center=(0.1, 0.2), radius=3.0, spread=1.0, speeds=(1.0, 2.0)),
    UniformStarts(lower=(0.0, 0.0), upper=(0.3, 1.0), count=3, seed=4),
)
STARTS = {
    order: [
        (None, ()),
        (None, jax.random.normal(KEY, (3, 2 * order))),
        *((rule, rule.draw(order)) for rule in RULES),
        (RULES[0], jax.random.normal(KEY, (3, 2 * order))),
    ]
    for order in (1, 2)
}
times = st.one_of(
    st.just(()),
    st.just(jnp.linspace(0.0, 3.0, 31)),
    st.just(jnp.array([0.0, 0.1, 0.3])),
)


@st.composite
def systems(draw):
    swimmer = draw(st.one_of(inert, overdamped))
    first = isinstance(swimmer, OverdampedSwimmer)
    order = 1 if first else 2
    rule, starts = draw(st.sampled_from(STARTS[order]))
    learn = draw(st.lists(priors, max_size=1))
    return System(
        name=draw(st.text(st.characters(codec="utf-8", exclude_categories=["C"]))),
        swimmer=swimmer,
        dim=2,
        environment=draw(st.one_of(st.none(), forces)),
        thermal_energy=draw(positive) if first else None,
        wandering=draw(st.builds(WanderingVelocity, positive, positive, positive))
        if first
        else None,
        observation=draw(st.builds(Observation, positive, positive)),
        starts=starts,
        rule=rule,
        times=draw(times),
        base_units=Units("um", "s", "pN"),
        model=draw(st.sampled_from(["kernel-force", "kernel-potential"])),
        learn=tuple(FreeNumber("known_force", prior) for prior in learn),
    )


# Beartype samples the items of containers at random, which changes no value here.
@pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")
@settings(max_examples=15)
@given(systems())
def test_any_system_comes_back_exactly(system):
    again = parse_system(system_text(system))
    assert eqx.tree_equal(again, system, typematch=True)


def test_dimensions_one_and_three():
    for dim in (1, 3):
        system = System(
            name="beads",
            swimmer=OverdampedSwimmer(ZeroForce(), ZeroForce(), 2.0),
            dim=dim,
            environment=HarmonicTrap(1.0, jnp.arange(float(dim))),
        )
        again = parse_system(system_text(system))
        assert eqx.tree_equal(again, system, typematch=True)
        assert again.channels == ("x", "y", "z")[:dim]


def test_a_wall_is_a_plane_unless_it_says_that_it_is_another_surface():
    text = "dimension = 3\norder = 1\n[mobility]\n" + (
        'kind = "wall-mobility"\nradius = 5.0\nviscosity = 1.0\n[mobility.wall]\n'
    )
    plane = parse_system(text + "normal = [0, 0, 1]\nposition = 2.0")
    assert eqx.tree_equal(plane.swimmer.mobility.wall, Plane([0.0, 0.0, 1.0], 2.0))
    tube = 'kind = "tube"\nalong = [1, 0, 0]\nmiddle = [0, 1, 2]\nradius = 40.0'
    found = parse_system(text + tube).swimmer.mobility.wall
    assert eqx.tree_equal(found, Tube([1.0, 0.0, 0.0], [0.0, 1.0, 2.0], 40.0))
    system = scenario("bifurcation")
    again = parse_system(system_text(system))
    assert eqx.tree_equal(again.swimmer.mobility, system.swimmer.mobility)
    assert eqx.tree_equal(again.swimmer.flow, system.swimmer.flow)


def test_numbers_of_several_forces_and_of_a_wall_can_be_learned():
    system = scenario("above-wall")
    paths = ("mobility.wall.position", "known_force.terms[0].excess_density")
    text = (
        system_text(system)
        + "\n[learn]\n"
        + "".join(f'"{path}" = {{kind = "flat"}}\n' for path in paths)
    )
    free = parse_system(text).learn
    assert [number.path for number in free] == list(paths)
    numbers = [float(number.pick(system.swimmer)) for number in free]
    assert numbers == [0.0, 20.0]


def test_friendly_parameters_are_read_and_written():
    text = "dimension = 2\norder = 1\nmobility = 1\n[propulsion]\n" + (
        'kind = "rolling-propulsion"\nspeed = 2.0\nheading_offset = 0.5\n'
        'response = {kind = "slipping-response", corner = 11.7, residual = 0.25}'
    )
    system = parse_system(text)
    rolling = system.swimmer.propulsion
    cos, sin = 2 * np.cos(0.5), 2 * np.sin(0.5)
    np.testing.assert_allclose(rolling.gain, [[cos, -sin], [sin, cos]])
    assert eqx.tree_equal(rolling.response, SlippingResponse(11.7, 0.25))
    assert "corner = 11.7\nresidual = 0.25" in system_text(system)


def test_temperature_radius_and_viscosity_give_noise_and_mobility():
    bead, water = scenario("brownian"), read_system(GALLERY / "trapped_bead.toml")
    assert water.thermal_energy == bead.thermal_energy
    assert water.diffusion == pytest.approx(bead.diffusion)
    text = system_text(bead).replace(
        f"energy = {bead.thermal_energy!r}", "diffusion = 0.5"
    )
    assert parse_system(text).diffusion == pytest.approx(0.5)


def test_a_network_stays_in_python(tmp_path):
    system = scenario("paper").with_truth(paper_force(jax.random.key(0)))
    with pytest.raises(
        InputError, match="truth.network: MLP of the module equinox.nn._mlp cannot"
    ):
        write_system(system, tmp_path / "system.toml")
    assert isinstance(system.environment, NeuralForce)
    assert not list(tmp_path.iterdir())


def test_learned_kernels_can_be_stated():
    kernels = KernelPotential(jnp.array([1.0, 2.0]), jnp.eye(2), 0.5)
    system = scenario("paper").with_truth(kernels)
    assert eqx.tree_equal(parse_system(system_text(system)), system)


def test_priors_are_normal_in_their_standardised_value():
    for prior, values in (
        (Normal(0.4, 0.1), [0.4, 0.5, 0.2]),
        (LogNormal(0.4, 0.1), 0.4 * np.exp([0.0, 0.1, -0.2])),
    ):
        scores = [float(prior.standard_score(value)) for value in values]
        np.testing.assert_allclose(scores, [0.0, 1.0, -2.0], atol=1e-12)
    assert float(Flat().standard_score(3.0)) == 0.0


def test_coasting_starts_need_inertia():
    rule = CoastingStarts(lower=(0.0, 0.0), upper=(1.0, 1.0), damping=0.3)
    with pytest.raises(InputError, match="coasting needs inertia"):
        rule.draw(1)
