"""The drive is found while it is recorded, and the value can be kept and read again."""

import math

import jax
import numpy as np
import pytest
from tests.rig import Robot

from pinav.codec import decode, encode
from pinav.identification.running import DriveGrid, RunningFit, forecast
from pinav.identification.running.bank import Bank, CommandHistory
from pinav.identification.running.forecast import estimate, gain_at, locate

SMALL = dict(corners=(np.inf, 2.0), residuals=(1.0, 0.3), delays=(0.1, 0.3))


def small_grid():
    """Four drives with two memories."""
    drive = np.repeat(np.arange(4), 2)
    blur, memory = np.full(8, 0.2), np.tile([0.4, 1.2], 4)
    fields = {name: np.array(values) for name, values in SMALL.items()}
    return DriveGrid(
        **fields, drive=drive, blur=blur, memory=memory, log_prior=np.zeros(8)
    )


def headings(steps):
    """A new heading every second and a half."""
    return [math.remainder(2.4 * (step // 15), 2 * math.pi) for step in range(steps)]


def run(fit, steps, robot=None, rest=20):
    robot = Robot() if robot is None else robot
    for step, heading in enumerate(headings(steps)):
        frequency = 0.0 if step < rest else 1.0 + step / steps
        fit = fit.after(robot.t, robot.seen(), frequency, heading)
        robot.move(frequency, heading)
    return fit, robot


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
    steps = 40
    fit = fit.after(robot.t, robot.seen(), 1.5, 0.0)
    times = robot.t + 0.1 * np.arange(steps)
    commands = np.full(steps, 1.5), np.linspace(0, 3, steps)
    ahead = forecast(fit, times, *commands)
    twin = Robot()
    twin.__dict__.update(robot.__dict__)
    twin.pending = list(robot.pending)
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
    times = robot.t + np.array([0.0, 0.15, 0.4, 1.0])
    frequency, heading = np.array([2.0, 0.5, 1.0, 9.0]), np.array([0.1, 2.0, -1.0, 0.0])
    ahead = forecast(fit, times, frequency, heading)
    whole = fit.history.extend(fit.grid, times, frequency, heading)
    turned = whole.at(times, fit.grid.delays)[:, fit.grid.drive]
    gains = fit.bank.mean[:, :, 3:]
    moved = np.einsum("mab,tmb->tma", gains, turned - turned[0])
    still = forecast(fit, times, np.zeros(4), np.zeros(4)).displacement
    before = fit.history.extend(fit.grid, times[:1], np.zeros(1), np.zeros(1))
    turned = before.at(times, fit.grid.delays)[:, fit.grid.drive]
    late = np.einsum("mab,tmb->tma", gains, turned - turned[0])
    by_drive = np.einsum("m,tma->ta", fit.bank.weight, moved - late)
    assert np.allclose(ahead.displacement - still, by_drive, atol=1e-9)


def test_the_position_is_followed(known):
    fit, robot = known
    place = locate(fit, robot.t - 0.1)
    twin = (robot.x, robot.y)
    assert np.all(np.abs(place.displacement[0] - twin) < 3.0)


def test_a_fit_that_is_written_goes_on_to_the_last_bit(known):
    fit, robot = known
    again = decode(RunningFit, *encode(fit))
    position = robot.seen()
    one, two = (f.after(robot.t, position, 1.0, 0.3) for f in (fit, again))
    for here, there in zip(*map(jax.tree.leaves, (one, two)), strict=True):
        assert np.array_equal(here, there, equal_nan=True)
    fresh = RunningFit.begin(fit.grid)
    leaves = jax.tree.structure(fresh)
    assert jax.tree.structure(decode(RunningFit, *encode(fresh))) == leaves


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


def test_lost_frames_are_predicted(known):
    fit, robot = known
    for step in range(1, 30):
        fit = fit.after(robot.t + 0.1 * step, None, 0.0, 0.0)
    still = locate(fit, robot.t + 3.0)
    sooner = locate(known[0], robot.t)
    assert np.all(still.variance > sooner.variance)
    assert np.isfinite(still.displacement).all()


def test_commands_are_integrated_with_each_delay():
    grid = small_grid()
    history = CommandHistory.begin(grid, 0.0, 0.0, 0.0)
    history = history.extend(
        grid, np.array([1.0, 2.0]), np.array([1.0, 0.0]), np.array([0.5, 0.0])
    )
    turned = history.at(np.array([0.5, 1.5, 9.0]), grid.delays)
    linear = turned[:, [0, 2]] @ [math.cos(0.5), math.sin(0.5)]
    assert np.allclose(linear, [[0, 0], [0.4, 0.2], [1, 1]])
    kept = history.forget(1.5)
    assert list(kept.times) == [1.0, 2.0]
    assert np.array_equal(kept.at(np.array([3.0]), grid.delays), turned[-1:])


def test_the_bank_is_the_posterior_of_a_linear_model():
    """Against ordinary least squares in the limit of no wandering."""
    rng = np.random.default_rng(0)
    bank = Bank.prior(np.zeros(1), 1.0)
    blur, memory = np.array([0.5]), np.array([1e-6])
    position, gain = np.zeros(2), np.array([[1.0, 0.3], [-0.2, 2.0]])
    bank = bank.place(position, np.array([1e-9]))
    rows, seen = [], []
    total = np.zeros(2)
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
