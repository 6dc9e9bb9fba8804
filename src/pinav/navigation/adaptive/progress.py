"""Whether a swimmer gets anywhere, and how bold it has to become if not."""

import dataclasses

import numpy as np
from jaxtyping import Float

PATIENCE = 6.0
"""Stalled is who came nowhere new in so long [T]."""

CLOCK = 1e-6
"""Times that are nearer than this are one [T]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Progress:
    """Where a swimmer was, and since when it has come nowhere new.

    A place is new if it is far from all places where the swimmer was. Who hovers comes
    nowhere new, and neither does who goes to and fro, however fast.

    Attributes:
        length: distance from old places that makes a place new [L].
        places: old ones, that far apart.
        since: when it came to the last of them, or became bolder [T].
        boldness: how often the patience ended so far.
        stalled: whether it has ended since the swimmer came to a new place.
    """

    length: float
    places: Float[np.ndarray, "place 2"]
    since: float
    boldness: int = 0
    stalled: bool = False

    def after(self, time: float, place: Float[np.ndarray, "2"]) -> "Progress":
        """The progress when a swimmer is at a place [L] at a time [T]."""
        nearest = np.min(np.linalg.norm(self.places - place, axis=1))
        if nearest > self.length:
            places = np.concatenate([self.places, place[None]])
            return dataclasses.replace(self, places=places, since=time, stalled=False)
        if time - self.since < PATIENCE - CLOCK:
            return self
        return dataclasses.replace(
            self, since=time, boldness=self.boldness + 1, stalled=True
        )
