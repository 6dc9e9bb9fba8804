"""Fits of synthetic robots: what is known comes back within its interval."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.dynamics import Adaptive, drive_by_arrays, rollout
from pinav.errors import InputError
from pinav.identification import (
    Blocks,
    Predictor,
    Rollouts,
    coverage,
    delay_findings,
    drift_only,
    errors,
    estimates,
    fit_track,
    gain_matrix,
    path_of,
    split,
    tracks,
    with_learned,
    with_response,
)
from pinav.identification.findings import extrapolation
from pinav.identification.fit import CandidateSearch
from pinav.identification.likelihood import Design, evidence_and_coefficients
from pinav.identification.parameters import DELAY, Prior, fitted_coordinates
from pinav.identification.tracks import (
    COMPILATION,
    PER_BLOCK,
    PER_SAMPLE,
    one_track,
    shared_sizes,
)
from pinav.trajectories import Trajectories

RUNG = with_learned(with_response(gain_matrix(), "saturating"), "delay", DELAY)


@pytest.fixture(scope="module")
def track(recording):
    return tracks(recording)[0]


@pytest.fixture(scope="module")
def fit(track):
    return fit_track(track, RUNG)


@pytest.mark.slow
def test_constants_come_back_within_their_intervals(fit, synthetic):
    found = estimates(fit)
    truth = {
        "gain": synthetic.gain,
        "corner": synthetic.corner,
        "delay": synthetic.delay,
        "heading offset": 0.0,
        "drift x": synthetic.drift[0],
        "drift y": synthetic.drift[1],
        "gain x/y": 1.0,
    }
    for name, value in truth.items():
        assert abs(found[name].value - value) < 3.5 * found[name].sd, name
        assert found[name].sd < 0.15 * max(abs(value), 1.0), name


def test_the_swimmer_of_a_fit_moves_as_its_path_says(track, fit):
    piece = track.pieces[0]
    ts = jnp.asarray(piece.times[20:50])
    start = jnp.asarray(piece.states[20])
    swimmer = drive_by_arrays(fit.model, piece.times, piece.commands)
    run = rollout(swimmer, start, ts, solver=Adaptive(1e-8, 1e-8))
    path = path_of(fit.model)(piece)[20:50]
    moved = np.asarray(run.ys)
    np.testing.assert_allclose(moved - moved[0], path - path[0], atol=5e-3)


def test_bands_hold_what_they_promise(track, fit, synthetic):
    found = []
    for seed in range(1, 4):
        other = tracks(synthetic.as_recording(synthetic.robot(seed)))[0]
        own = coverage(other, Rollouts.of(other, 10.0), Predictor.of(track, fit))
        found.append(own.inside)
    assert 0.8 < np.mean(found) < 0.97


def test_open_loop_errors_are_those_of_the_disturbance(track, fit):
    found = errors(track, Rollouts.of(track, 10.0), path_of(fit.model))
    assert found.rollouts == 16
    assert found.median < 2.5  # um; 0.3 um/s over 10 s with a memory of 1 s
    assert found.relative < 0.05


def search_of(track, system):
    """The search for the numbers that a system leaves open."""
    return CandidateSearch(system, Design.of(system, Blocks.of(track)), Prior.of(track))


def stub_search(track, monkeypatch, slope):
    """A search of two response parameters with this gradient beside the prior's."""
    search = search_of(track, with_response(gain_matrix(), "slipping"))
    mean, sd = search.prior.mean[search.places], search.prior.sd[search.places]

    def value_and_gradient(self, learned):
        return 0.0, (learned - mean) / sd**2 + slope(learned - mean)

    monkeypatch.setattr(CandidateSearch, "__call__", value_and_gradient)
    return mean, sd, search


def test_a_flat_direction_is_as_wide_as_its_prior_and_adds_no_evidence(
    track, monkeypatch
):
    mean, sd, search = stub_search(track, monkeypatch, lambda offset: -offset)
    covariance, volume = search.laplace(mean)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sd)
    expected = np.log(sd * np.sqrt(2 * np.pi)).sum()
    np.testing.assert_allclose(volume, expected)


def test_a_kink_at_one_frequency_makes_no_narrow_interval(track, monkeypatch):
    """Of a density exp(-5 |x|), rounded within 0.02, the deviation is 0.28."""

    def leap(offset):
        slope = np.zeros_like(offset)
        slope[0] = 5 * np.clip(offset[0] / 0.02, -1, 1)
        return slope

    mean, _, search = stub_search(track, monkeypatch, leap)
    covariance, _ = search.laplace(mean)
    assert 0.14 < np.sqrt(covariance[0, 0]) < 0.28  # 0.06 by its curvature at 0


def test_intervals_of_the_response_are_those_of_the_posterior(track):
    """Minus its logarithm rises by a half over one deviation, within a factor of 2."""
    candidate = with_response(gain_matrix(), "slipping")
    fit = fit_track(track, candidate)
    with jax.enable_x64(new_val=True):
        search = search_of(track, candidate)
        best = fitted_coordinates(fit)[search.places]
        covariance, _ = search.laplace(best)
        least = search(best)[0]
        for index in range(2):
            # The conditional maximum of all others lies along the covariance.
            along = covariance[:, index] / np.sqrt(covariance[index, index])
            for sign in (-1, 1):
                rise = search(best + sign * along)[0] - least
                assert 0.2 < rise < 1.0, (search.learned[index], sign)


@pytest.mark.slow
def test_evidence_does_not_depend_on_the_place_or_on_padding(track, fit):
    theta = jnp.asarray(fitted_coordinates(fit))
    design = Design.of(RUNG, Blocks.of(track))
    far = eqx.tree_at(lambda d: d.still.positions, design, replace_fn=lambda x: x + 1e3)
    value, moved_value = (
        evidence_and_coefficients(theta, one.regressors(theta))[0]
        for one in (design, far)
    )
    np.testing.assert_allclose(value, moved_value, rtol=1e-8)


def simple(synthetic, frequency, heading, path, times):
    """The track of a robot that goes along a path, seen with an error."""
    error = 0.05 * np.random.default_rng(0).normal(size=path.shape)
    commands = {"frequency": frequency, "heading": heading}
    return tracks(synthetic.as_recording((times, path + error, commands)))[0]


def test_constant_turning_confounds_delay_and_offset(synthetic):
    times, _, _ = synthetic.robot()
    angle = 0.4 * (times - synthetic.delay)
    path = 20.0 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    track = simple(synthetic, np.full_like(times, 2.0), 0.4 * times, path, times)
    found = delay_findings(track, gain_matrix(), fit_track(track, gain_matrix()))
    assert found.confounded
    assert found.turning_rate == pytest.approx(0.4, rel=1e-6)
    aligned = found.zero_offset
    assert aligned is not None
    held = 0.05  # a held command is half a step old already
    assert abs(aligned.value - (synthetic.delay - held)) < 3.5 * aligned.sd + 0.01
    assert aligned.sd < 0.05
    assert found.free.sd > 3 * aligned.sd


def test_random_headings_do_not_confound(track, fit, synthetic):
    found = delay_findings(track, RUNG, fit)
    assert not found.confounded
    assert abs(found.free.value - synthetic.delay) < 3.5 * found.free.sd


def test_a_split_keeps_all_samples_and_their_order(track):
    train, held_out = split(track, 0.7)
    first, last = track.span
    assert train.span[1] < first + 0.7 * (last - first) <= held_out.span[0]
    counts = [len(part.pieces[0].times) for part in (train, held_out, track)]
    assert counts[0] + counts[1] == counts[2]
    assert train.width == held_out.width == track.width
    for fraction in (0.0, 1.0, -1.0):
        with pytest.raises(InputError, match="split fraction: expected between 0 and"):
            split(track, fraction)
    with pytest.raises(InputError, match="expected 8 samples or more on both"):
        split(track, 0.999)


def test_tracks_want_samples_of_positions_alone(synthetic, paper_trajectories):
    few = synthetic.as_recording(synthetic.robot(duration=0.5))
    with pytest.raises(InputError, match="expected a trajectory of 8 samples"):
        tracks(few)
    with pytest.raises(InputError, match="recording: expected the channels x and y"):
        tracks(paper_trajectories)


def test_blocks_are_means_of_their_samples(track):
    blocks = Blocks.of(track)
    assert blocks.counts.sum() == len(track.pieces[0].times)
    assert np.all(np.diff(blocks.times) > 0)
    index = blocks.block[blocks.real]
    means = np.bincount(index, blocks.times[blocks.real]) / np.bincount(index)
    np.testing.assert_allclose(np.diff(means), track.width, atol=0.06)


def faster(part, factor):
    """The part of a track, driven at a multiple of its frequency."""
    return eqx.tree_at(
        lambda t: [piece.commands["frequency"] for piece in t.pieces],
        part,
        replace_fn=lambda frequency: factor * frequency,
    )


def test_frequencies_that_did_not_train_are_told(track):
    assert extrapolation(track, track) == ""
    assert extrapolation(track, faster(track, 0.5)) == ""
    most = max(piece.commands["frequency"].max() for piece in track.pieces)
    told = extrapolation(track, faster(track, 3.0))
    assert f"up to {3 * most:.3g} Hz, the training part at up to {most:.3g}" in told
    assert track.commanded
    assert not faster(track, 0.0).commanded, "commands that ask for nothing"


def seconds(sizes):
    """What the sizes cost: compilations, and padded samples and blocks."""
    work = sum(PER_SAMPLE * samples + PER_BLOCK * blocks for samples, blocks in sizes)
    return COMPILATION * len(set(sizes)) + work


def test_tracks_of_like_length_share_a_size_that_encloses_them():
    rng = np.random.default_rng(0)
    lengths = [*rng.integers(300, 700, 40), *rng.integers(5000, 6000, 12)]
    counts = [(int(n), int(n) // 9) for n in lengths]
    sizes = shared_sizes(counts)
    assert len(set(sizes)) == 2
    assert np.all(np.array(sizes) >= counts)
    one = [max(sizes)] * len(counts)
    own = [shared_sizes([count])[0] for count in counts]
    assert seconds(sizes) < min(seconds(one), seconds(own))
    assert shared_sizes(counts[::-1]) == sizes[::-1]


@pytest.mark.slow
def test_a_heading_that_never_changes_leaves_the_other_gain_at_zero(synthetic):
    """Its columns are proportional to each other: the information is singular."""
    times, _, _ = synthetic.robot(duration=30.0)
    constant = np.full_like(times, -1.5708)  # not quite along y, as a table says it
    frequency = np.where(times % 6 < 4, 2.0, 0.0)
    way = np.concatenate([[0.0], np.cumsum(3.0 * frequency[:-1] * np.diff(times))])
    path = np.stack([np.zeros_like(way), -way], axis=1)
    track = simple(synthetic, frequency, constant, path, times)
    fit = fit_track(track, gain_matrix())
    gain = fit.model.propulsion.gain
    np.testing.assert_allclose(gain[:, 1], [0.0, 3.0], atol=0.05)
    np.testing.assert_allclose(gain[:, 0], 0.0, atol=0.01)
    assert np.linalg.eigvalsh(fit.posterior.covariance).min() >= 0
    assert estimates(fit)["heading offset"].sd > 1.0


def test_particles_that_overlap_in_time_are_pooled_one_after_the_other():
    random, times = np.random.default_rng(3), 0.1 * np.arange(200)
    steps = 0.1 * random.normal(size=(2, 200, 2)) + np.array([0.02, -0.01])
    paths, fits = list(np.cumsum(steps, axis=1)), []
    for begins in (5.0, 40.0):
        clocks = [times, begins + times]
        pooled = Trajectories.from_arrays(clocks, paths, channels=("x", "y"))
        overlapping = eqx.tree_at(
            lambda t: [piece.times for piece in t.pieces],
            one_track(pooled, "all"),
            clocks,
        )
        assert np.all(np.diff(Blocks.of(overlapping).times) > 0)
        fits.append(fit_track(overlapping, drift_only()))
    evidence = [fit.hyperparameters.log_evidence for fit in fits]
    assert evidence[0] == pytest.approx(evidence[1], abs=0.01)
    first, apart = (fit.model.flow.velocity for fit in fits)
    np.testing.assert_allclose(first, apart, rtol=1e-3)
