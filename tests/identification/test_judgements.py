"""What is said of a candidate: rollouts, bands, intervals, and which one is chosen."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import dblquad
from tests.samples import stand_in

from pinav.evaluation.coverage import normal_quantile
from pinav.fitting import Estimate, EvidenceFit
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.identification import candidates, selection
from pinav.identification.baselines import least_squares
from pinav.identification.candidates import system_of
from pinav.identification.drive import RESPONSES
from pinav.identification.findings import (
    DelayFindings,
    finding_sentences,
    positive_interval,
    turning_rate,
)
from pinav.identification.forecast import Forecast, FrameJitter, Predictor
from pinav.identification.identify import (
    IdentifiedTrack,
    alternate_lengths,
    pooled_coverage,
    summarise,
)
from pinav.identification.parameters import (
    CORNER,
    DELAY,
    GAIN,
    PARAMETERS,
    RESIDUAL,
    Prior,
    Scale,
)
from pinav.identification.rollouts import (
    RADIUS_90,
    Coverage,
    ErrorGrowth,
    Errors,
    Paths,
    Rollouts,
    coverage,
    errors,
)
from pinav.identification.running import DriveGrid, RunningFit
from pinav.identification.running.bank import Bank, rows, wandering
from pinav.identification.running.forecast import estimate, gain_at
from pinav.identification.selection import LEAST_SQUARES as LEAST
from pinav.identification.selection import Row, Selection
from pinav.identification.tracks import Track
from pinav.recordings.drive import pairs_apart
from pinav.trajectories import Trajectory

RNG = np.random.default_rng(4)


def track_of(*pieces):
    """A track of pieces of (times, positions, frequency, heading)."""
    made = [
        Trajectory(
            times, states, np.ones_like(states, bool), {"frequency": f, "heading": a}
        )
        for times, states, f, a in pieces
    ]
    return Track("robot", tuple(made), 0.5, (256, 96))


def driven(duration=30.0, step=0.1, begin=0.0):
    """A robot that follows a gain matrix and a drift at once, without noise."""
    times = begin + np.arange(0, duration, step)
    heading = 0.7 * times
    frequency = np.where(times % 6 < 4, 1.0 + 0.1 * times, 0.0)
    command = frequency[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    velocity = command @ MATRIX.T + DRIFT
    path = np.concatenate([[[0, 0]], np.cumsum(step * velocity[:-1], axis=0)])
    return times, path, frequency, heading


MATRIX, DRIFT = np.array([[2.0, -0.5], [0.8, 1.5]]), np.array([0.3, -0.2])


def rest(piece):
    """A forecast that stands still, with a variance that grows with time."""

    def variance(first, last):
        times = piece.times[first : last + 1]
        return np.outer(times - times[0], [1.0, 4.0])

    return stand_in(
        Forecast,
        piece=piece,
        path=np.zeros_like(piece.states),
        rollout=lambda a, b: np.tile(piece.states[a], (b - a + 1, 1)),
        variance=variance,
    )


PREDICTOR = stand_in(Predictor, forecast=rest)


def straight(speed, duration=21.0, begin=0.0):
    times = begin + np.arange(0, duration, 0.5)
    states = np.outer(times - begin, [speed, 0.0])
    return times, states, np.ones_like(times), np.zeros_like(times)


def test_rollouts_begin_every_five_seconds_and_end_after_the_horizon():
    track = track_of(straight(1.0), straight(2.0, 7.0, 100.0))
    rollouts = Rollouts.of(track, 5.0)
    assert rollouts.piece.tolist() == [0, 0, 0, 0, 1]
    assert rollouts.first.tolist() == [0, 10, 20, 30, 0]
    assert (rollouts.last - rollouts.first == 10).all()
    assert np.allclose(rollouts.lengths(track), [5, 5, 5, 5, 10])
    found = errors(track, rollouts, lambda piece: 0.9 * piece.states)
    assert found.rollouts == 5
    assert np.isclose(found.relative, 0.1)
    assert np.isclose(found.median, 0.5)
    assert errors(track, Rollouts.of(track, 30.0), lambda p: p.states).rollouts == 0


@pytest.mark.parametrize(("share", "held"), [(0.999, True), (1.001, False)])
def test_a_band_holds_what_lies_within_its_ninety_percent(share, held):
    size = share * normal_quantile(0.9)
    times = np.arange(0, 10.5, 0.5)
    states = size * np.sqrt(times)[:, None] * [1.0, 2.0]
    track = track_of((times, states, np.ones_like(times), np.zeros_like(times)))
    found = coverage(track, Rollouts.of(track, 10.0), PREDICTOR)
    assert (found.inside, found.at_end, found.rollouts) == (held, held, 1)


def test_errors_grow_as_those_of_each_length():
    track = track_of(straight(3.0))
    growth = ErrorGrowth.of(track, PREDICTOR, lambda piece: 0.5 * piece.states)
    assert np.allclose(growth.errors, 3 * growth.lengths)
    assert np.allclose(growth.reference, 1.5 * growth.lengths)
    assert np.allclose(growth.promised, RADIUS_90 * np.sqrt(2.5 * growth.lengths))
    assert growth.lengths.max() == 20
    assert growth.rollouts.tolist() == [4, 4, 4, 4, 4, 3, 3, 2, 1]
    # Of two normal numbers with the same deviation 90 % lie within this radius.
    assert np.isclose(1 - math.exp(-(RADIUS_90**2) / 2), 0.9)
    shown = Paths.of(track, PREDICTOR, Rollouts.of(track, 10.0)).rollouts
    assert [one.start for one in shown] == [0.0, 5.0, 10.0]
    assert np.allclose(shown[1].predicted, [15.0, 0.0])
    assert np.allclose(shown[1].sd, np.sqrt([10.0, 40.0]))


def test_least_squares_find_gain_and_drift():
    # Velocities are differences over a second, so that a slow change is needed.
    times = np.arange(0, 60, 0.05)
    heading, frequency = 0.02 * times, 1 + 0.01 * times
    command = frequency[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    steps = 0.05 * (command @ MATRIX.T + DRIFT)
    states = np.concatenate([[[0, 0]], np.cumsum(steps[:-1], axis=0)])
    track = track_of((times, states, frequency, heading))
    displacement = least_squares(track)
    assert np.allclose(displacement(track.pieces[0]), states, atol=0.05)


def test_scales_are_their_own_inverse_and_slope():
    for scale, at in itertools.product(Scale, (-1.3, 0.4)):
        assert math.isclose(scale.coordinate(scale.number(at)), at)
        change = (scale.number(at + 1e-6) - scale.number(at - 1e-6)) / 2e-6
        assert math.isclose(scale.slope(at), change, rel_tol=1e-6)
    assert math.isnan(Scale.LOG.coordinate(0.0))


def test_priors_scale_with_speed_and_frequency():
    one = track_of(driven())
    times, states, frequency, heading = driven()
    faster = Prior.of(track_of((times, 3 * states, frequency, heading)))
    oftener = Prior.of(track_of((times, states, 2 * frequency, heading)))
    base = Prior.of(one)
    by_speed = np.exp(faster.mean - base.mean)
    scaled = {"still": 3, "driven": 3, "noise": 3, "slow": 3, "gain wander": 3}
    assert np.allclose(by_speed, [scaled.get(p.name, 1) for p in PARAMETERS])
    scaled = {"corner": 2, "gain wander": 0.5}
    by_frequency = np.exp(oftener.mean - base.mean)
    assert np.allclose(by_frequency, [scaled.get(p.name, 1) for p in PARAMETERS])
    low, high = base.bounds().T
    assert np.allclose(high, base.mean + 5 * base.sd)
    delay = [p.path for p in PARAMETERS].index(DELAY)
    others = np.arange(len(low)) != delay
    assert np.allclose(low[others], (base.mean - 5 * base.sd)[others])
    assert low[delay] == 0.0


def test_intervals_hold_ninety_five_percent():
    half = normal_quantile(0.95)
    plain = Estimate(3.0, 2.0)
    assert np.allclose([plain.low, plain.high], [3 - 2 * half, 3 + 2 * half])
    low, high = positive_interval(Estimate(3.0, 0.6))
    assert np.allclose(np.log([low / 3, high / 3]), [-0.2 * half, 0.2 * half])


def test_the_rate_of_turning_is_that_of_driven_pairs():
    times = np.arange(0, 40, 0.1)
    turns = np.where(times < 20, 0.5 * times, 10 - 3 * (times - 20))
    frequency = np.where(times < 20, 1.0, 0.0)
    wrapped = (turns + np.pi) % (2 * np.pi) - np.pi
    rate, spread = turning_rate(
        track_of((times, times[:, None] * [1, 0], frequency, wrapped))
    )
    assert np.isclose(rate, 0.5)
    assert spread < 0.3
    first, last = pairs_apart(np.array([0.0, 1.0, 2.0, 5.0]), 2.0)
    assert (first.tolist(), last.tolist()) == ([0, 1, 2], [2, 3, 3])


def test_long_and_short_tracks_take_turns():
    several = [track_of(straight(1.0, d)) for d in (5.0, 9.0, 1.0, 7.0, 3.0)]
    assert alternate_lengths(several) == [1, 2, 3, 4, 0]


def row_of(name, evidence, error=0.1, reason=""):
    by_horizon = {f"{h:g}": Errors(error, 2 * error, 3) for h in (1, 5, 10, 30)}
    return Row(name, evidence, 1.0, by_horizon, 0.5, reason)


def test_a_summary_adds_evidence_and_takes_medians():
    several = [
        IdentifiedTrack(
            f"{i}",
            1.0,
            chosen="a + b",
            coverage=Coverage(share, 0.0, count),
            rows=(row_of("a", 1.0 + i, error), row_of("a + b", 5.0, error)),
        )
        for i, (error, share, count) in enumerate(
            [(0.1, 1.0, 1), (0.4, 0.5, 3), (0.2, 0.0, 0)]
        )
    ]
    several.append(IdentifiedTrack("x", 1.0, rows=(row_of("a", np.nan, reason="no"),)))
    summary = summarise(several)
    assert set(summary) == {"a", "+ b", "chosen"}
    assert summary["a"].log_evidence == 6.0
    assert summary["a"].tracks == 3
    assert summary["chosen"].over(10.0).relative == 0.2
    assert summary["chosen"].over(10.0).rollouts == 9
    assert np.isclose(pooled_coverage(several), 0.625)
    assert np.isnan(pooled_coverage(several[2:3]))
    assert several[0].row("a + b").over(10.0).relative == 0.1
    assert several[0].row("other") is None


def test_jitter_is_told_along_and_across_the_heading():
    times = np.arange(0, 400, 0.05)
    heading = np.full_like(times, 0.6)
    frequency = (times < 300).astype(float)
    cosine, sine = math.cos(0.6), math.sin(0.6)
    frame = np.array([[cosine, sine], [-sine, cosine]])
    noise = RNG.standard_normal((len(times), 2)) * [0.3, 0.1]
    noise = np.where(
        frequency[:, None] > 0, noise @ frame, 0.2 * RNG.standard_normal(noise.shape)
    )
    track = track_of((times, noise, frequency, heading))
    jitter = FrameJitter.of(track, lambda piece: np.zeros_like(piece.states))
    kept = 1 - 1 / 11  # of the variance about the mean of eleven frames
    assert np.allclose(jitter.driven / kept, [0.09, 0.01], rtol=0.1)
    assert np.isclose(jitter.still / kept, 0.04, rtol=0.1)
    assert np.isclose(jitter.deviation**2, jitter.driven.mean())
    along, across = jitter.driven
    expected = frame.T @ np.diag([along, across]) @ frame
    variance = jitter.variance(track.pieces[0])
    assert np.allclose(variance[0], np.diag(expected))
    assert np.allclose(variance[-1], jitter.still)


def test_the_wandering_velocity_has_the_moments_of_its_process():
    tau, dt, frequency = 0.7, 0.9, 2.25
    place, cross, velocity = (
        float(one[0]) for one in wandering(dt, np.array([tau]), frequency)
    )
    # Begun at a velocity that is known, and of the strength of the bank.
    strength = 0.3**2 + 1.5

    def covariance(s, t):
        return strength * (math.exp(-abs(t - s) / tau) - math.exp(-(t + s) / tau))

    both, _ = dblquad(covariance, 0, dt, 0, dt)
    assert np.isclose(place, both, rtol=1e-5)
    times = np.linspace(0, dt, 20001)
    along = np.trapezoid([covariance(s, dt) for s in times], times)
    assert np.isclose(cross, along, rtol=1e-5)
    assert np.isclose(velocity, covariance(dt, dt))
    row = rows(np.array([[5.0, 6.0]]), dt, np.array([tau]))[0]
    reach = tau * (1 - math.exp(-dt / tau))
    assert np.allclose(row, [1.0, reach, dt, 5.0, 6.0])


NOISE = {"still": 0.5, "driven": 0.4, "memory": 2.0}


def test_the_system_of_a_fit_has_the_priors_of_its_estimates():
    model = candidates.with_response(candidates.gain_matrix(), "slipping").swimmer
    values = {CORNER: (4.0, 1.0), RESIDUAL: (0.3, 0.1), DELAY: (0.2, 0.05)}
    noise = {f"wandering.{n}": (v, 0.1) for n, v in NOISE.items()}
    known = {path: Estimate(*pair) for path, pair in (values | noise).items()}
    known[f"{GAIN}[0, 0]"] = Estimate(1.0, 0.1)
    fit = stand_in(EvidenceFit, model=model, constants=known)
    system = system_of(fit, jitter=0.7, name="robot", units={"x": "um", "t": "s"})
    priors = {number.path: number.prior for number in system.learn}
    assert math.isclose(priors[CORNER].median, 4.0)
    assert math.isclose(priors[CORNER].deviation, 0.25)
    assert (priors[RESIDUAL].mean, priors[RESIDUAL].deviation) == (0.3, 0.1)
    assert (priors[DELAY].mean, priors[DELAY].deviation) == (0.2, 0.05)
    assert GAIN in priors
    assert system.noise == 0.7
    assert {name: getattr(system.wandering, name) for name in NOISE} == NOISE


def fit_of(log_evidence):
    chosen = SimpleNamespace(log_evidence=log_evidence)
    return stand_in(EvidenceFit, hyperparameters=chosen, model=None)


NAMES = {
    r: candidates.with_response(candidates.gain_matrix(), r).name for r in RESPONSES
}
SLIPPING = NAMES["slipping"]


@pytest.mark.parametrize(
    ("evidence", "chosen"),
    [
        ({}, SLIPPING),
        ({NAMES["linear"]: DECISIVE + 0.1}, NAMES["linear"]),
        ({NAMES["linear"]: DECISIVE - 0.1}, SLIPPING),
        ({f"{SLIPPING} + delay": 0.1}, f"{SLIPPING} + delay"),
        ({f"{SLIPPING} + lag": DECISIVE - 0.1}, SLIPPING),
        ({f"{SLIPPING} + lag": DECISIVE + 0.1}, f"{SLIPPING} + lag"),
    ],
)
def test_more_is_chosen_only_where_the_evidence_is_decisive(
    monkeypatch, evidence, chosen
):
    def fit_track(track, system, *, start=None, wandering_gain=False):
        low = -50.0 if "delay" in system.name or "drift" in system.name[8:] else -1.0
        value = evidence.get(system.name, 0.0 if system.name == SLIPPING else low)
        value = value + 0.2 * wandering_gain
        return stand_in(
            EvidenceFit, hyperparameters=SimpleNamespace(log_evidence=value), model=None
        )

    monkeypatch.setattr(selection, "fit_track", fit_track)
    monkeypatch.setattr(
        selection.forecast, "path_of", lambda _: lambda piece: 0.5 * piece.states
    )
    track = track_of(driven(100.0))
    choice = Selection(track, *selection.split(track, 0.7))
    choice.compare_candidates()
    assert choice.chosen == chosen
    assert choice.wandering is not None
    assert choice.train.span[1] < 70 <= choice.held_out.span[0]
    assert {row.name for row in choice.rows} >= set(NAMES.values())


def test_sentences_tell_differences_of_evidence_and_intervals():
    track = track_of(driven())
    bases = (candidates.drift_only(), candidates.scalar_gain())
    system = candidates.with_response(candidates.gain_matrix(), "slipping")
    simpler = [candidates.like(base, system).name for base in bases]
    evidence = {**dict.fromkeys(NAMES.values(), -1.0), SLIPPING: DECISIVE}
    evidence[NAMES["linear"]] = 0.0
    evidence |= dict(zip(simpler, (2 * DECISIVE + 0.1, DECISIVE - 1.0), strict=True))
    lag = f"{SLIPPING} + lag"
    known = stand_in(
        Selection,
        train=track,
        held_out=track,
        rows=[
            row_of(n, e) for n, e in ((SLIPPING, DECISIVE), (lag, 0.5), (LEAST, 0.0))
        ],
        candidates={SLIPPING: system},
        chosen=SLIPPING,
        wandering=None,
        fits={name: fit_of(value) for name, value in evidence.items()},
    )
    numbers = {"corner": Estimate(4.0, 0.4), "residual": Estimate(0.3, 0.1)}
    free, offset = Estimate(0.2, 0.1), Estimate(0.1, 0.01)
    delays = DelayFindings(
        free, offset, Estimate(0.5, 0.02), free, 2.0, confounded=False
    )
    text = " ".join(finding_sentences(known, numbers, delays))
    nats = DECISIVE + 0.1
    assert (
        f"Propulsion by the command: not supported, {nats:.1f} nats against it" in text
    )
    assert "the heading as recorded: undecided (+1.0 nats)" in text
    assert f"(slipping): supported, by {DECISIVE:.1f} nats" in text
    assert "corner 4 Hz (3.3 to 4.9)" in text
    assert "residual gain 0.3 ± 0.2" in text
    assert "Delay 0.2 ± 0.2 s with the heading offset free (5.7 ± 0.6 degrees)" in text
    assert f"lag of the heading: undecided ({0.5 - DECISIVE:+.1f} nats)" in text
    steady = DelayFindings(
        free, offset, Estimate(0.5, 0.02), None, 2.0, confounded=True
    )
    text = " ".join(finding_sentences(known, numbers, steady))
    assert (
        "constant rate (115 degrees/s): without delay the offset is 28.6 ± 1.1" in text
    )
    assert "every 0.1 s of delay turns it by 11.5" in text


def test_the_gain_of_a_bank_has_the_spread_within_and_between_its_members():
    weight, sigma2 = np.array([0.25, 0.75]), np.array([0.5, 2.0])
    mean, covariance = np.zeros((2, 2, 5)), np.zeros((2, 5, 5))
    mean[0, :, 3:], mean[1, :, 3:] = [[1.0, 0.2], [0.3, 2.0]], [[4.0, -1.0], [1.0, 3.0]]
    covariance[:, 3, 3], covariance[:, 4, 4] = [0.1, 0.2], [0.3, 0.4]
    bank = Bank(mean, covariance, np.log(weight), sigma2 * 9, 10.0)
    grid = DriveGrid(
        corners=np.array([np.inf, 1.0]),
        residuals=np.array([1.0, 0.2]),
        delays=np.array([0.1]),
        drive=np.array([0, 1]),
        blur=np.ones(2),
        memory=np.ones(2),
        log_prior=np.zeros(2),
    )
    fit = RunningFit(grid, bank)
    turned = np.array([2.0, 0.2 * 2 + 0.8 * 2 / math.sqrt(5)])
    gains = mean[:, :, 3:] * turned[:, None, None]
    draws = [weight @ gains.reshape(2, 4) ** k for k in (1, 2)]
    inside = weight @ (np.array([0.2, 0.3]) * turned**2 * sigma2)
    matrix, sd = gain_at(fit, 2.0)
    assert np.allclose(matrix.ravel(), draws[0])
    assert np.isclose(sd**2, (draws[1] - draws[0] ** 2).mean() + inside)
    now = estimate(fit)
    at_one = np.array([1.0, 0.2 + 0.8 / math.sqrt(2)])
    mixed = np.einsum("m,mab->ab", weight * at_one, mean[:, :, 3:])
    along, across = mixed[0, 0] + mixed[1, 1], mixed[1, 0] - mixed[0, 1]
    assert np.isclose(now.offset, math.atan2(across, along))
    assert np.isclose(now.gain, math.hypot(along, across) / 2)
