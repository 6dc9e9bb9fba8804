"""The drive is found while it is recorded, and the value can be kept and read again."""

import copy
import math

import jax
import numpy as np
import pytest
from tests.rig import Robot

from pinav.codec import decode, encode
from pinav.identification.running import DriveGrid, RunningFit, forecast
from pinav.identification.running.bank import Bank, CommandHistory, Frames
from pinav.identification.running.forecast import estimate, gain_at, locate


def small_grid():
    """Four drives with two memories."""
    return DriveGrid(
        corners=np.array([np.inf, 2.0]),
        residuals=np.array([1.0, 0.3]),
        delays=np.array([0.1, 0.3]),
        drive=np.repeat(np.arange(4), 2),
        blur=np.full(8, 0.2),
        memory=np.tile([0.4, 1.2], 4),
        log_prior=np.zeros(8),
    )


def run(fit, steps, robot=None, rest=20):
    """Rest, and then a new heading every second and a half, ever faster."""
    robot = Robot() if robot is None else robot
    for step in range(steps):
        heading = math.remainder(2.4 * (step // 15), 2 * math.pi)
        frequency = 0.0 if step < rest else 1.0 + step / steps
        fit = fit.after(robot.t, robot.seen(), frequency, heading)
        robot.move(frequency, heading)
    return fit, robot


def unseen(times, frequency, heading):
    """Frames of which the commands alone are known."""
    return Frames(times, np.full((len(times), 2), np.nan), frequency, heading)


def turned_by(fit, history, times):
    """What commands have turned by some times, for each drive and memory."""
    turned = history.at(times[:, None] - fit.grid.delays)[:, fit.grid.drive]
    return np.einsum("mab,tmb->tma", fit.bank.mean[:, :, 3:], turned - turned[0])


@pytest.fixture(scope="module")
def known():
    return run(RunningFit.begin(small_grid()), 300)


def test_nothing_is_learned_before_the_first_drive():
    fit, _ = run(RunningFit.begin(small_grid()), 20)
    assert fit.bank is None
    assert fit.since is None
    assert len(fit.frames) == 3
    assert estimate(fit) is None
    assert locate(fit, 3.0) is None


def test_delay_gain_offset_and_drift_are_found(known):
    now = estimate(known[0])
    assert abs(now.delay - 0.3) < 0.02
    assert abs(now.offset - 1.4) < 0.05
    truth = 9 * (0.3 + 0.7 / math.sqrt(1 + 1 / 4))
    assert abs(now.gain - truth) < 3 * now.gain_sd
    assert now.gain_sd < 0.1 * now.gain
    assert np.hypot(now.drift[0] - 0.3, now.drift[1] + 0.2) < 0.3
    matrix, sd = gain_at(known[0], 1.5)
    assert abs(np.linalg.norm(matrix, 2) - 1.5 * 9 * (0.3 + 0.7 * 0.8)) < 4 * sd


def test_a_rollout_stays_within_its_band(known):
    fit, robot = known
    fit = fit.after(robot.t, robot.seen(), 1.5, 0.0)
    times = robot.t + 0.1 * np.arange(40)
    commands = np.full(40, 1.5), np.linspace(0, 3, 40)
    ahead = forecast(fit, times, *commands)
    twin = copy.deepcopy(robot)
    path = [(twin.x, twin.y)]
    for frequency, heading in list(zip(*commands, strict=True))[:-1]:
        twin.move(frequency, heading)
        path.append((twin.x, twin.y))
    miss = np.array(path) - path[0] - ahead.displacement
    assert np.all(np.abs(miss) < 4 * np.sqrt(ahead.variance) + 0.9)
    assert np.all(np.diff(ahead.variance[:, 0]) >= 0)
    old = forecast(fit, times, *commands, bank=fit.bank)
    assert np.allclose(old.displacement, ahead.displacement, atol=1.0)


def test_forecasts_of_many_plans_are_those_of_each(known):
    fit, robot = known
    fit = fit.after(robot.t, robot.seen(), 1.5, 0.0)
    draw, times = np.random.default_rng(0), robot.t + 0.2 * np.arange(6)
    frequency, heading = draw.uniform(0, 3, (2, 3, 6)), draw.uniform(-3, 3, (2, 3, 6))
    many = forecast(fit, times, frequency, heading)
    for place in np.ndindex(2, 3):
        one = forecast(fit, times, frequency[place], heading[place])
        assert np.allclose(many.displacement[place], one.displacement, atol=1e-12)
        assert np.allclose(many.variance[place], one.variance, atol=1e-12)


def test_a_forecast_adds_commands_to_those_that_act_late(known):
    """The mean is linear in what the history of all commands together has turned."""
    fit, robot = known
    times, none = robot.t + np.array([0.0, 0.15, 0.4, 1.0]), np.zeros(4)
    commands = np.array([2.0, 0.5, 1.0, 9.0]), np.array([0.1, 2.0, -1.0, 0.0])
    ahead, still = (forecast(fit, times, *c) for c in (commands, (none, none)))
    moved, late = (
        turned_by(fit, fit.history.extend(fit.grid, unseen(*added)), times)
        for added in ((times, *commands), (times[:1], none[:1], none[:1]))
    )
    by_drive = np.einsum("m,tma->ta", fit.bank.weight, moved - late)
    added = ahead.displacement - still.displacement
    assert np.allclose(added, by_drive, atol=1e-9)


def test_a_fit_that_is_written_goes_on_to_the_last_bit(known):
    fit, robot = known
    again = decode(RunningFit, *encode(fit))
    position = robot.seen()
    one, two = (f.after(robot.t, position, 1.0, 0.3) for f in (fit, again))
    jax.tree.map(np.testing.assert_array_equal, one, two)
    fresh = RunningFit.begin(fit.grid)
    jax.tree.map(
        np.testing.assert_array_equal, fresh, decode(RunningFit, *encode(fresh))
    )


def test_a_restart_keeps_the_drive_and_forgets_the_place(known):
    fit, _ = known
    again = fit.restart(0.0, (1000.0, -500.0), 1.0, 0.3)
    assert estimate(again).gain == estimate(fit).gain
    ahead = forecast(again, np.array([0.0, 1.0]), np.zeros(2), np.zeros(2))
    assert np.all(ahead.variance >= 0)
    robot = Robot(seed=1)
    robot.x, robot.y = 1000.0, -500.0
    robot.move(1.0, 0.3)
    again, robot = run(again, 40, robot, rest=0)
    assert abs(estimate(again).gain - estimate(fit).gain) < 3 * estimate(fit).gain_sd
    assert np.all(np.abs(again.bank.mean[:, :, 0] - (robot.x, robot.y)) < 30)


def test_the_position_is_followed_and_lost_frames_are_predicted(known):
    fit, robot = known
    place = locate(fit, robot.t - 0.1)
    assert np.all(np.abs(place.displacement[0] - (robot.x, robot.y)) < 3.0)
    for step in range(1, 30):
        fit = fit.after(robot.t + 0.1 * step, None, 0.0, 0.0)
    still = locate(fit, robot.t + 3.0)
    sooner = locate(known[0], robot.t)
    assert np.all(still.variance > sooner.variance)
    assert np.isfinite(still.displacement).all()


def test_commands_are_integrated_with_each_delay():
    grid = small_grid()
    begun = CommandHistory.begin(grid, unseen(*np.zeros((3, 1))))
    added = np.array([[1.0, 2.0], [1.0, 0.0], [0.5, 0.0]])
    history = begun.extend(grid, unseen(*added))
    turned = history.at(np.array([[0.5], [1.5], [9.0]]) - grid.delays)
    linear = turned[:, [0, 2]] @ [math.cos(0.5), math.sin(0.5)]
    assert np.allclose(linear, [[0, 0], [0.4, 0.2], [1, 1]])
    kept = history.forget(1.5)
    assert list(kept.times) == [1.0, 2.0]
    assert np.array_equal(kept.at(3.0 - grid.delays[None]), turned[-1:])


def test_the_bank_is_the_posterior_of_a_linear_model():
    """Against ordinary least squares in the limit of no wandering."""
    rng = np.random.default_rng(0)
    blur, memory = np.array([0.5]), np.array([1e-6])
    bank = Bank.prior(np.zeros(1), 1.0).place(np.zeros(2), np.array([1e-9]))
    gain, total, rows, seen = np.array([[1.0, 0.3], [-0.2, 2.0]]), np.zeros(2), [], []
    for step in range(1, 40):
        turn = rng.normal(size=2)
        total = total + turn
        bank = bank.predict(turn[None], 0.5, memory, 1.0)
        place = gain @ total + 0.05 * rng.normal(size=2)
        bank = bank.update(place, blur)
        rows.append([0.5 * step, *total])
        seen.append(place)
    rows, seen = np.array(rows), np.array(seen)
    penalty = np.diag(blur[0] / np.array([3.0, 100.0, 100.0])) ** 2
    best = np.linalg.solve(rows.T @ rows + penalty, rows.T @ seen).T
    assert np.allclose(bank.mean[0, :, 2:], best, atol=1e-6)
    assert np.array_equal(bank.covariance[0], bank.covariance[0].T)
    assert np.all(np.linalg.eigvalsh(bank.covariance[0]) > -1e-12)
