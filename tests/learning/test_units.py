"""The unit of a learned constant is that of its field."""

import dataclasses
import re

import jax.numpy as jnp
import pytest

import pinav.actuation
import pinav.dynamics
import pinav.forces
import pinav.systems
from pinav import forces
from pinav.actuation import SaturatingResponse
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.fitting import Estimate
from pinav.fitting.environments.summary import ModelChoice
from pinav.forces.fitted_laws import FittedLaw
from pinav.learning.evidence import with_unit, with_units
from pinav.systems import System, Units
from pinav.units import unit_of

SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def stated(field):
    """The dimension of a field, where it does not depend on what the field holds."""
    dimension = field.metadata.get("dimension")
    return dimension if isinstance(dimension, str) else None


CLASSES = {
    name: kind
    for module in (pinav.forces, pinav.actuation, pinav.dynamics, pinav.systems)
    for name, kind in sorted(vars(module).items())
    if isinstance(kind, type)
    and dataclasses.is_dataclass(kind)
    and any(stated(field) for field in dataclasses.fields(kind))
}


@pytest.mark.parametrize("kind", CLASSES.values(), ids=CLASSES)
def test_the_dimension_of_a_field_is_that_of_its_description(kind):
    """Both stand in the class: a reader sees one, a table the other."""
    for field in dataclasses.fields(kind):
        if stated(field):
            _, _, text = kind.__doc__.partition(f"        {field.name}: ")
            described = re.split(r"\n {8}\w+: |\n\n", text)[0]
            brackets = re.findall(r"\[([^\]]+)\]", described.translate(SUPERSCRIPTS))
            described = [one.removesuffix(" per cycle") for one in brackets]
            assert stated(field) in described, field.name


@pytest.mark.parametrize(
    ("dimension", "unit"),
    [
        ("L2 T-1", "um² s⁻¹"),
        ("rad T-1", "rad s⁻¹"),
        ("L T-1 Hz^(-1/4)", "um s⁻¹ Hz^(-1/4)"),
        ("F L", "pN um"),
        ("L L-1", "1"),
        ("1", "1"),
        ("?", "?"),
    ],
)
def test_symbols_become_the_units_of_the_data(dimension, unit):
    assert unit_of(dimension, {"L": "um", "T": "s", "F": "pN"}) == unit
    bare = unit_of(dimension, {"L": "1", "T": "1", "F": "1"})
    assert bare in ("1", "?", "rad", "Hz^(-1/4)")


def units(system, swimmer, *paths):
    choice = ModelChoice(learn=paths)
    estimates = dict.fromkeys(paths, Estimate(1.0, 0.1))
    found = with_units(estimates, choice, swimmer, system)
    return [one.unit for one in found.values()]


def test_constants_of_a_swimmer_with_inertia():
    thrust = forces.ConstantForce((1.0, 0.0))
    swimmer = Swimmer(thrust, forces.LinearDrag(1.0), forces.ZeroForce())
    system = System("a", swimmer, 2, base_units=Units("um", "s"))
    names = ("damping", "propulsion.force", "diffusion", "wandering.driven", "odd")
    expected = ["s⁻¹", "um s⁻²", "um² s⁻¹", "um s⁻¹ Hz^(-1/4)", "?"]
    assert units(system, swimmer, *names) == expected


@pytest.mark.parametrize(("force", "height"), [("pN", "pN um"), ("1", "um² s⁻¹")])
def test_constants_of_a_swimmer_without_inertia(force, height):
    known = forces.SumForce((forces.GaussianBarrier(1.0, (0.0, 0.0), 1.0),))
    swimmer = OverdampedSwimmer(
        forces.RollingPropulsion([[2.0, 0.0], [0.0, 2.0]], SaturatingResponse(3.0)),
        forces.ZeroForce(),
        1.0,
        known_force=known,
    )
    system = System("a", swimmer, 2, base_units=Units("um", "s", force))
    names = ("known_force.terms[0].height", "propulsion.gain", "propulsion.delay")
    assert units(system, swimmer, *names) == [height, "um", "s"]
    assert units(system, swimmer, "propulsion.response.corner") == ["Hz"]


def test_numbers_of_a_structure_have_the_units_of_the_data():
    swimmer = Swimmer(forces.ZeroForce(), forces.LinearDrag(1.0), forces.ZeroForce())
    system = System("a", swimmer, 2, base_units=Units("um", "s"))
    law = FittedLaw("ring", (3.0, 0.1, 0.2))
    terms = (
        forces.CentralTerm(jnp.ones(1), jnp.ones(2), jnp.zeros(0), 1.0, law=law),
        forces.WallTerm(jnp.ones(1), 0.3, jnp.ones(2), jnp.zeros(0), 1.0),
        forces.LatticeTerm(jnp.ones(12), jnp.eye(2), jnp.zeros(2)),
    )
    units = [
        [with_unit(Estimate(1.0, 0.1), one, system).unit for one in dimensions]
        for dimensions in (law.dimensions, *(term.dimensions for term in terms))
    ]
    assert units == [["um", "um", "1"], ["um"] * 2, ["rad"], ["rad um⁻¹"] * 4]


def test_constants_of_a_law_have_its_units():
    known = forces.SumForce((forces.ring_barrier(1.0, (0.0, 0.0), 2.0, 0.5),))
    swimmer = OverdampedSwimmer(
        forces.ZeroForce(), forces.ZeroForce(), 1.0, known_force=known
    )
    system = System("a", swimmer, 2, base_units=Units("um", "s", "pN"))
    names = [f"known_force.terms[0].constants[{index}]" for index in range(5)]
    assert units(system, swimmer, *names) == ["pN um", "um", "um", "um", "um"]
    assert units(system, swimmer, "known_force.terms[0].constants") == ["?"]
