"""Positions back in the pixels of the image that they were tracked in."""

import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.trajectories import Trajectories


def image_positions(
    recording: Trajectories, positions: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Positions in pixels, as the file of a recording has them; in images, y down.

    Args:
        recording: whose scale and flip are undone; whole or selected.
        positions: observed ones, or those of a model [L].

    Raises:
        InputError: the recording was not read from pixels.
    """
    done = recording.provenance.get("positions", {})
    if done.get("unit in the file") != "px":
        raise InputError(
            "image: positions were not read from pixels; read the recording with mpp "
            "from a file that has them"
        )
    flip = -1.0 if done["y flipped"] else 1.0
    return np.asarray(positions) / done["scale"] * np.array([1.0, flip])
