"""Laws of all forces, and closed forms of some."""

import dataclasses
import importlib
import inspect
import pkgutil
import types

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.forces.examples import (
    FORCES,
    KEY,
    MIDDLE,
    PLACES,
    TERMS,
    WEIGHTS,
    WIDTH,
    T,
    V,
    X,
    barrier,
    kernel_force,
    kernel_potential,
    propulsion,
)
from tests.refusals import refusals

import pinav
from pinav import forces
from pinav.arguments import point
from pinav.errors import InputError

every_force = pytest.mark.parametrize("make", FORCES.values(), ids=list(FORCES))


def concrete_classes(family):
    """All classes of a family that the package defines and that can be made."""
    for child in family.__subclasses__():
        public = child.__module__.startswith("pinav.") and child.__name__[0] != "_"
        if public and not inspect.isabstract(child):
            yield child
        yield from concrete_classes(child)


PROGRAMS = ("pinav.commands", "pinav.cli", "pinav.regressor")
"""What defines no force, and may need optional packages."""


def test_every_class_of_forces_obeys_the_laws_below():
    for module in pkgutil.walk_packages(pinav.__path__, "pinav."):
        if not module.name.startswith(PROGRAMS):
            importlib.import_module(module.name)
    tried = {type(make()) for make in FORCES.values()}
    written = {
        cls.__name__
        for cls in concrete_classes(forces.AbstractForce)
        if not cls.__module__.startswith(PROGRAMS)
    }
    missing = written - {cls.__name__ for cls in tried}
    assert not missing, "give these classes an example in FORCES"


def test_a_central_force_vanishes_at_its_centre_and_points_away_from_it():
    term = TERMS["central"]()
    np.testing.assert_allclose(term(T, term.center, V), 0.0, atol=1e-12)
    offset = X - term.center
    force = term(T, X, V)
    assert abs(float(force[0] * offset[1] - force[1] * offset[0])) < 1e-12


def test_a_hill_has_the_semi_axes_that_its_shape_says():
    """A Gaussian falls to exp(-1/2) of its height at the end of a semi-axis."""
    size, strain, turn = np.log(1.5), 0.4, 0.7
    shape = [size, -strain * np.cos(2 * turn), -strain * np.sin(2 * turn)]
    weights, center = jnp.array([0.0, 2.0, 0.0]), jnp.array([5.0, 4.0])
    hill = forces.HillsTerm(weights, center[None], jnp.array([shape]))
    along = jnp.array([np.cos(turn), np.sin(turn)])
    across = jnp.array([-np.sin(turn), np.cos(turn)])
    for end in (1.5 * np.exp(0.4) * along, 1.5 * np.exp(-0.4) * across):
        height = hill.potential(T, center + end)
        np.testing.assert_allclose(height, 2.0 * np.exp(-0.5), rtol=1e-6)


def test_a_rotational_term_is_turned_by_a_right_angle():
    plain = TERMS["central"]()
    swirl = dataclasses.replace(plain, rotational=True)
    assert float(jnp.abs(plain(T, X, V) @ swirl(T, X, V))) < 1e-12
    assert (plain.kind, swirl.kind) == ("central", "central swirl")
    with pytest.raises(InputError, match="expected conservative terms"):
        forces.StructuredForce((swirl,), kernel_potential()).potential(T, X)


@every_force
def test_force_is_the_same_under_jit(make):
    force = make()
    expected = force(T, X, V)
    assert expected.shape == X.shape
    assert expected.dtype == X.dtype
    np.testing.assert_allclose(
        eqx.filter_jit(force)(jnp.asarray(T), X, V), expected, atol=1e-14
    )


@every_force
def test_derivatives_agree_with_differences(make):
    force, step = make(), 1e-6

    def along(s):
        return force(T + 0.3 * s, X + s * V, V - s * X)

    slope = jax.jit(lambda s: jax.jvp(along, (s,), (1.0,))[1])(0.0)
    difference = (along(step) - along(-step)) / (2 * step)
    np.testing.assert_allclose(slope, difference, atol=1e-8)


@every_force
def test_vmap_equals_a_loop(make):
    force, ts = make(), jnp.arange(3.0)
    xs, vs = X[None] + jnp.ones((3, 1)), V[None] * ts[:, None]
    looped = [force(t, x, v) for t, x, v in zip(ts, xs, vs, strict=True)]
    together = jax.jit(jax.vmap(force))(ts, xs, vs)
    np.testing.assert_allclose(together, jnp.stack(looped), atol=1e-14)


@every_force
def test_sum_is_commutative_and_has_a_zero(make):
    force, other = make(), barrier()
    expected = force(T, X, V) + other(T, X, V)
    for total in (force + other, other + force, force + forces.ZeroForce() + other):
        assert isinstance(total, forces.SumForce)
        np.testing.assert_allclose(total(T, X, V), expected, atol=1e-14)


def test_sum_is_associative_and_flat():
    a, b, c = forces.LinearDrag(0.3), barrier(), propulsion()
    left, right = (a + b) + c, a + (b + c)
    assert len(left.terms) == len(right.terms) == 3
    np.testing.assert_array_equal(left(T, X, V), right(T, X, V))


def has_potential(force):
    try:
        jax.eval_shape(force.potential, T, X)
    except (AttributeError, InputError):
        return False
    return True


@every_force
def test_a_force_with_a_potential_is_minus_its_gradient_and_has_no_curl(make):
    force = make()
    if has_potential(force):
        expected = -jax.grad(force.potential, argnums=1)(T, X)
        np.testing.assert_allclose(force(T, X, V), expected, rtol=1e-12, atol=1e-12)
        slopes = jax.jacfwd(force, argnums=1)(T, X, V)
        np.testing.assert_allclose(slopes[0, 1], slopes[1, 0], rtol=1e-10, atol=1e-12)


@every_force
def test_a_force_with_a_stream_function_has_no_divergence_and_its_curl(make):
    force = make()
    if hasattr(force, "stream") and not has_potential(force):
        slopes = jax.jacfwd(force, argnums=1)(T, X, V)
        np.testing.assert_allclose(jnp.trace(slopes), 0.0, atol=1e-14)
        laplacian = jnp.trace(jax.hessian(force.stream)(X))
        curl = slopes[1, 0] - slopes[0, 1]
        np.testing.assert_allclose(curl, -laplacian, rtol=1e-12)


def test_barrier_pushes_out_and_a_trap_pulls_in():
    hill, outward = barrier(), X - jnp.array(MIDDLE)
    trap = forces.GaussianBarrier(height=-2.0, center=MIDDLE, width=1.5)
    assert hill(T, X, V) @ outward > 0 > trap(T, X, V) @ outward
    np.testing.assert_allclose(hill.potential(T, jnp.array(MIDDLE)), 2.0)


def test_paper_thrust_is_constant_along_y():
    thrust = jax.vmap(lambda t: propulsion()(t, X, V))(jnp.linspace(0.0, 5.0, 23))
    np.testing.assert_allclose(thrust, jnp.full((23, 2), 0.3) * jnp.array([[0, 1.0]]))


def test_thrust_varies_where_the_moment_is_not_normal_to_the_field():
    tilted = propulsion(moment=(1.0, 0.0, 0.0), axis=(0.6, 0.8))
    ts = jnp.linspace(0.0, 5.0, 23)
    thrust = jax.vmap(lambda t: tilted(t, X, V))(ts)
    size = 0.2 * 1.5 * jnp.abs(jnp.sin(2.0 * ts))
    expected = size[:, None] * jnp.array([[0.6, 0.8]])
    np.testing.assert_allclose(thrust, expected, atol=1e-14)


def test_network_sees_centred_and_scaled_inputs():
    force = FORCES["network of position"]()
    inputs = jnp.array([(4.2 - 5.0) / 2.0, (5.5 - 4.0) / 3.0])
    np.testing.assert_allclose(force(T, X, V), 0.7 * force.network(inputs))


def test_paper_network_has_the_printed_shape_and_sees_time():
    force = forces.paper_force(KEY)
    shapes = [layer.weight.shape for layer in force.network.layers]
    assert shapes == [(32, 3), (32, 32), (2, 32)]
    assert not jnp.allclose(force(0.0, X, V), force(1.0, X, V))
    np.testing.assert_array_equal(force(T, X, V), force(T, X, 2 * V))


test_bad_arguments_are_named = refusals(
    (lambda: forces.LinearDrag(-0.1), r"LinearDrag.damping: expected >= 0, got -0.1"),
    (lambda: forces.GaussianBarrier(1.0, [0.0, 0.0], 0.0), r"width: expected > 0, got"),
    (
        lambda: forces.GaussianBarrier(1.0, 3.0, 1.0),
        r"GaussianBarrier.center: expected a point of shape \(dim,\), got \(\)",
    ),
    (lambda: forces.GaussianBarrier(1.0, jnp.zeros((2, 2)), 1.0), r"got \(2, 2\)"),
    (lambda: propulsion(moment=(0.0, 1.0)), r"moment: expected .*\(3,\), got \(2"),
    (
        lambda: forces.tanh_network(2, 2, width=0, depth=1, key=KEY),
        r"network width: expected a positive integer, got 0",
    ),
    (
        lambda: forces.tanh_network(2, 2, width=3, depth=-1, key=KEY),
        r"network depth: expected a positive integer, got -1",
    ),
)


def test_a_single_kernel_is_the_gaussian_barrier():
    kernel = forces.KernelPotential(jnp.array([2.0]), jnp.array([MIDDLE]), 1.5)
    np.testing.assert_allclose(kernel(T, X, V), barrier()(T, X, V), rtol=1e-13)


def test_kernels_are_linear_and_vanish_far_away():
    for force in (kernel_force(), kernel_potential()):
        double = eqx.tree_at(lambda f: f.weights, force, 2 * force.weights)
        np.testing.assert_allclose(double(T, X, V), 2 * force(T, X, V), rtol=1e-13)
        np.testing.assert_allclose(force(T, X + 100.0, V), 0.0, atol=1e-300)


def test_kernel_centers_surround_the_data():
    rng = np.random.default_rng(0)
    positions = rng.uniform(-3.0, 3.0, (40, 2))
    centers = forces.kernel_centers(positions, spacing=0.5, margin=1.0)
    gaps = np.linalg.norm(positions[:, None] - centers[None], axis=-1)
    assert gaps.min(axis=0).max() < 1.0, "no kernel far from the data"
    assert gaps.min(axis=1).max() <= 0.5 / np.sqrt(2) + 1e-12, "none missing near it"


PLANE, SHORT = [5, 4], types.SimpleNamespace(weights=jnp.zeros(2), width=1.0)
test_bad_landscapes_and_structures_are_refused = refusals(
    (
        lambda: forces.PlaneWaves([0.5], jnp.eye(2), [0.1, 0.7]),
        "PlaneWaves: expected an amplitude and a phase",
    ),
    (
        lambda: forces.LinearForce(jnp.eye(3), PLANE),
        "LinearForce.matrix: expected shape",
    ),
    (lambda: forces.soft_wall(2.0, 0.6, 5.0, 0.0), "logistic wall.edge: expected > 0"),
    (
        lambda: forces.power_hill(2.0, PLANE, -1.0, 0.5),
        "inverse power.core: expected > 0",
    ),
    (lambda: forces.compact_hill(2.0, PLANE, 0.0), "compact hill.radius: expected > 0"),
    (lambda: forces.ring_barrier(2.0, PLANE, 1.0, 0.0), "ring.width: expected > 0"),
    (
        lambda: forces.profile_barrier("Hooke", 2.0, PLANE),
        "profile_barrier law: 'Hooke' is unknown; choose",
    ),
    (
        lambda: forces.profile_barrier("Yukawa", 2.0, PLANE),
        r"Yukawa expects .*core, range\), got \(3,\)",
    ),
    (
        lambda: forces.StructuredForce((), kernel_potential()),
        "StructuredForce.terms: expected one or more",
    ),
    (
        lambda: forces.StructuredForce(
            (
                forces.CentralTerm(
                    WEIGHTS, jnp.zeros(3), PLACES, WIDTH, rotational=True
                ),
            ),
            forces.KernelPotential(jnp.ones(1), jnp.zeros((1, 3)), 1.0),
        ),
        "rotational: expected a plane, got dimension 3",
    ),
    (
        lambda: forces.KernelPotential(jnp.zeros(3), jnp.zeros((3, 2)), 0.0),
        "KernelPotential.width: expected > 0, got 0",
    ),
    (
        lambda: forces.kernel_centers(np.zeros((2, 2)), spacing=0.0, margin=1.0),
        "kernel_centers spacing: expected > 0",
    ),
    # straight to the checks: the tests' own type checker would object before them
    (
        lambda: forces.check_kernels(SHORT, (3,)),
        r"weights: expected shape \(3,\), as .* \(2,\)",
    ),
    (
        lambda: point("center", 2)(["a", 2.0]),
        r"center: expected numbers, got \['a', 2.0\]",
    ),
)


@pytest.mark.parametrize(
    "make", [forces.LinearDrag, forces.ShearFlow, forces.IsotropicTensor]
)
def test_text_is_no_number(make):
    """An instance as Python makes it without the checks of types in these tests."""
    made, fields = object.__new__(make), dataclasses.fields(make)
    for field in fields:
        object.__setattr__(made, field.name, "0.8" if field is fields[0] else 0.0)
    message = rf"\.{fields[0].name}: expected a number, got '0.8'"
    with pytest.raises(InputError, match=message):
        forces.AbstractForce.__check_init__(made)
