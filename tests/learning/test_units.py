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
from pinav.arguments import Scalar, dimension, dimension_of
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
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


LEARNABLE = (
    forces.AbstractForce,
    forces.AbstractFlow,
    forces.AbstractSurface,
    pinav.actuation.AbstractField,
    pinav.actuation.AbstractResponse,
)
"""Parts of a swimmer whose numbers a system may leave open."""

LAID = (forces.AbstractLearnedForce, forces.AbstractTerm)
"""Parts whose numbers are chosen with their weights, and printed with these."""


@pytest.mark.parametrize("module", [pinav.forces, pinav.actuation, pinav.dynamics])
def test_every_number_that_a_system_may_leave_open_states_its_dimension(module):
    kinds = [kind for kind in vars(module).values() if isinstance(kind, type)]
    silent = [
        f"{kind.__name__}.{field.name}"
        for kind in kinds
        if issubclass(kind, LEARNABLE) and not issubclass(kind, LAID)
        for field in dataclasses.fields(kind)
        if field.type == Scalar and "dimension" not in field.metadata
    ]
    assert not silent


def test_the_value_of_a_tensor_has_the_dimension_of_its_place():
    swimmer = OverdampedSwimmer(forces.ZeroForce(), forces.ZeroForce(), 2.0)
    assert dimension_of(swimmer, "mobility.value") == "L T-1 F-1"
    assert dimension_of(swimmer, "propulsion.value") == "?"


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("L2 T-1", "um² s⁻¹"),
        ("rad T-1", "rad s⁻¹"),
        ("L T-1 Hz^(-1/4)", "um s⁻¹ Hz^(-1/4)"),
        ("F L", "pN um"),
        ("L-1/2 T-2", "um^(-1/2) s⁻²"),
        ("L1/2 L^(1/2)", "um"),
        ("L L-1", "1"),
        ("1", "1"),
        ("?", "?"),
    ],
)
def test_symbols_become_the_units_of_the_data(text, unit):
    assert unit_of(text, {"L": "um", "T": "s", "F": "pN"}) == unit
    bare = unit_of(text, {"L": "1", "T": "1", "F": "1"})
    assert bare in ("1", "?", "rad", "Hz^(-1/4)")


@pytest.mark.parametrize("word", ["L^2", "2L", "L2.5", "L1/", "1/s"])
def test_what_is_no_power_is_refused_where_a_class_states_it(word):
    with pytest.raises(
        InputError, match=rf"expected powers .* got {re.escape(repr(word))}"
    ):
        dimension(f"{word} T-1")


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
