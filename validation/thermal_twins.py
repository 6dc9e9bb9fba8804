"""Synthetic twins of the recordings of known truth, drawn without pinav's solvers.

A twin has the law of a recording and numbers that are known. Paths are those of Euler
and Maruyama with twenty steps a frame, each frame is the mean over the last steps of
it, with an error: what a camera does.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from validation.truth.cases import Recording
from validation.truth.wall_fields import fit_wall

from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer
from pinav.fitting import (
    Estimate,
    LearnedObservation,
    fit_langevin,
    profile_environment,
    warp_at_slow_end,
)
from pinav.fitting.langevin import KernelDiffusion
from pinav.fitting.langevin.diffusion import DiffusionField
from pinav.forces import (
    KernelAxis,
    ZeroForce,
    normal_mobility,
    parallel_mobility,
)
from pinav.trajectories import Trajectories

PARTS = 20
"""Steps of a frame."""


class Misses(NamedTuple):
    """Estimates less the truth in standard deviations, at places; one row a draw."""

    scores: np.ndarray

    @property
    def covered(self):
        """Part of draws and places within the 95 % band."""
        return float(np.mean(np.abs(self.scores) < 1.96))

    @property
    def bias(self):
        """Root mean square of the bias over the places, in standard deviations.

        The mean of a few draws scatters about the bias; the variance of that scatter
        is taken off.
        """
        draws = len(self.scores)
        scatter = self.scores.var(axis=0, ddof=1) / draws
        return math.sqrt(max(np.mean(self.scores.mean(axis=0) ** 2 - scatter), 0.0))

    def __str__(self):
        return f"bias {self.bias:.2f} sd, covered {100 * self.covered:.1f} %"


def forces_at(fit, points):
    """Force at points, and its standard deviation."""
    environment = fit.model.environment
    force = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))
    values = np.asarray(force(jnp.asarray(points)))
    return values, np.asarray(fit.posterior.force_sd(np.asarray(points)))


PERIOD, RING_D, RING_RATE = 2 * math.pi * 4.12, 0.273, 150
PUSH, WAVE = 0.053 * RING_D / 4.047e-3, 0.050 * RING_D / 4.047e-3


def ring_drift(x):
    """Drift of the ring [um/s]: a push that a wave all but cancels at one place."""
    return PUSH + WAVE * np.sin(2 * math.pi / PERIOD * x)


def ring_tracks(seed, tracks=3, frames=10_000, exposure=12, error=0.012):
    """Places of a few tracks, one a row, that begin in the steady state."""
    random = np.random.default_rng(seed)
    step = 1 / (RING_RATE * PARTS)
    grid = np.linspace(0, PERIOD, 400, endpoint=False)
    # Where D matters little the density is as the time spent: current over drift.
    chances = 1 / np.maximum(ring_drift(grid), 0.2)
    x = random.choice(grid, size=tracks, p=chances / chances.sum())
    seen = np.empty((frames, tracks))
    for frame in range(frames):
        total = 0.0
        kicks = math.sqrt(2 * RING_D * step) * random.normal(size=(PARTS, tracks))
        for part in range(PARTS):
            x = x + ring_drift(x) * step + kicks[part]
            if part >= PARTS - exposure:
                total = total + x
        seen[frame] = total / exposure
    return (seen + error * random.normal(size=seen.shape)).T


def judge_ring(seed):
    """Misses of drift at 90 places and of D, with blur and error learned."""
    tracks = ring_tracks(seed)
    times = np.arange(tracks.shape[1]) / RING_RATE
    data = Trajectories.from_arrays(times, tracks[..., None], channels=("x",))
    environment = profile_environment(data, (KernelAxis(0, PERIOD),))
    swimmer = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    fit = fit_langevin(swimmer, data, observation=LearnedObservation(), einstein=False)
    places = np.linspace(0, PERIOD, 90, endpoint=False)
    drift, sd = forces_at(fit, places[:, None])
    assert isinstance(fit.thermal.diffusion, Estimate)
    error = float(np.sqrt(np.mean((drift[:, 0] - ring_drift(places)) ** 2)))
    return {
        "drift": (drift[:, 0] - ring_drift(places)) / sd[:, 0],
        "D": np.array(
            [(fit.thermal.diffusion.value - RING_D) / fit.thermal.diffusion.sd]
        ),
        "error": error / float(np.sqrt(np.mean(ring_drift(places) ** 2))),
        "D relative": fit.thermal.diffusion.value / RING_D - 1,
    }


RADIUS, WALL_RATE, WALL_D, HEAT = 1.516, 60, 0.1421, 4.061e-3
WEIGHT, LAYER, DEBYE = 7.16e-3, 17 * 4.061e-3, 0.026


def wall_law(gap):
    """Diffusion normal to the wall and along it, and the force, at gaps [um]."""
    with jax.enable_x64(new_val=True):
        ratio = jnp.asarray(gap) / RADIUS
        normal = WALL_D * np.asarray(normal_mobility(ratio))
        along = WALL_D * np.asarray(parallel_mobility(ratio))
    return normal, along, LAYER / DEBYE * np.exp(-gap / DEBYE) - WEIGHT


def wall_tracks(seed, tracks=10, frames=3000, exposure=7, error=0.005):
    """Positions of a few beads above a wall, which begin in Boltzmann's law."""
    random = np.random.default_rng(seed)
    step = 1 / (WALL_RATE * PARTS)
    grid = np.geomspace(1e-3, 20.0, 4000)
    normal, along, force = wall_law(grid)
    drift = normal * force / HEAT + np.gradient(normal, grid)
    energy = LAYER * np.exp(-grid / DEBYE) + WEIGHT * grid
    chances = np.exp(-(energy - energy.min()) / HEAT) * np.gradient(grid)
    gap = random.choice(grid, size=tracks, p=chances / chances.sum())
    flat = random.uniform(size=(2, tracks))
    logs = np.log(grid)
    seen = np.empty((frames, 3, tracks))
    for frame in range(frames):
        total = np.zeros((3, tracks))
        kicks = math.sqrt(2 * step) * random.normal(size=(PARTS, 3, tracks))
        for part in range(PARTS):
            place = np.log(np.maximum(gap, 1e-3))
            across = np.interp(place, logs, normal)
            flat = flat + np.sqrt(np.interp(place, logs, along)) * kicks[part, :2]
            speed = np.interp(place, logs, drift)
            gap = gap + speed * step + np.sqrt(across) * kicks[part, 2]
            gap = np.abs(gap)
            if part >= PARTS - exposure:
                total += [*flat, gap]
        seen[frame] = total / exposure
    seen += error * random.normal(size=seen.shape)
    return np.moveaxis(seen, 2, 0)


def judge_wall(seed):
    """Misses of both diffusions and of the force at 40 gaps, with all learned."""
    tracks = wall_tracks(seed)
    times = np.arange(tracks.shape[1]) / WALL_RATE
    data = Trajectories.from_arrays(times, tracks, channels=("x", "y", "z"))
    axis = KernelAxis(2, warp=warp_at_slow_end(data, 2))
    environment = profile_environment(data, (axis,))
    swimmer = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    fit = fit_langevin(
        BrownianSwimmer(swimmer, HEAT),
        data,
        diffusion=KernelDiffusion((axis,), groups=((0, 1), (2,))),
        observation=LearnedObservation(),
        einstein=True,
    )
    return _wall_misses(fit, tracks[..., 2])


def _wall_misses(fit, heights):
    """Misses at 40 gaps; the zero of height is the mean place of the wall."""
    gaps = np.quantile(heights, np.linspace(0.02, 0.98, 40))
    points = np.stack([0 * gaps, 0 * gaps, gaps], axis=1)
    normal, along, force = wall_law(gaps)
    assert isinstance(fit.thermal.diffusion, DiffusionField)
    learned, log_sd = (
        fit.thermal.diffusion(points),
        fit.thermal.diffusion.log_sd(points),
    )
    values, sd = forces_at(fit, points)
    return {
        "D normal": np.log(learned[:, 2] / normal) / log_sd[:, 2],
        "D along": np.log(learned[:, 0] / along) / log_sd[:, 0],
        "force": (values[:, 2] - force) / sd[:, 2],
        "normal relative": float(np.sqrt(np.mean((learned[:, 2] / normal - 1) ** 2))),
        "along relative": float(np.sqrt(np.mean((learned[:, 0] / along - 1) ** 2))),
    }


DRIFT = 0.030
"""Standard deviation of the wall's path over a record [um]."""


def drift_of_wall(random, frames):
    """A slow path of the wall: half a wave and a whole one over the record [um]."""
    turns = math.pi * np.arange(frames) / frames
    sizes = random.normal(size=2)
    path = sizes[0] * np.cos(turns) + sizes[1] * np.cos(2 * turns)
    return DRIFT * (path - path.mean()) / path.std()


def judge_drifting_walls(seed, draws, frames=30_000):
    """Misses of as many single beads, each above a wall that drifts, with all learned.

    They are fitted as `python -m validation.truth` fits the recording. The path is
    scored at its knots, and by its root mean square error [um].
    """
    random = np.random.default_rng([17, seed])
    times = np.arange(frames) / WALL_RATE
    for track in wall_tracks(seed, draws, frames):
        drift = drift_of_wall(random, frames)
        seen = track + np.stack([0 * drift, 0 * drift, drift], axis=1)
        fit = fit_wall(Recording(times, seen, None), RADIUS, HEAT)
        path = fit.thermal.reference
        assert path is not None
        misses = path.values - np.interp(path.times, times, drift)
        yield {
            **_wall_misses(fit, track[:, 2]),
            "path": misses / path.sd,
            "path error": float(np.sqrt(np.mean((path(times) - drift) ** 2))),
        }
