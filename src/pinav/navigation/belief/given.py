"""A belief that takes a force for granted, and estimates the state alone."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RectBivariateSpline

from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.kernel_filter import KernelFilter, WeightPosterior
from pinav.navigation.belief.kernels import (
    AbstractKernels,
    KernelGrid,
    Local,
    Points,
)
from pinav.navigation.belief.motion import AbstractMotion

Axis = Float[np.ndarray, " _"]


@dataclasses.dataclass(frozen=True, eq=False)
class GivenForce(AbstractKernels):
    """One planar force with one weight, its factor; the grid spans the arena.

    Attributes:
        splines: of each component.
    """

    splines: tuple[RectBivariateSpline, RectBivariateSpline]

    @classmethod
    def of(
        cls, axes: tuple[Axis, Axis], force: Float[np.ndarray, "x y 2"]
    ) -> "GivenForce":
        """The force whose values on a lattice are given.

        Args:
            axes: coordinates of the lattice [L].
            force: on it.
        """
        lower = np.array([along[0] for along in axes])
        grid = KernelGrid(lower, float(axes[0][-1] - axes[0][0]), (2, 2))
        x, y = (RectBivariateSpline(*axes, force[..., k]) for k in range(2))
        return cls(grid, (x, y))

    @property
    def size(self) -> int:
        return 1

    @property
    def gain(self) -> float:
        return 1.0

    def at(self, x: Float[np.ndarray, " dim"]) -> Local:
        parts = [(0, 0), (1, 0), (0, 1)]
        rates = np.array(
            [[s.ev(x[0], x[1], dx=i, dy=j) for i, j in parts] for s in self.splines]
        )
        return Local(np.zeros(1, int), rates[:, :1], rates[:, 1:, None])

    def basis(self, points: Points) -> Float[np.ndarray, "point dim weight"]:
        return np.stack(
            [s.ev(points[:, 0], points[:, 1]) for s in self.splines], axis=1
        )[..., None]

    def on_axes(
        self, axes: Sequence[Axis], weights: Float[np.ndarray, "... weight"]
    ) -> Float[np.ndarray, "... dim"]:
        force = np.stack([s(axes[0], axes[1]) for s in self.splines], axis=-1)
        return weights[..., None, None] * force


def take_for_granted(
    force: GivenForce,
    frame: Frame,
    *,
    motion: AbstractMotion,
    speed_sd: float = 0.1,
    longest: float = 0.1,
) -> Belief:
    """The belief of one who knows the force: what it learns is the state.

    Args:
        force: the force.
        frame: the first one.
        motion: what is known of the dynamics.
        speed_sd: standard deviation of each component of the first velocity.
        longest: longest step of a prediction [T].
    """
    assert frame.position is not None
    state, spread = motion.start(frame.position, frame.sd, speed_sd)
    empty = WeightPosterior.before_data(1, len(state), 0.0).reach(np.zeros(1, int))
    weights = dataclasses.replace(empty, mean=np.ones(1))
    one = KernelFilter(force, motion, state, spread, weights)
    return Belief(float(frame.time), (one,), 0, 1, longest)
