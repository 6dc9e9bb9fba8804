"""Where a grid of kernels that was laid about data alone has none."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

REACH = 5.0
"""Distance, in widths, beyond which a kernel is nothing."""

ROUNDING = 1e-3
"""Share of their spacing by which centres may miss the places of a grid."""


class KernelGaps(eqx.Module):
    """The places of a grid at which there is no kernel.

    Attributes:
        origin: one of the places [L].
        spacing: of the grid [L].
        filled: places with a kernel, in spacings from the origin.
        around: places within the reach of a kernel of one of them, in spacings from it.
    """

    origin: Float[np.ndarray, " dim"]
    spacing: float
    filled: Int[np.ndarray, "kernel dim"]
    around: Int[np.ndarray, "place dim"]

    @classmethod
    def of(
        cls, centers: Float[np.ndarray, "kernel dim"], width: float
    ) -> "KernelGaps | None":
        """The gaps between kernels; None where these are on no square grid.

        Args:
            centers: of the kernels [L].
            width: of a kernel [L].
        """
        gaps = [gap for axis in centers.T for gap in np.diff(np.unique(axis)).tolist()]
        apart = [gap for gap in gaps if gap > ROUNDING * width]
        if not apart:
            return None
        spacing, dim = min(apart), centers.shape[1]
        places = (centers - centers[0]) / spacing
        filled = np.round(places).astype(int)
        if np.abs(places - filled).max() > ROUNDING:
            return None
        reach = int(np.ceil(REACH * width / spacing))
        axes = [np.arange(-reach, reach + 1)] * dim
        around = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
        near = (around**2).sum(axis=1) <= reach**2
        return cls(centers[0], spacing, filled, around[near])

    def in_box(self) -> Float[np.ndarray, "place dim"]:
        """Places without a kernel in the box of the kernels that there are [L]."""
        low, high = self.filled.min(axis=0), self.filled.max(axis=0)
        is_missing = np.ones(high - low + 1, bool)
        is_missing[tuple((self.filled - low).T)] = False
        return self.origin + self.spacing * (np.argwhere(is_missing) + low)

    def about(
        self, positions: Float[np.ndarray, "point dim"]
    ) -> tuple[Float[np.ndarray, "point place dim"], Bool[np.ndarray, "point place"]]:
        """Places about each position [L], and which of them have no kernel."""
        nearest = np.round((positions - self.origin) / self.spacing).astype(int)
        places = nearest[:, None] + self.around
        every = np.concatenate([self.filled, places.reshape(-1, places.shape[-1])])
        low = every.min(axis=0)
        numbers = np.ravel_multi_index(
            (every - low).T, tuple(np.ptp(every, axis=0) + 1)
        )
        is_filled = np.isin(numbers[len(self.filled) :], numbers[: len(self.filled)])
        is_missing = ~is_filled.reshape(places.shape[:2])
        return self.origin + self.spacing * places, is_missing
