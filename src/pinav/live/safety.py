"""The last word on a command of a live session: its tube is clear, and a way out kept.

A command is let through if, held for the next seconds, it keeps the tube of three
standard deviations (of state, drive and wandering) out of every disc; else one that
does so and leads on most is given. With it goes a reserve: the command that, from the
next frame on, keeps farthest away. Where that frame offers no clear command, the
reserve is followed as long as the rest of its tube is clear; else the command that has
the best chance to stay out is given. To stand still has no privilege, since a drift
pushes.
"""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from pinav.identification.running import RunningFit, forecast
from pinav.navigation.adaptive.safety import DEVIATIONS, choose_command

AHEAD = 2.0
"""Time for which a way out is followed by the tube [s]."""

CHECKS = 8
"""Pieces of the path in that time."""

HEADINGS = 8
"""Headings of commands in place of the one asked for, and of ways out."""

SLOW = 0.3
"""Frequency of the slow ones of the former, in parts of the greatest one."""

Order = Float[np.ndarray, "2"]
"""A command: frequency [Hz] and heading [rad]."""


class Reserve(eqx.Module):
    """Frequency [Hz] and heading [rad] of a way out, and its end [s] or NaN."""

    order: Order = eqx.field(default_factory=lambda: np.zeros(2))
    until: float = math.nan


class SafetyVerdict(eqx.Module):
    """The filter's verdict on a command."""

    order: Order
    reserve: Reserve
    changed: bool


class Outlook(eqx.Module):
    """Position and surroundings of a robot at a frame.

    Attributes:
        frequency: greatest frequency [Hz].
        discs: centre and radius of each [L].
    """

    fit: RunningFit
    time: float
    step: float
    position: Float[np.ndarray, "2"]
    sd: float
    frequency: float
    discs: Float[np.ndarray, "disc 3"]

    def judge(self, wanted: Order, reserve: Reserve) -> SafetyVerdict:
        """Let a command through, or give another one, by the reserve of before."""
        turns = wanted[1] + 2 * math.pi / HEADINGS * np.arange(HEADINGS)
        fast, slow, still = (
            _orders(part * self.frequency, turns) for part in (1.0, SLOW, 0.0)
        )
        firsts, escapes = wanted[None], np.concatenate([still[:1], fast])
        margins = self.clearances(firsts, firsts, AHEAD).min(axis=-1)
        if margins[0] < 0:
            firsts = np.concatenate([firsts, still[:1], slow, fast])
            margins = self.clearances(firsts, firsts, AHEAD).min(axis=-1)
        if margins.max() < 0:
            if self._is_clear(reserve):
                return SafetyVerdict(reserve.order, reserve, changed=True)
            margins = self._chances(firsts)
        lead = firsts[:, 0] * np.cos(firsts[:, 1] - wanted[1])
        best = choose_command(margins, lead)
        escapes = np.concatenate([firsts[best : best + 1], escapes])
        apart = self.clearances(firsts[best], escapes, AHEAD).min(axis=-1)
        ends = self.time + self.step + AHEAD
        reserve = Reserve(escapes[np.argmax(apart)], ends)
        return SafetyVerdict(firsts[best], reserve, changed=best > 0)

    def _chances(
        self, orders: Float[np.ndarray, "order 2"]
    ) -> Float[np.ndarray, " order"]:
        """Log of the chance that each command, held, stays out of discs.

        Pieces of a path count as independent. The least distance of the tube would not
        do to rank commands none of which is clear: it is often that of the present
        place, which no command changes, and else favours rest, whose tube is thin. Nor
        would ways out that begin later: a way out that can wait would always wait.
        """
        distance, sd = self._approaches(orders, orders, AHEAD)
        return log_ndtr(distance / np.maximum(sd, 1e-12)).sum(axis=-1)

    def _is_clear(self, reserve: Reserve) -> bool:
        """True if the rest of a reserve keeps clear, by what is known now."""
        ahead = reserve.until - self.time - self.step
        if not ahead > 0:
            return False
        return bool(self.clearances(reserve.order, reserve.order, ahead).min() >= 0)

    def clearances(
        self,
        firsts: Float[np.ndarray, "*#plan 2"],
        escapes: Float[np.ndarray, "*#plan 2"],
        ahead: float,
    ) -> Float[np.ndarray, "*plan piece"]:
        """Distance of the tube of each plan from the nearest disc [L].

        A plan gives its first command for a step, and then holds its escape for
        `ahead` seconds.
        """
        distance, sd = self._approaches(firsts, escapes, ahead)
        return distance - DEVIATIONS * sd

    def _approaches(
        self, firsts: np.ndarray, escapes: np.ndarray, ahead: float
    ) -> tuple[Float[np.ndarray, "*plan piece"], Float[np.ndarray, "*plan piece"]]:
        """Distance of each piece of the paths from the nearest disc [L], and its sd."""
        times = np.append(0.0, self.step + np.linspace(0.0, ahead, CHECKS + 1))
        firsts, escapes = np.broadcast_arrays(firsts, escapes)
        orders = np.repeat(escapes[..., None, :], len(times), axis=-2)
        orders[..., 0, :] = firsts
        plans = forecast(self.fit, self.time + times, orders[..., 0], orders[..., 1])
        sd = np.sqrt(plans.variance.max(axis=-1) + self.sd**2)
        distance = distances(self.position + plans.displacement, self.discs)
        return distance, np.maximum(sd[..., 1:], sd[..., :-1])


def distances(
    paths: Float[np.ndarray, "*plan time 2"], discs: Float[np.ndarray, "disc 3"]
) -> Float[np.ndarray, "*plan piece"]:
    """Distance of each straight piece of paths from the nearest disc [L]."""
    begin, way = paths[..., :-1, None, :], np.diff(paths, axis=-2)[..., None, :]
    to_centre = discs[:, :2] - begin
    length = np.maximum((way**2).sum(axis=-1), 1e-300)
    part = np.clip((to_centre * way).sum(axis=-1) / length, 0.0, 1.0)
    nearest = np.linalg.norm(to_centre - part[..., None] * way, axis=-1)
    return (nearest - discs[:, 2]).min(axis=-1)


def _orders(
    frequency: float, headings: Float[np.ndarray, " order"]
) -> Float[np.ndarray, "order 2"]:
    wrapped = np.remainder(headings + math.pi, 2 * math.pi) - math.pi
    return np.stack([np.full_like(headings, frequency), wrapped], axis=1)
