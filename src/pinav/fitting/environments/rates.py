"""Rates of change of exact states, and the force that known physics leave of them."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.dynamics import Swimmer
from pinav.fitting.matching.rate_matching import Rates
from pinav.forces import ZeroForce
from pinav.trajectories import Trajectories, informative_rows

DEGREE = 7
"""Of the splines: exact states deserve more than a cubic."""

MOST_SAMPLES = 600
"""Samples that enter a regression, at most."""


def observed_rates(trajectories: Trajectories, degree: int = DEGREE) -> Rates | None:
    """Rates of all complete samples by splines; None where there are too few."""
    from scipy.interpolate import make_interp_spline  # a tenth of all imports

    parts: list[Rates] = []
    for one in trajectories:
        complete = one.observed.all(axis=1)
        times, states = one.times[complete], one.states[complete]
        if len(times) > degree:
            # Samples without noise bear a high degree, whose derivative errs little.
            spline = make_interp_spline(times, states, k=degree)
            parts.append(Rates(times, states, spline(times, nu=1)))
    if not parts:
        return None
    return jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)


def thin_rates(rates: Rates, most: int) -> Rates:
    """The rates of the most informative samples.

    Args:
        rates: at observed states.
        most: samples that are kept.
    """
    rows = informative_rows(rates.states, most)
    return jax.tree.map(lambda array: array[rows], rates)


def residual_forces(swimmer: Swimmer, rates: Rates) -> Float[np.ndarray, "point dim"]:
    """The force at each sample that the known physics leave unexplained."""
    known = swimmer.with_environment(ZeroForce())
    explained = rates_of(known, rates.times, rates.states)
    return (rates.rates - explained)[:, rates.states.shape[1] // 2 :]


def rates_of(
    model: Any, times: Float[np.ndarray, " point"], states: Float[np.ndarray, "point n"]
) -> Float[np.ndarray, "point n"]:
    """Rates of change by a model.

    Args:
        model: swimmer or black box.
        times: of the states [T].
        states: where it is asked.
    """
    with jax.enable_x64(new_val=True):
        return np.asarray(_all_rates(model, on_device(times), on_device(states)))


@eqx.filter_jit
def _all_rates(
    model: Any, times: Float[Array, " point"], states: Float[Array, "point n"]
) -> Float[Array, "point n"]:
    return jax.vmap(lambda t, y: model(t, y))(times, states)


class ForceRegion(NamedTuple):
    """Where the unknown force acts.

    Attributes:
        center: mean position, weighted by the magnitude of the force [L].
        radius: root-mean-square distance from it for each direction [L].
    """

    center: Float[np.ndarray, " dim"]
    radius: float


def force_region(swimmer: Swimmer, rates: Rates) -> ForceRegion | None:
    """Where the force that the known physics leave unexplained acts.

    A network whose positions are standardised by this region begins with a force that
    varies over the right distance, however far the swimmer coasts beyond it.

    Args:
        swimmer: the known physics.
        rates: at observed states.

    Returns:
        The region; None where nothing acts.
    """
    rates = thin_rates(rates, MOST_SAMPLES)
    positions = rates.states[:, : rates.states.shape[1] // 2]
    sizes = np.linalg.norm(residual_forces(swimmer, rates), axis=1)
    spread = float(np.sqrt(positions.var(axis=0).mean()))
    if not (sizes.max() > ROUNDING * np.abs(rates.rates).max() and spread > 0):
        return None
    weights = sizes / sizes.sum()
    center = weights @ positions
    radius = float(np.sqrt((weights @ (positions - center) ** 2).mean()))
    return ForceRegion(center, max(radius, LEAST_RADIUS * spread))


ROUNDING = 1e-12
"""Relative to the largest rate: no force that is told from rounding."""

LEAST_RADIUS = 0.02
"""Of a region where a force acts, in standard deviations of the positions."""
