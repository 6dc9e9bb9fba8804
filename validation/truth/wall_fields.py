"""Force and diffusions of a bead above a wall: ours, of one lag, and the peer's."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from validation.truth.cases import Recording
from validation.truth.peer import PeerWall, infer_wall

from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer
from pinav.fitting import EvidenceFit, fit_langevin, profile_environment
from pinav.fitting.langevin import (
    DiffusionField,
    KernelDiffusion,
    LearnedObservation,
    SlowReference,
    slow_reference,
)
from pinav.forces import KernelAxis, Warp, ZeroForce
from pinav.trajectories import Trajectories

WARP = 0.026
"""Distance [radii] up to which the kernels are finest near the wall."""


class WallFields(NamedTuple):
    """Diffusion at heights of the centre, from the drifting wall.

    Attributes:
        heights: quantiles of those visited [um].
        along: D along the wall [um²/s].
        across: D normal to it.
        along_sd: standard deviation of D along the wall.
        across_sd: of D normal to it.
    """

    heights: Float[np.ndarray, " height"]
    along: Float[np.ndarray, " height"]
    across: Float[np.ndarray, " height"]
    along_sd: Float[np.ndarray, " height"]
    across_sd: Float[np.ndarray, " height"]


def fit_wall(
    recording: Recording,
    radius: float,
    heat: float,
    reference: SlowReference | None = None,
) -> EvidenceFit:
    """Force along z and both diffusions over a wall that drifts slowly.

    Args:
        recording: positions of one bead, z last.
        radius: of the bead [um].
        heat: thermal energy [pN um].
        reference: knots of the wall's path, and where it begins; as many as the data
            tell of, at rest, unless given.
    """
    times, positions = recording.times, recording.positions
    data = Trajectories.from_arrays([times], [positions], channels=("x", "y", "z"))
    lowest = float(np.quantile(positions[:, 2], 0.002))
    axis = KernelAxis(2, warp=Warp(lowest, WARP * radius))
    environment = profile_environment(data, (axis,))
    swimmer = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    return fit_langevin(
        BrownianSwimmer(swimmer, heat),
        data,
        diffusion=KernelDiffusion((axis,), groups=((0, 1), (2,))),
        observation=LearnedObservation(),
        einstein=True,
        reference=slow_reference(data, 2) if reference is None else reference,
    )


def wall_fields(fit: EvidenceFit, heights: Float[np.ndarray, " frame"]) -> WallFields:
    """Diffusion at 80 quantiles of the heights."""
    places = np.quantile(heights, np.linspace(0.01, 0.99, 80))
    points = np.zeros((80, 3))
    points[:, 2] = places
    assert isinstance(fit.thermal.diffusion, DiffusionField)
    values, sd = fit.thermal.diffusion(points), fit.thermal.diffusion.sd(points)
    return WallFields(places, values[:, 0], values[:, 2], sd[:, 0], sd[:, 2])


class PeerFields(NamedTuple):
    """What the peer says, at heights that were visited.

    Attributes:
        heights: ascending [um].
        said: by the peer, there.
    """

    heights: Float[np.ndarray, " height"]
    said: PeerWall

    def fields(self, ours: WallFields) -> WallFields:
        """Its diffusions at our heights, with our errors, since it gives none."""
        along, across = (
            np.interp(ours.heights, self.heights, values)
            for values in (self.said.along, self.said.across)
        )
        return ours._replace(along=along, across=across)

    def force(
        self, heights: Float[np.ndarray, " place"]
    ) -> Float[np.ndarray, " place"]:
        """Its force normal to the wall at other heights [pN]."""
        return np.interp(heights, self.heights, self.said.force)


def ask_peer(
    recording: Recording,
    heights: Float[np.ndarray, " frame"],
    heat: float,
    radius: float,
) -> PeerFields:
    """What the peer says at 400 quantiles of the heights above the learned wall."""
    positions = recording.positions.copy()
    positions[:, 2] = heights
    places = np.quantile(heights, np.linspace(0.002, 0.998, 400))
    said = infer_wall(recording.times, positions, places, heat, WARP * radius)
    return PeerFields(places, said)


def naive_fields(recording: Recording) -> WallFields:
    """Diffusion of one lag in 80 bins of height: no blur, and a wall at rest."""
    steps = np.diff(recording.positions, axis=0)
    squares = steps**2 / (2 * np.diff(recording.times)[:, None])
    starts = recording.positions[:-1, 2]
    order = np.array_split(np.argsort(starts), 80)
    heights = np.array([starts[part].mean() for part in order])
    values = np.array([squares[part].mean(axis=0) for part in order])
    along, across = values[:, :2].mean(axis=1), values[:, 2]
    relative = np.sqrt(2 / len(order[0]))
    sd = along * relative / np.sqrt(2), across * relative
    return WallFields(heights, along, across, *sd)
