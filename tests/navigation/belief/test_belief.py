"""The belief of state and force: exact where it can be, honest where it cannot."""

import copy
import dataclasses

import numpy as np
import pytest
from tests.navigation.steering_worlds import learned

from pinav.codec import decode, encode
from pinav.errors import InputError
from pinav.navigation.belief import belief as bank
from pinav.navigation.belief.belief import KINDS, Belief, Frame
from pinav.navigation.belief.kernel_filter import ExpectedForce
from pinav.navigation.belief.kernels import FreeKernels, KernelGrid, PotentialKernels
from pinav.navigation.belief.motion import InertialMotion, OverdampedMotion

MOTIONS = {
    "inertia": InertialMotion(damping=0.4, noise=0.05),
    "overdamped": OverdampedMotion(noise=0.02),
}


@pytest.fixture(params=MOTIONS.values(), ids=MOTIONS)
def motion(request):
    return request.param


def box(dim):
    return np.zeros(dim), np.full(dim, 8.0)


def first_frame(dim=2):
    return Frame(0.0, np.full(dim, 2.0), 0.02, np.zeros(dim))


INERTIA = MOTIONS["inertia"]
LONE = {"scales": (3.0,), "kinds": (FreeKernels,)}


def believe(motion=INERTIA, dim=2, first=None, *, scales=(6.0, 4.0), kinds=KINDS):
    lower, upper = box(dim)
    return Belief.start(
        first_frame(dim) if first is None else first,
        lower=lower,
        upper=upper,
        motion=motion,
        thrust=1.0,
        scales=scales,
        kinds=kinds,
    )


def lost(time, thrust=(0.0, 0.0)):
    """A frame without a position."""
    return Frame(time, None, 0.02, np.array(thrust))


def frames(motion, force, count, *, seed=0, sd=0.02, dim=2, step=0.1):
    """Frames of a flight through a force, its positions and its last state."""
    random = np.random.default_rng(seed)
    state, _ = motion.start(np.full(dim, 2.0), 0.0, 0.0)
    flight, path, heading = [], [], 0.6

    def force_at(x):
        return force(x), np.zeros((dim, dim))

    for k in range(count):
        heading += 0.15 * random.standard_normal()
        thrust = np.zeros(dim)
        thrust[:2] = 0.5 * np.cos(heading), 0.5 * np.sin(heading)
        move = motion.step(state, force_at, thrust, step)
        spread = np.linalg.cholesky(move.noise + 1e-15 * np.eye(len(state)))
        state = move.state + spread @ random.standard_normal(len(state))
        position = state[:dim] + sd * random.standard_normal(dim)
        flight.append(Frame(step * (k + 1), position, sd, thrust))
        path.append(state.copy())
    return flight, np.array(path)


def flown(count, motion=INERTIA):
    """The belief after some frames of a flight through a swirl."""
    return learned(believe(motion), frames(motion, swirl, count)[0])


def swirl(x):
    turned = np.zeros_like(x)
    turned[0], turned[1] = -0.15 * (x[1] - 4), 0.15 * (x[0] - 4)
    return turned


@pytest.mark.parametrize("kind", [PotentialKernels, FreeKernels])
@pytest.mark.parametrize("dim", [2, 3])
def test_joining_late_is_the_filter_of_the_whole_grid(motion, kind, dim):
    late = believe(motion, dim, kinds=(kind,), scales=(6.0 - 2.0 * dim + 1.0,))
    whole = late.filters[0]
    everything = whole.weights.reach(np.arange(whole.kernels.size))
    early = dataclasses.replace(
        late, filters=(dataclasses.replace(whole, weights=everything),)
    )
    for frame in frames(motion, swirl, 8, dim=dim)[0]:
        late, early = late.after(frame), early.after(frame)
    np.testing.assert_allclose(late.state.mean, early.state.mean, atol=1e-10)
    np.testing.assert_allclose(late.log_evidence, early.log_evidence, atol=1e-8)
    places = np.linspace(1, 7, 5)[:, None] * np.ones(dim)
    for one, other in zip(late.force(places), early.force(places), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_the_step_has_the_slope_that_it_states(motion):
    matrix = np.array([[0.3, -0.7], [0.2, 0.4]])
    state, _ = motion.start(np.array([0.4, -0.2]), 0.0, 0.0)
    state[-1] += 0.3
    thrust = np.array([0.2, 0.1])

    def moved(y):
        return motion.step(y, lambda x: (matrix @ x, matrix), thrust, 0.1)

    unit = 1e-6 * np.eye(len(state))
    slope = [(moved(state + e).state - moved(state - e).state) / 2e-6 for e in unit]
    np.testing.assert_allclose(moved(state).slope, np.stack(slope, axis=1), atol=1e-8)


@pytest.mark.parametrize("kind", [PotentialKernels, FreeKernels])
@pytest.mark.parametrize("dim", [2, 3])
def test_kernels_say_the_same_in_every_form(kind, dim):
    kernels = kind(KernelGrid.over(*box(dim), 8.0 / 3))
    weights = np.random.default_rng(1).standard_normal(kernels.size)
    x = np.array([2.3, 4.1, 3.2])[:dim]
    local = kernels.at(x)
    near = local.basis @ weights[local.weights]
    every = kernels.basis(x[None])[0] @ weights
    lattice = kernels.on_axes([np.array([part]) for part in x], weights)
    np.testing.assert_allclose(lattice.ravel(), every, atol=1e-12)
    np.testing.assert_allclose(near, every, atol=0.01)  # kernels end at 3e-4
    step = 1e-6 * np.eye(dim)
    slope = [
        (kernels.basis(x[None] + e) - kernels.basis(x[None] - e))[0] @ weights / 2e-6
        for e in step
    ]
    here = local.slope @ weights[local.weights]
    np.testing.assert_allclose(here, np.stack(slope, axis=1), atol=0.03)


@pytest.mark.parametrize("kind", [PotentialKernels, FreeKernels])
def test_the_prior_has_its_strength_everywhere_in_the_arena(kind):
    belief = believe(kinds=(kind,), scales=(4.0,))
    mean, sd = belief.force(np.random.default_rng(2).uniform(0, 8, (40, 2)))
    assert np.all(mean == 0)
    np.testing.assert_allclose(sd, 0.7, rtol=0.02)


def test_a_belief_comes_back_from_its_file(motion):
    flight, _ = frames(motion, swirl, 30)
    belief = learned(believe(motion), flight[:20])
    again = decode(Belief, *encode(belief))
    ours, theirs = (encode(learned(one, flight[20:])) for one in (belief, again))
    assert ours.document == theirs.document
    assert ours.arrays.keys() == theirs.arrays.keys()
    for name, array in ours.arrays.items():
        np.testing.assert_array_equal(array, theirs.arrays[name], err_msg=name)


def test_after_leaves_the_belief_as_it_was():
    flight, _ = frames(INERTIA, swirl, 12)
    belief = learned(believe(), flight[:8])
    document, arrays = copy.deepcopy(tuple(encode(belief)))
    later = learned(belief, flight[8:])
    assert later.time > belief.time
    assert encode(belief).document == document
    for name, array in encode(belief).arrays.items():
        np.testing.assert_array_equal(array, arrays[name])


def test_a_lost_frame_widens_the_state_and_teaches_nothing():
    belief = believe()
    after = belief.after(lost(0.1))
    assert np.all(after.log_evidence == belief.log_evidence)
    assert np.linalg.det(after.state.covariance) > np.linalg.det(
        belief.state.covariance
    )
    far, steps = (
        belief.after(lost(0.4)),
        learned(belief, map(lost, (0.1, 0.2, 0.3, 0.4))),
    )
    np.testing.assert_allclose(far.state.mean, steps.state.mean, atol=1e-12)


def test_a_restart_keeps_the_map():
    belief = flown(20)
    again = belief.restart(first_frame())
    places = np.array([[2.0, 2.0], [5.0, 5.0]])
    for old, new in zip(belief.force(places), again.force(places), strict=True):
        np.testing.assert_array_equal(old, new)
    np.testing.assert_array_equal(again.state.mean, [2.0, 2.0, 0.0, 0.0])


def test_the_least_probable_filters_are_given_up_where_memory_ends(monkeypatch):
    *earlier, last = frames(INERTIA, swirl, 20)[0]
    before = learned(believe(), earlier)
    belief = before.after(last)
    monkeypatch.setattr(bank, "MEMORY", before.best.nbytes)
    assert before.nbytes > before.best.nbytes
    alone = belief.after(lost(2.1))
    assert len(alone.filters) == 1
    assert alone.log_evidence[0] == belief.log_evidence[belief.leader]
    monkeypatch.setattr(bank, "MEMORY", 10 * before.nbytes)
    every = belief.after(lost(2.1))
    assert len(every.filters) == len(belief.filters)
    np.testing.assert_allclose(alone.best.state, every.best.state, atol=1e-12)


def test_draws_have_the_deviation_that_is_stated():
    belief = flown(15)
    axes = [np.array([2.0, 3.0, 6.0]), np.array([2.0, 6.0])]
    draws = belief.samples(axes, 3000, seed=3)
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    mean, sd = belief.force(places)
    np.testing.assert_allclose(draws.std(0).reshape(-1, 2), sd, rtol=0.06)
    np.testing.assert_allclose(draws.mean(0).reshape(-1, 2), mean, atol=0.05)
    on_axes = belief.force_on(axes).reshape(-1, 2)
    np.testing.assert_allclose(on_axes, mean, atol=1e-10)
    at_places = belief.samples_at(places, 3000, seed=3)
    np.testing.assert_allclose(at_places, draws.reshape(3000, -1, 2), atol=1e-10)


def test_ahead_is_what_lost_frames_would_say(motion):
    belief = believe(motion, scales=(6.0,), kinds=(PotentialKernels,))
    thrusts = np.array([[0.3, 0.1], [0.0, -0.4]])
    for k, state in enumerate(belief.ahead(thrusts, np.full(2, 0.1))):
        belief = belief.after(lost(0.1 * (k + 1), thrusts[k]))
        ours, theirs = belief.state, state
        np.testing.assert_allclose(theirs.mean, ours.mean, atol=1e-12)
        np.testing.assert_allclose(theirs.covariance, ours.covariance, atol=1e-12)


def check_mixture(belief, mean, covariance, parts, rtol=1e-10):
    """Mean and covariance are of what the filters say, weighted by their evidence."""
    odds = np.exp(belief.log_evidence - belief.log_evidence.max())
    odds[odds < bank.NEGLIGIBLE] = 0.0
    assert np.sum(odds > 0) > 1
    weights = odds / odds.sum()
    means, covariances = map(np.array, zip(*parts, strict=True))
    expected = weights @ means
    off = means - expected
    np.testing.assert_allclose(mean, expected, rtol=1e-12)
    spread = np.tensordot(weights, covariances, axes=1) + (off.T * weights) @ off
    np.testing.assert_allclose(covariance, spread, rtol=rtol)


def test_what_is_believed_is_the_mixture_of_the_filters(motion):
    belief = flown(30, motion)
    filters, thrust, now = belief.filters, np.array([0.3, 0.1]), belief.state
    states = [(one.state, one.spread) for one in filters]
    check_mixture(belief, now.mean, now.covariance, states)
    place = np.array([[2.5, 2.5]])
    force, sd = belief.force(place)
    said = [one.force(place) for one in filters]
    for i in ([0], [1]):  # axis by axis
        parts = [(mean[0, i], own[:, i] ** 2) for mean, own in said]
        check_mixture(belief, force[0, i], sd[:, i] ** 2, parts, rtol=2e-12)
    ahead = belief.ahead(np.array([thrust] * 5), np.full(5, 0.1))[-1]
    for _ in range(5):
        filters = [one.predict(thrust, 0.1) for one in filters]
    states = [(one.state, one.spread) for one in filters]
    check_mixture(belief, ahead.mean, ahead.covariance, states)


def test_there_are_as_many_draws_as_were_asked_for():
    belief = flown(20)
    axes = [np.array([2.0, 3.0]), np.array([2.0, 6.0, 7.0])]
    for count in (1, 2, 7, 12):
        for seed in range(20):
            drawn = belief.samples(axes, count, seed=seed)
            assert drawn.shape == (count, 2, 3, 2)


def test_frames_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="expected a frame with a position, got none"):
        believe(first=lost(0.0))
    with pytest.raises(InputError, match="restart: expected a frame with a position"):
        believe().restart(lost(0.0))
    with pytest.raises(InputError, match="expected a frame later than 0, got 0"):
        believe().after(first_frame())
    with pytest.raises(InputError, match="expected a scale and a kind, got none"):
        believe(scales=())


@pytest.mark.parametrize("count", [100, pytest.param(10_000, marks=pytest.mark.slow)])
def test_covariances_stay_symmetric_and_positive(count):
    motion = MOTIONS["overdamped"]
    belief = believe(motion, scales=(3.0,), kinds=(PotentialKernels,))
    random = np.random.default_rng(5)
    for k in range(count):
        turn = 0.01 * k
        place = 4 + 2 * np.array([np.cos(turn), np.sin(2 * turn)])
        seen = place + 0.02 * random.standard_normal(2)
        belief = belief.after(Frame(0.1 * (k + 1), seen, 0.02, np.zeros(2)))
    one = belief.best
    matrix = one.weights.covariance()
    assert np.array_equal(matrix, matrix.T)
    cross = one.weights.cross
    joint = np.block([[one.spread, cross], [cross.T, matrix]])
    assert np.linalg.eigvalsh(joint).min() > -1e-9 * one.weights.prior_sd**2
    assert np.all(np.isfinite(belief.force(np.full((1, 2), 4.0))[1]))


def whitened(residual, blocks, spread, total):
    """Rows of a least-squares problem: the slope and the residual, of unit weight."""
    factor = np.linalg.inv(np.linalg.cholesky(spread))
    row = np.zeros((len(residual), total))
    for columns, block in blocks:
        row[:, columns] += block
    return np.column_stack([factor @ row, factor @ residual])


def most_probable(one, motion, start, flight, rounds=4):
    """Weights of the most probable path and force together, by Gauss and Newton.

    Kernels, prior and steps are those of the filter.
    """
    first, spread = motion.start(start.position, start.sd, 0.1)
    dim, size, count = len(first), one.kernels.size, len(flight)
    states = np.tile(first, (count + 1, 1)).astype(float)
    states[1:, :2] = [frame.position for frame in flight]
    before, total = (count + 1) * dim, (count + 1) * dim + size
    place = [np.arange(k * dim, (k + 1) * dim) for k in range(count + 1)]
    weights, every = np.zeros(size), np.arange(before, total)
    reached = one.weights.reach(np.arange(size))
    prior, identity = one.weights.prior_sd**2 * np.eye(size), np.eye(dim)
    for _ in range(rounds):
        rows = [
            whitened(weights, [(every, np.eye(size))], prior, total),
            whitened(states[0] - first, [(place[0], identity)], spread, total),
        ]
        field = dataclasses.replace(reached, mean=weights)
        for k, frame in enumerate(flight):
            force = ExpectedForce(one.kernels, field)
            move = motion.step(states[k], force, frame.thrust, 0.1)
            blocks = [
                (place[k + 1], identity),
                (place[k], -move.slope),
                (before + force.local.weights, -move.by_force @ force.local.basis),
            ]
            rows.append(whitened(states[k + 1] - move.state, blocks, move.noise, total))
            seen, error = [(place[k + 1], np.eye(2, dim))], frame.sd**2 * np.eye(2)
            residual = states[k + 1, :2] - frame.position
            rows.append(whitened(residual, seen, error, total))
        matrix = np.concatenate(rows)
        slope, residuals = matrix[:, :-1], matrix[:, -1]
        step = np.linalg.solve(slope.T @ slope, slope.T @ residuals)
        states -= step[:before].reshape(states.shape)
        weights = weights - step[before:]
    return weights


@pytest.mark.slow
def test_the_force_is_that_of_the_most_probable_path(motion):
    """The filter loses at most three hundredths to the batch estimate."""
    running, batch = [], []
    for seed in range(3):
        flight, path = frames(motion, swirl, 60, seed=seed)
        begun, places = believe(motion, **LONE), path[:, :2]
        weights = most_probable(begun.best, motion, first_frame(), flight)
        truth = np.array([swirl(x) for x in places])
        batch.append(begun.best.kernels.basis(places) @ weights - truth)
        running.append(learned(begun, flight).force(places)[0] - truth)
    ratio = np.linalg.norm(running) / np.linalg.norm(batch)
    assert ratio < 1.03, ratio


def test_states_and_forces_are_as_uncertain_as_they_say():
    """Squared errors over variances, over flights through forces of the prior."""
    motion, states, forces = INERTIA, [], []
    for seed in range(6):
        belief = believe(motion, **LONE)
        one = belief.best
        random = np.random.default_rng(seed)
        weights = one.weights.prior_sd * random.standard_normal(one.kernels.size)

        def force(x, kernels=one.kernels, weights=weights):
            local = kernels.at(x)
            return local.basis @ weights[local.weights]

        flight, path = frames(motion, force, 40, seed=seed)
        for frame, truth in zip(flight, path, strict=True):
            belief = belief.after(frame)
            error = truth[:2] - belief.state.mean[:2]
            spread = belief.state.covariance[:2, :2]
            states.append(error @ np.linalg.solve(spread, error) / 2)
        mean, sd = belief.force(path[:, :2])
        truth = np.array([force(x) for x in path[:, :2]])
        forces.append(np.abs(truth - mean) < 1.96 * sd)
    assert 0.6 < np.mean(states) < 1.5
    assert 0.88 < np.mean(forces) <= 0.99
