"""The choice among commands of which each must have a way out.

A tube is the predicted path, and what is not known of state and surroundings about it.
"""

import numpy as np
from jaxtyping import Float

DEVIATIONS = 3.0
"""Half width of a tube, in standard deviations."""


def choose_command(
    margins: Float[np.ndarray, " command"], lead: Float[np.ndarray, " command"]
) -> int:
    """The place of the command to give; the earlier one where two are alike.

    Of the commands after which a tube can be kept out of forbidden places it is the one
    that leads on most. Where there is none it is the one that keeps farthest away.

    Args:
        margins: least distance of the tube from forbidden places along the best way out
            after each command [L]; negative where every way out meets one.
        lead: how far each leads on, in any unit.
    """
    clear = margins >= 0
    if not clear.any():
        return int(np.argmax(margins))
    return int(np.argmax(np.where(clear, lead, -np.inf)))
