"""Laws and closed forms of the forces, tensors and flows of an environment."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.forces.examples import KEY, MIDDLE, TENSORS, T, V, X
from tests.refusals import refusals

from pinav import forces

SQUARE = forces.Domain((0.0, 0.0), (20.0, 20.0))


def ridge(length=3.0, angle=0.6):
    return forces.gaussian_ridge(2.0, MIDDLE, length, 0.8, angle)


every_tensor = pytest.mark.parametrize("make", TENSORS.values(), ids=list(TENSORS))


def test_a_positive_swirl_turns_counter_clockwise():
    force = forces.gaussian_swirl(2.0, [0.0, 0.0], 1.5)(T, jnp.array([1.0, 0.0]), V)
    np.testing.assert_allclose(force[0], 0.0, atol=1e-15)
    assert force[1] > 0


def test_energy_of_barrier_and_swirl_over_the_plane():
    """The closed forms from which scenario `swirl` has its rotational fraction."""
    barrier = forces.GaussianBarrier(1.7, [0.0, 0.0], 1.1)
    swirl = forces.gaussian_swirl(0.9, [0.4, -0.3], 0.8)
    axis = jnp.arange(-9.0, 9.0, 0.1)
    points = jnp.stack(jnp.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    a, b = (jax.vmap(lambda x, f=f: f(T, x, V))(points) for f in (barrier, swirl))
    integrals = [float(jnp.sum(p * q)) * 0.01 for p, q in ((a, a), (b, b), (a, b))]
    expected = [np.pi * 1.7**2, np.pi * 0.9**2, 0.0]
    np.testing.assert_allclose(integrals, expected, atol=1e-10)


def test_a_round_ridge_is_a_barrier_at_any_angle():
    barrier = forces.GaussianBarrier(2.0, MIDDLE, 0.8)
    for angle in (0.0, 1.0):
        force = ridge(length=0.8, angle=angle)(T, X, V)
        np.testing.assert_allclose(force, barrier(T, X, V), rtol=1e-12)


def test_a_ridge_is_longer_along_its_angle():
    center, long = jnp.asarray(MIDDLE), ridge()
    along = jnp.array([np.cos(0.6), np.sin(0.6)])
    across = jnp.array([-np.sin(0.6), np.cos(0.6)])
    heights = [long.potential(T, center + end) for end in (3.0 * along, 0.8 * across)]
    np.testing.assert_allclose(heights, 2.0 * np.exp(-0.5), rtol=1e-13)


@every_tensor
def test_a_tensor_is_symmetric_positive_and_has_a_factor(make):
    tensor = make()
    matrix = np.asarray(forces.tensor_matrix(tensor, X))
    np.testing.assert_allclose(matrix, matrix.T, rtol=1e-13)
    assert np.linalg.eigvalsh(matrix)[0] > 0
    factor = np.asarray(jax.jacfwd(lambda w: tensor.factor(X, w))(V))
    np.testing.assert_allclose(factor @ factor.T, matrix, rtol=1e-13)


@every_tensor
def test_drag_takes_energy_whatever_the_velocity(make):
    drag = forces.TensorDrag(make())
    vs = jax.random.normal(KEY, (50, 2))
    power = jax.vmap(lambda v: v @ drag(T, X, v))(vs)
    assert power.max() < 0


def test_principal_values_and_director_of_a_uniaxial_tensor():
    tensor = forces.UniaxialTensor(0.2, 0.5, forces.WavyDirector(0.4, 0.8, [0.5, -0.3]))
    values, vectors = np.linalg.eigh(np.asarray(forces.tensor_matrix(tensor, X)))
    np.testing.assert_allclose(values, [0.2, 0.5], rtol=1e-13)
    angle = 0.4 + 0.8 * np.sin(0.5 * 4.2 - 0.3 * 5.5)
    parallel = abs(vectors[:, 0] @ [np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(parallel, 1.0, rtol=1e-13)


@pytest.mark.parametrize(
    "tensor",
    [
        forces.IsotropicTensor(0.3),
        forces.UniaxialTensor(0.3, 0.3, forces.WavyDirector(0.4, 0.8, [0.5, -0.3])),
        forces.CholeskyTensor.of(0.3 * jnp.eye(2)),
        forces.BrinkmanTensor(0.3, 0.5, jnp.zeros(1), jnp.zeros((1, 2)), 1.2),
    ],
    ids=["isotropic", "uniaxial", "cholesky", "brinkman"],
)
def test_equal_principal_values_are_linear_drag(tensor):
    drag = forces.TensorDrag(tensor)
    np.testing.assert_allclose(
        drag(T, X, V), forces.LinearDrag(0.3)(T, X, V), rtol=1e-13
    )


@pytest.mark.slow
def test_a_cholesky_tensor_has_its_matrix_and_slopes_even_where_isotropic():
    matrix = jnp.array([[2.0, 0.4, 0.1], [0.4, 1.0, -0.3], [0.1, -0.3, 0.5]])
    tensor = forces.CholeskyTensor.of(matrix)
    np.testing.assert_allclose(
        forces.tensor_matrix(tensor, jnp.zeros(3)), matrix, rtol=1e-13
    )
    flat = forces.CholeskyTensor(jnp.zeros(2), jnp.zeros(1))
    slopes = jax.jacrev(lambda c: forces.tensor_matrix(c, X))(flat)
    np.testing.assert_allclose(slopes.below[..., 0], [[0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_allclose(slopes.log_diagonal[0, 0], [2.0, 0.0])


def test_brinkman_drag_has_the_published_ratios():
    """Sphere of radius a in permeability K: a = 1, K = 1 and a = 0.25, K = 0.01."""
    for radius, permeability, ratio in ((1.0, 1.0, 2.111), (0.25, 0.01, 4.194)):
        screening = jnp.array([permeability**-0.5])
        tensor = forces.BrinkmanTensor(1.0, radius, screening, jnp.zeros((1, 2)), 1.0)
        np.testing.assert_allclose(tensor.value(jnp.zeros(2)), ratio, rtol=1e-3)


def test_a_swimmer_carried_by_the_flow_feels_no_drag():
    flow = forces.VortexFlow(0.4, [4.0, 4.0], 2.0)
    drag = forces.InFlow(forces.LinearDrag(0.3), flow)
    np.testing.assert_allclose(drag(T, X, flow(T, X)), 0.0, atol=1e-16)
    np.testing.assert_allclose(drag(T, X, V), -0.3 * (V - flow(T, X)))


@pytest.mark.parametrize(
    ("flow", "vorticity"),
    [
        (forces.ShearFlow(0.2, 1.0), -0.2),
        (forces.PoiseuilleFlow(0.8, 5.0, 6.0), 2 * 0.8 * 0.5 / 36),
        (forces.VortexFlow(0.4, [4.2, 5.5], 2.0), 2 * 0.4),
    ],
    ids=["shear", "poiseuille", "vortex"],
)
def test_flows_are_incompressible_with_known_vorticity(flow, vorticity):
    slopes = np.asarray(jax.jacfwd(flow, argnums=1)(T, X))
    np.testing.assert_allclose(np.trace(slopes), 0.0, atol=1e-15)
    np.testing.assert_allclose(slopes[1, 0] - slopes[0, 1], vorticity, rtol=1e-13)


def test_poiseuille_flow_is_fast_in_the_middle_and_at_rest_on_and_beyond_the_walls():
    places = jnp.array([[0.0, 5.0], [0.0, 8.0], [0.0, 11.0], [0.0, 20.0]])
    speeds = jax.vmap(lambda x: forces.PoiseuilleFlow(0.8, 5.0, 6.0)(T, x))(places)[
        :, 0
    ]
    np.testing.assert_allclose(speeds, [0.8, 0.6, 0.0, 0.0], atol=1e-15)


def test_a_moving_barrier_is_the_barrier_where_it_then_is():
    barrier = forces.GaussianBarrier(2.0, MIDDLE, 1.5)
    moved = forces.GaussianBarrier(2.0, [5.4, 3.6], 1.5)
    force = forces.Moving(barrier, forces.LinearMotion([1.0, -1.0]))
    np.testing.assert_allclose(force(T, X, V), moved(T, X, V), rtol=1e-13)
    circling = forces.Moving(barrier, forces.CircularMotion(2.0, np.pi, 0.0))
    np.testing.assert_allclose(circling(2.3, X, V), circling(0.3, X, V), rtol=1e-12)
    opposite = forces.GaussianBarrier(2.0, [3.0, 4.0], 1.5)
    np.testing.assert_allclose(circling(1.0, X, V), opposite(T, X, V), rtol=1e-12)


HIGH = {"heights": (1.0, 2.0)}
BARRIERS = HIGH | {"widths": (1.0, 1.6)}
FIBRES = HIGH | {"length": 3.0, "width": 0.6}


def test_random_fields_depend_on_their_key_alone_and_keep_apart():
    first, again, other = (
        forces.random_barriers(SQUARE, 12, key=key, **BARRIERS)
        for key in (KEY, KEY, jax.random.key(3))
    )
    np.testing.assert_array_equal(first(T, X, V), again(T, X, V))
    assert not np.allclose(first(T, X, V), other(T, X, V))
    centers = np.stack([term.center for term in first.terms])
    assert np.all((centers >= 0.0) & (centers <= 20.0))
    gaps = np.linalg.norm(centers[:, None] - centers[None], axis=-1) + 99 * np.eye(12)
    assert gaps.min() > 3.0


def test_random_fibres_have_the_asked_shape():
    fibres = forces.random_fibres(SQUARE, 5, key=KEY, **FIBRES)
    assert len(fibres.terms) == 5
    for fibre in fibres.terms:
        height, x, y, aspect, angle, size = np.asarray(fibre.constants)
        assert 1.0 <= height <= 2.0
        assert 0.0 <= angle <= np.pi
        like = forces.gaussian_ridge(height, [x, y], 3.0, 0.6, angle)
        np.testing.assert_allclose([aspect, size], like.constants[jnp.array([3, 5])])
    expected = forces.SumForce(fibres.terms)(T, X, V)
    np.testing.assert_allclose(fibres(T, X, V), expected, rtol=1e-12)


test_bad_arguments_are_named = refusals(
    (lambda: ridge(length=0.0), r"gaussian_ridge length: expected > 0, got 0.0"),
    (
        lambda: forces.gaussian_swirl(1.0, MIDDLE, -1.0),
        r"swirl.width: expected > 0, got",
    ),
    (
        lambda: forces.gaussian_swirl(1.0, [1.0], 1.0),
        r"center: expected .*\(2,\), got \(1",
    ),
    (lambda: forces.VortexFlow(1.0, MIDDLE, 0.0), r"VortexFlow.width: expected > 0"),
    (
        lambda: forces.PoiseuilleFlow(1.0, 0.0, 0.0),
        r"half_width: expected > 0, got 0.0",
    ),
    (
        lambda: forces.UniaxialTensor(0.1, -0.2, forces.ConstantDirector(0.0)),
        r"UniaxialTensor.across: expected > 0, got -0.2",
    ),
    (
        lambda: forces.WavyDirector(0.0, 1.0, [1.0]),
        r"wavevector: expected .*got \(1,\)",
    ),
    (
        lambda: forces.CholeskyTensor.of(jnp.array([[1.0, 2.0], [2.0, 1.0]])),
        r"CholeskyTensor.of: expected a symmetric positive matrix, got \[\[1.0, 2",
    ),
    (
        lambda: forces.BrinkmanTensor(0.0, 1.0, jnp.ones(1), jnp.zeros((1, 2)), 1.0),
        r"BrinkmanTensor.clear: expected > 0",
    ),
    (lambda: forces.LinearMotion(1.0), r"LinearMotion.velocity: expected a point"),
    (
        lambda: forces.Domain((0.0, 0.0), (1.0, 0.0)),
        r"Domain: expected upper beyond lower",
    ),
    (
        lambda: forces.random_barriers(SQUARE, 0, key=KEY, **BARRIERS),
        r"random_barriers count: expected 1 or more, got 0",
    ),
    (
        lambda: forces.random_fibres(SQUARE, 0, key=KEY, **FIBRES),
        r"random_fibres count: expected 1 or more, got 0",
    ),
)
