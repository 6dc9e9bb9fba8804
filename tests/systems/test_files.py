"""Systems there and back through TOML, and the gallery of examples."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.defects import told
from tests.forces.examples import FORCES

from pinav import actuation, forces, systems
from pinav.analysis.discovery.candidates import LIBRARY
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.forces.geometries import Center
from pinav.forces.law_library import (
    ANISOTROPIC_TRAP,
    GAUSSIAN,
    LATTICES,
    PLANE_WAVE,
    SADDLE,
    turn,
)
from pinav.forces.laws import ProfileLaw
from pinav.forces.profiles import PROFILES
from pinav.scenarios import SCENARIOS, find_system, scenario
from pinav.trajectories import simulate

GALLERY = Path(__file__).parents[2] / "examples" / "systems"


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_comes_back_exactly(name, tmp_path):
    system = scenario(name)
    systems.write_system(system, tmp_path / "system.toml")
    again = find_system(str(tmp_path / "system.toml"))
    assert eqx.tree_equal(system, again, typematch=True)
    assert systems.system_text(again) == systems.system_text(system)
    assert again.name == name


@pytest.mark.parametrize("path", sorted(GALLERY.glob("*.toml")), ids=lambda p: p.stem)
def test_the_gallery_is_read_comes_back_and_simulates(path):
    system = systems.read_system(path)
    assert eqx.tree_equal(
        systems.parse_system(systems.system_text(system)), system, typematch=True
    )
    short = eqx.tree_at(
        lambda s: (s.starts, s.times), system, (system.starts[:2], system.times[:6])
    )
    data = simulate(short, key=jax.random.key(0))
    assert np.isfinite(data.states).all()
    assert system.units.items() <= data.units.items()
    assert "?" not in data.units.values()


def test_the_own_force_of_the_gallery_is_named_and_comes_back(tmp_path):
    system = find_system(f"{GALLERY / 'own_force.py'}:screened")
    systems.write_system(system, tmp_path / "system.toml")
    assert eqx.tree_equal(systems.read_system(tmp_path / "system.toml"), system)
    data = simulate(eqx.tree_at(lambda s: s.times, system, system.times[:3]), key=KEY)
    assert data.provenance["system"] is None  # data never name code to run


KEY = jax.random.key(5)

IN_PYTHON = "network of position", "network of the paper", "neural potential"
"""Examples of forces that no file can state."""


@pytest.mark.parametrize("name", FORCES)
def test_every_force_comes_back_exactly(name):
    system = scenario("paper").with_truth(FORCES[name]())
    if name in IN_PYTHON:
        with told(r"truth\..* a file|in a file"):
            systems.system_text(system)
        return
    again = systems.parse_system(systems.system_text(system))
    assert eqx.tree_equal(again, system, typematch=True)


LAWS = (
    *LIBRARY,
    *LATTICES,
    ANISOTROPIC_TRAP,
    *(ProfileLaw(PROFILES["Yukawa"], Center(count=count)) for count in (2, 3)),
    turn(PLANE_WAVE),
    SADDLE + GAUSSIAN + turn(GAUSSIAN),
)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_every_law_that_discovery_finds_can_be_stated(law):
    constants = jnp.linspace(0.5, 2.5, len(law.constants))
    system = scenario("paper").with_truth(forces.LawForce(law, constants))
    again = systems.parse_system(systems.system_text(system))
    assert eqx.tree_equal(again, system, typematch=True)


def test_a_profile_is_no_law_of_a_geometry_that_it_is_not_made_for():
    """A ring about a line would be a layer beside it."""
    with told("there is no law 'ring layer' of 5 constants"):
        forces.LawForce.of("ring layer", jnp.ones(5))


RULES = (
    systems.RingStarts(center=(0.1, 0.2), radius=3.0, spread=1.0, speeds=(1.0, 2.0)),
    systems.UniformStarts(lower=(0.0, 0.0), upper=(0.3, 1.0), count=3, seed=4),
)
THIRD, POINT = 1 / 3, jnp.array([1e6 / 3, -1e-300])
BARRIER = forces.GaussianBarrier(-1e6 / 3, POINT, THIRD)
HELD = actuation.HeldProgramme(jnp.array([0.0, 1.5]), POINT, -POINT)
RESPONSES = (
    (actuation.LinearResponse(), None),
    (actuation.SaturatingResponse(THIRD), HELD),
    (actuation.StepOutResponse(THIRD), None),
    (actuation.SlippingResponse(THIRD, 0.05), HELD),
)
PROPULSIONS = [
    forces.RollingPropulsion(jnp.stack([POINT, 2 * POINT]), response, programme, THIRD)
    for response, programme in RESPONSES
]
BOTH = forces.SumForce((BARRIER, forces.GaussianBarrier(THIRD, -POINT, 1e3)))
IN_FLOW = forces.InFlow(forces.LinearDrag(THIRD), forces.UniformFlow(POINT))
SWIMMERS = [
    Swimmer(PROPULSIONS[0], forces.LinearDrag(THIRD), forces.ZeroForce(), BARRIER),
    Swimmer(forces.ZeroForce(), IN_FLOW, forces.ZeroForce(), BOTH),
    *(
        OverdampedSwimmer(
            propulsion,
            forces.ZeroForce(),
            forces.IsotropicTensor(THIRD),
            forces.UniformFlow(POINT),
            force,
        )
        for propulsion, force in zip(PROPULSIONS, (BARRIER, BOTH) * 2, strict=True)
    ),
]
PRIORS = (systems.Flat(), systems.Normal(-1e6 / 3, 1e-3), systems.LogNormal(THIRD, 1e3))
TIMES = ((), jnp.linspace(0.0, 3.0, 31), jnp.array([0.0, 0.1, 0.3]))
STARTS = {
    order: [
        (None, ()),
        (None, jax.random.normal(KEY, (3, 2 * order))),
        *((rule, rule.draw(order)) for rule in RULES),
        (RULES[0], jax.random.normal(KEY, (3, 2 * order))),
    ]
    for order in (1, 2)
}


@pytest.mark.parametrize("number", range(30))
def test_any_system_comes_back_exactly(number):
    """Each part meets others of another kind; numbers need all of their digits."""
    swimmer = SWIMMERS[number % len(SWIMMERS)]
    first = isinstance(swimmer, OverdampedSwimmer)
    rule, starts = STARTS[1 if first else 2][number % 5]
    system = systems.System(
        name="a \"b\" 'c' \\n é" if number % 2 else "",
        swimmer=swimmer,
        dim=2,
        environment=(None, BARRIER, BOTH)[number // 2 % 3],
        thermal_energy=THIRD if first else None,
        wandering=systems.WanderingVelocity(THIRD, 1e3, 1e-3) if first else None,
        observation=systems.Observation(THIRD, 1e-3),
        starts=starts,
        rule=rule,
        times=TIMES[number % 3],
        base_units=systems.Units("um", "s", "pN"),
        model=("kernel-force", "kernel-potential")[number % 2],
        learn=(systems.FreeNumber("known_force", PRIORS[number // 3 % 3]),)
        * (number % 4 > 0),
    )
    again = systems.parse_system(systems.system_text(system))
    assert eqx.tree_equal(again, system, typematch=True)


def test_dimensions_one_and_three():
    for dim in (1, 3):
        system = systems.System(
            name="beads",
            swimmer=OverdampedSwimmer(forces.ZeroForce(), forces.ZeroForce(), 2.0),
            dim=dim,
            environment=forces.HarmonicTrap(1.0, jnp.arange(float(dim))),
        )
        again = systems.parse_system(systems.system_text(system))
        assert eqx.tree_equal(again, system, typematch=True)
        assert again.channels == ("x", "y", "z")[:dim]


def test_a_wall_is_a_plane_unless_it_says_that_it_is_another_surface():
    text = "dimension = 3\norder = 1\n[mobility]\n" + (
        'kind = "wall-mobility"\nradius = 5.0\nviscosity = 1.0\n[mobility.wall]\n'
    )
    plane = systems.parse_system(text + "normal = [0, 0, 1]\nposition = 2.0")
    assert eqx.tree_equal(
        plane.swimmer.mobility.wall, forces.Plane([0.0, 0.0, 1.0], 2.0)
    )
    tube = 'kind = "tube"\nalong = [1, 0, 0]\nmiddle = [0, 1, 2]\nradius = 40.0'
    found = systems.parse_system(text + tube).swimmer.mobility.wall
    assert eqx.tree_equal(found, forces.Tube([1.0, 0.0, 0.0], [0.0, 1.0, 2.0], 40.0))
    system = scenario("bifurcation")
    again = systems.parse_system(systems.system_text(system))
    assert eqx.tree_equal(again.swimmer.mobility, system.swimmer.mobility)
    assert eqx.tree_equal(again.swimmer.flow, system.swimmer.flow)


def test_numbers_of_several_forces_and_of_a_wall_can_be_learned():
    system = scenario("above-wall")
    paths = ("mobility.wall.position", "known_force.terms[0].excess_density")
    text = (
        systems.system_text(system)
        + "\n[learn]\n"
        + "".join(f'"{path}" = {{kind = "flat"}}\n' for path in paths)
    )
    free = systems.parse_system(text).learn
    assert [number.path for number in free] == list(paths)
    numbers = [float(number.pick(system.swimmer)) for number in free]
    assert numbers == [0.0, 20.0]


def test_what_is_in_words_of_a_laboratory_is_read_and_written():
    text = "dimension = 2\norder = 1\nmobility = 1\n[propulsion]\n" + (
        'kind = "rolling-propulsion"\nspeed = 2.0\nheading_offset = 0.5\n'
        'response = {kind = "slipping-response", corner = 11.7, residual = 0.25}'
    )
    system = systems.parse_system(text)
    rolling = system.swimmer.propulsion
    cos, sin = 2 * np.cos(0.5), 2 * np.sin(0.5)
    np.testing.assert_allclose(rolling.gain, [[cos, -sin], [sin, cos]])
    assert eqx.tree_equal(rolling.response, actuation.SlippingResponse(11.7, 0.25))
    assert "corner = 11.7\nresidual = 0.25" in systems.system_text(system)
    bead, water = (
        scenario("brownian"),
        systems.read_system(GALLERY / "trapped_bead.toml"),
    )
    assert water.thermal_energy == bead.thermal_energy
    assert water.diffusion == pytest.approx(bead.diffusion)
    text = systems.system_text(bead).replace(
        f"energy = {bead.thermal_energy!r}", "diffusion = 0.5"
    )
    assert systems.parse_system(text).diffusion == pytest.approx(0.5)


def test_that_a_force_decays_is_read_and_written():
    system = dataclasses.replace(scenario("box"), decays=True)
    text = systems.system_text(system)
    assert "decays = true" in text
    assert systems.parse_system(text).decays
    assert not systems.parse_system(text.replace("true", "false")).decays


def test_kernels_can_be_stated_and_a_network_stays_in_python(tmp_path):
    kernels = forces.KernelPotential(jnp.array([1.0, 2.0]), jnp.eye(2), 0.5)
    system = scenario("paper").with_truth(kernels)
    assert eqx.tree_equal(systems.parse_system(systems.system_text(system)), system)
    system = scenario("paper").with_truth(forces.paper_force(jax.random.key(0)))
    with told("truth.network: MLP of the module equinox.nn._mlp cannot"):
        systems.write_system(system, tmp_path / "system.toml")
    assert isinstance(system.environment, forces.NeuralForce)
    assert not list(tmp_path.iterdir())


def test_priors_are_normal_in_their_standardised_value():
    for prior, values in (
        (systems.Normal(0.4, 0.1), [0.4, 0.5, 0.2]),
        (systems.LogNormal(0.4, 0.1), 0.4 * np.exp([0.0, 0.1, -0.2])),
    ):
        scores = [float(prior.standard_score(value)) for value in values]
        np.testing.assert_allclose(scores, [0.0, 1.0, -2.0], atol=1e-12)
    assert float(systems.Flat().standard_score(3.0)) == 0.0
    rule = systems.CoastingStarts(lower=(0.0, 0.0), upper=(1.0, 1.0), damping=0.3)
    with told("coasting needs inertia"):
        rule.draw(1)
