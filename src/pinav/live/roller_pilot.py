"""Steers a robot without inertia by what `RunningFit` knows of its drive.

While the drive is not known the robot moves about, by headings that turn by the golden
angle, so that it stays where it is on the whole and no two headings are alike. Then it
goes straight on, or along tangents of the discs, slower near the goal. The last word
has the filter of `pinav.live.safety`.
"""

import dataclasses
import math

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.identification.running import RunningFit, forecast
from pinav.identification.running.forecast import DriveEstimate, gain_at
from pinav.live.estimators import (
    AbstractEstimator,
    AbstractPilot,
    Advice,
    DriveEstimator,
    Intent,
)
from pinav.live.messages import Hello
from pinav.live.safety import Outlook, Reserve

GOLDEN = math.pi * (3 - math.sqrt(5))
"""Turn from one probe to the next [rad]."""

PROBE_TIME = 1.5
"""Time for which a heading is probed [s]."""

PROBE_PART = 0.3
"""Frequency of a probe, in parts of the greatest one."""

LEAST_PROBES = 6
"""Probes before the goal is aimed at."""

KNOWN = 0.15
"""Standard deviation of the gain, relative, below which the goal is aimed at."""

MARGIN = 0.1
"""By which discs are wider for the path, in parts of their radius."""

PATIENCE, PROGRESS = 30.0, 0.02
"""Time in which the way to go must shrink [s], and by which part of it."""

MOST_STALLS = 3
"""Stalls after which the pilot gives up."""

Point = Float[np.ndarray, "2"]


class RollerPilot(AbstractPilot):
    """Goes to a goal around discs.

    Attributes:
        tolerance: distance from the goal that counts as arrived [L].
        discs: centre and radius of forbidden places [L].
        probe: number of probes so far, and when the present one began [s]; NaN before.
        best: shortest way to go so far [L], and when that was [s]; NaN before.
        reserve: command kept for a next frame without a clear way.
    """

    goal: Point
    tolerance: float
    discs: Float[np.ndarray, "disc 3"]
    probe: Float[np.ndarray, "2"] = eqx.field(
        default_factory=lambda: np.full(2, np.nan)
    )
    best: Float[np.ndarray, "2"] = eqx.field(default_factory=lambda: np.full(2, np.nan))
    stalls: int = 0
    reserve: Reserve = eqx.field(default_factory=Reserve)

    def after(
        self, estimator: AbstractEstimator, hello: Hello, time: float
    ) -> tuple["RollerPilot", Advice]:
        assert isinstance(estimator, DriveEstimator)
        where = estimator.whereabouts(time)
        if where is None:
            return self, Advice(0.0, 0.0, Intent.UNREACHABLE)
        position = np.array(where.position)
        if math.dist(position, self.goal) <= self.tolerance:
            return self, Advice(0.0, 0.0, Intent.ARRIVED)
        if not self._knows(estimator.known):
            return self._look_about(estimator, hello, time, Intent.PROBE)
        pilot = self._watch_progress(position, time)
        if pilot.stalls > MOST_STALLS:
            return pilot, Advice(0.0, 0.0, Intent.GIVE_UP)
        if pilot.stalls > self.stalls or pilot._probes_still(time):
            return pilot._look_about(estimator, hello, time, Intent.STALLED)
        advice = pilot._steer(estimator, position, hello, time)
        return pilot._filter(estimator, advice, hello, time)

    def _knows(self, now: DriveEstimate | None) -> bool:
        if now is None or not self.probe[0] >= LEAST_PROBES:
            return False
        return now.gain_sd <= KNOWN * now.gain

    def _look_about(
        self, estimator: DriveEstimator, hello: Hello, time: float, intent: Intent
    ) -> tuple["RollerPilot", Advice]:
        """The next probe, or more of the present one."""
        count, begun = self.probe
        if math.isnan(count):
            count, begun = 0.0, time
        elif not 0 <= time - begun < PROBE_TIME:
            count, begun = count + 1, time
        pilot = dataclasses.replace(self, probe=np.array([count, begun]))
        frequency = PROBE_PART * hello.limits.frequency
        heading = math.remainder(float(count) * GOLDEN, 2 * math.pi)
        advice = Advice(frequency, heading, intent)
        return pilot._filter(estimator, advice, hello, time)

    def _probes_still(self, time: float) -> bool:
        """True while a probe after a stall lasts."""
        return self.stalls > 0 and bool(
            0 <= time - self.best[1] < LEAST_PROBES * PROBE_TIME
        )

    def _watch_progress(self, position: Point, time: float) -> "RollerPilot":
        """Note the way to go, and a stall where it has not shrunk for long."""
        way = math.dist(position, self.goal)
        best, since = self.best
        if math.isnan(best) or way < (1 - PROGRESS) * best or time < since:
            return dataclasses.replace(self, best=np.array([way, time]))
        if time - since < PATIENCE:
            return self
        best = np.array([way, time])
        return dataclasses.replace(self, best=best, stalls=self.stalls + 1)

    def _steer(
        self, estimator: DriveEstimator, position: Point, hello: Hello, time: float
    ) -> Advice:
        fit, now = estimator.fit, estimator.known
        assert now is not None
        start = position + self._pending(fit, now.delay, time)
        target = _way_point(start, self.goal, self.discs)
        way = target - start
        length = float(np.hypot(*way))
        if length < 1e-12:
            return Advice(0.0, 0.0, Intent.STEER, 0.0)
        frequency = hello.limits.frequency
        matrix, _ = gain_at(fit, frequency)
        try:
            aim = np.linalg.solve(matrix, way / length)
        except np.linalg.LinAlgError:
            return Advice(0.0, 0.0, Intent.UNREACHABLE)
        speed = 1.0 / float(np.hypot(*aim))
        drift = np.array(now.drift)
        aim = np.linalg.solve(matrix, way / length * speed - drift)
        # No more than half of the way to the goal in a step and the delay after it.
        slow = 0.5 * math.dist(start, self.goal) / (now.delay + hello.step)
        frequency *= min(1.0, slow / speed)
        heading = float(np.arctan2(aim[1], aim[0]))
        to_go = (length + math.dist(target, self.goal)) / speed
        return Advice(frequency, heading, Intent.STEER, to_go)

    def _pending(self, fit: RunningFit, delay: float, time: float) -> Point:
        """Way that commands which are given already will still make [L]."""
        if delay <= 0:
            return np.zeros(2)
        times = np.array([time, time + delay])
        return forecast(fit, times, np.zeros(2), np.zeros(2)).displacement[-1]

    def _filter(
        self, estimator: DriveEstimator, advice: Advice, hello: Hello, time: float
    ) -> tuple["RollerPilot", Advice]:
        """The advice, or else what the last filter gives in its place."""
        where = estimator.whereabouts(time)
        if not len(self.discs) or estimator.fit.bank is None or where is None:
            return self, advice
        outlook = Outlook(
            estimator.fit,
            time,
            hello.step,
            np.array(estimator.seen_at(time) or where.position),
            where.sd or 0.0,
            hello.limits.frequency,
            self.discs,
        )
        wanted = np.array([advice.frequency, advice.heading])
        verdict = outlook.judge(wanted, self.reserve)
        pilot = dataclasses.replace(self, reserve=verdict.reserve)
        if not verdict.changed:
            return pilot, advice
        frequency, heading = (float(number) for number in verdict.order)
        return pilot, Advice(frequency, heading, Intent.AVOID, advice.time_to_go)

    def resume(self, earlier: AbstractPilot) -> "RollerPilot":
        assert isinstance(earlier, RollerPilot)
        return dataclasses.replace(
            self,
            probe=earlier.probe,
            best=earlier.best,
            stalls=earlier.stalls,
            reserve=earlier.reserve,
        )


def _way_point(start: Point, goal: Point, discs: np.ndarray) -> Point:
    """First point to head to: the goal, or the end of a tangent of a disc."""
    nearest, target = math.inf, goal
    for x, y, radius in discs:
        centre, wide = np.array([x, y]), radius * (1 + MARGIN)
        way = goal - start
        along = float((centre - start) @ way / (way @ way))
        foot = start + min(max(along, 0.0), 1.0) * way
        distance = math.dist(start, centre)
        if math.dist(foot, centre) >= wide or distance >= nearest:
            continue
        nearest, target = distance, _tangent(start, goal, centre, wide)
    return target


def _tangent(start: Point, goal: Point, centre: Point, radius: float) -> Point:
    """Point where the shorter tangent from the start touches a circle."""
    to_centre = centre - start
    distance = float(np.hypot(*to_centre))
    if distance <= radius:  # within the margin: straight out
        return centre - to_centre / max(distance, 1e-12) * 1.5 * radius
    angle = math.asin(radius / distance)
    length = math.sqrt(distance**2 - radius**2)
    base = math.atan2(to_centre[1], to_centre[0])
    ends = [
        start + length * np.array([math.cos(base + s), math.sin(base + s)])
        for s in (angle, -angle)
    ]
    # A little beyond the point of contact, so that the next tangent leads on.
    ends = [centre + (end - centre) * 1.05 for end in ends]
    return min(ends, key=lambda end: length + math.dist(end, goal))
