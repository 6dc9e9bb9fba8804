import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav import forces
from pinav.forces.fitted_laws import FittedLaw
from pinav.forces.formulas import NEAR_GAUSSIAN, falling
from pinav.forces.structures import ROUNDING

HEIGHT, CENTER, NO_PLACES = 2.5, jnp.array([4.0, 5.5]), jnp.zeros(0)
TAILS = (-0.49, -0.2, -1e-9, 0.0, 1e-9, 0.4, 5.0)
TIME, STILL = jnp.zeros(()), jnp.zeros(2)


def form(tail):
    return jnp.asarray(np.log1p(2 * tail))


def central(law, height=HEIGHT, rounding=1e-4):
    """A term whose distances are rounded within a length."""
    width = rounding / ROUNDING
    return forces.CentralTerm(jnp.array([height]), CENTER, NO_PLACES, width, law=law)


def wall(law, angle=0.7):
    return forces.WallTerm(
        jnp.array([HEIGHT]), angle, jnp.zeros(2), NO_PLACES, 0.5, law=law
    )


def steps():
    """A channel of walls 3 from its middle at 5."""
    far, near = (
        forces.soft_wall(HEIGHT, 0.7 + angle, place, 0.8)
        for angle, place in ((0.0, 8.0), (np.pi, -2.0))
    )
    return forces.SumForce((far, near))


def hill(tail, size=1.5):
    return FittedLaw("hill", (np.log(size), form(tail)))


def stripes():
    direction = np.array([[np.cos(0.7), np.sin(0.7)]])
    return forces.PlaneWaves([HEIGHT], direction / 0.7, [-0.5 / 0.7])


SAME = {
    "Gaussian": (central(hill(0.0)), forces.GaussianBarrier(HEIGHT, CENTER, 1.5)),
    "plateau of steepness one": (
        central(FittedLaw("plateau", (np.log(1.5), 0.0))),
        forces.GaussianBarrier(HEIGHT, CENTER, 1.5),
    ),
    "Lorentzian": (
        central(hill(1.0)),
        forces.power_hill(HEIGHT, CENTER, 1.5 * np.sqrt(2), 1.0),
    ),
    "screened": (central(hill(2.0)), forces.power_hill(HEIGHT, CENTER, 1.5, 0.5)),
    "compact": (
        central(hill(-1 / 3)),
        forces.compact_hill(HEIGHT, CENTER, 1.5 * np.sqrt(6)),
    ),
    "ring": (
        central(FittedLaw("ring", (3.0, np.log(0.8), form(0.0)))),
        forces.ring_barrier(HEIGHT, CENTER, 3.0, 0.8),
    ),
    "step": (
        wall(FittedLaw("step", (6.0, np.log(0.9)))),
        forces.soft_wall(HEIGHT, 0.7, 6.0, 0.9),
    ),
    "channel": (wall(FittedLaw("channel", (5.0, 3.0, np.log(0.8)))), steps()),
    "wave": (wall(FittedLaw("wave", (0.5, np.log(0.7)))), stripes()),
}


@pytest.mark.parametrize(("term", "truth"), SAME.values(), ids=list(SAME))
def test_a_term_that_follows_a_law_alone_is_the_force_of_that_name(
    term: forces.AbstractForce, truth: forces.AbstractForce
):
    places = jnp.asarray(np.random.default_rng(1).uniform(-2.0, 12.0, (200, 2)))
    made = jax.vmap(lambda x: term(TIME, x, STILL))(places)
    true = jax.vmap(lambda x: truth(TIME, x, STILL))(places)
    np.testing.assert_allclose(made, true, atol=1e-5 * HEIGHT)


def test_what_falls_lies_between_zero_and_one_and_has_finite_slopes():
    squares, tails = np.meshgrid([0.0, 1e-9, 0.3, 2.0, 40.0, 200.0], TAILS)
    at = jnp.asarray(squares.ravel()), jnp.asarray(tails.ravel())
    first = jax.grad(falling, argnums=(0, 1))
    values = jax.jit(jax.vmap(falling))(*at)
    assert np.all((values >= 0.0) & (values <= 1.0))
    assert np.all(np.isfinite(jax.tree.leaves(jax.jit(jax.vmap(first))(*at))))
    second = jax.jit(jax.vmap(jax.jacfwd(first, argnums=(0, 1))))(*at)
    smooth = (1 + at[1] * at[0] > 1e-2) | (at[1] > 0)  # beyond, it may be steep
    assert all(np.all(np.isfinite(leaf[smooth])) for leaf in jax.tree.leaves(second))


def test_a_hill_whose_distance_is_rounded_is_a_hill():
    """(1 + κ (d² + ε²) / 2 s²) = a (1 + κ d² / 2 a s²), a = 1 + κ ε² / 2 s²."""
    place = CENTER + jnp.array([0.4, -0.3])
    for tail, size, rounding in ((0.2, 0.3, 0.5), (1.7, 3.0, 0.01), (3.0, 0.8, 0.2)):
        wider = 1 + 0.5 * tail * (rounding / size) ** 2
        law, other = hill(tail, size), hill(tail, size * np.sqrt(wider))
        made = central(law, rounding=rounding)(TIME, place, STILL)
        true = central(other, HEIGHT * wider ** (-1 / tail))(TIME, place, STILL)
        np.testing.assert_allclose(made, true, rtol=1e-4)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_series_about_the_gaussian_joins_the_power(sign):
    squares = jnp.linspace(0.0, 20.0, 50)
    inside, outside = sign * NEAR_GAUSSIAN * np.array([1 - 1e-9, 1 + 1e-9])
    near = [jax.vmap(lambda q, k=k: falling(q, k))(squares) for k in (inside, outside)]
    np.testing.assert_allclose(*near, rtol=1e-6)


def test_a_plateau_falls_to_a_share_that_its_steepness_does_not_change():
    """At a distance of the square root of two sizes the exponent is one."""
    for steepness in (-0.7, 0.0, 1.5):
        law = FittedLaw("plateau", (np.log(1.5), steepness))
        edge = law.potential(jnp.asarray(1.5 * np.sqrt(2)))
        np.testing.assert_allclose(edge, np.exp(-1), rtol=1e-6)
        np.testing.assert_allclose(law.potential(jnp.asarray(1e-9)), 1.0, atol=1e-3)


def test_kernels_beside_a_law_add_to_it():
    law, places = hill(0.5), jnp.arange(0.5, 4.0, 0.5)
    weights, x = jnp.linspace(0.2, -0.1, len(places)), jnp.array([5.1, 4.2])
    all_weights = jnp.append(jnp.array([HEIGHT]), weights)
    both = forces.CentralTerm(all_weights, CENTER, places, 0.5, law=law)
    kernels = forces.CentralTerm(weights, CENTER, places, 0.5)
    alone = central(law, rounding=0.5 * ROUNDING)
    force, potential = (
        (lambda term: term(TIME, x, STILL)),
        (lambda term: term.potential(TIME, x)),
    )
    for part in (force, potential):
        parts = part(alone) + part(kernels)
        np.testing.assert_allclose(part(both), parts, rtol=1e-12)


def test_the_numbers_of_a_law_are_part_of_the_geometry():
    term = central(FittedLaw("hill", (jnp.asarray(0.3), form(1.0))))
    assert len(term.geometry) == len(term.geometry_scales) == 3
    constants = term.law.constants()
    np.testing.assert_allclose(constants["size"], np.exp(0.3))
    np.testing.assert_allclose(constants["tail"], 1.0)


def test_places_of_a_wall_are_told_from_the_origin_of_space():
    one = jnp.asarray(0.0)
    step = FittedLaw("step", (2.0, one))
    term = forces.WallTerm(
        jnp.ones(1), 0.0, jnp.array([3.0, 1.0]), NO_PLACES, 0.5, law=step
    )
    for law, name in (
        (step, "place"),
        (FittedLaw("channel", (2.0, 1.0, one)), "middle"),
        (FittedLaw("ring", (2.0, one, form(0.0))), "radius"),
    ):
        np.testing.assert_allclose(law.constants(term.offset)[name], 5.0)
    assert central(step).offset == 0.0


def test_the_prior_of_kernels_beside_a_law_keeps_them_the_smaller_part():
    places, law = jnp.arange(0.5, 4.0, 0.5), hill(0.0, 1.0)
    term = forces.CentralTerm(jnp.zeros(8), CENTER, places, 0.5, law=law)
    prior = term.prior()
    assert prior.covariance(prior.start).shape == (8, 8)
    most = prior.covariance(prior.bounds[:, 1])
    assert np.sqrt(most[1:, 1:].max()) < term.force_per_weight
    assert central(law).prior().covariance(np.zeros(0)).shape == (1, 1)
