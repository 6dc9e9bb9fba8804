"""Whether a swimmer gets anywhere, and how bold it has to become if not."""

import dataclasses

import numpy as np
from jaxtyping import Float

PATIENCE = 6.0
"""Stalled is who came nowhere new in so long [T], and not nearer by half of it."""

CLOCK = 1e-6
"""Times that are nearer than this are one [T]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Progress:
    """Where a swimmer was, and since when it has come nowhere new.

    A place is new if it is far from all places where the swimmer was. Who hovers comes
    nowhere new, and neither does who goes to and fro, however fast. Who goes back out
    of a dead end does not either, but as it believes the goal comes nearer.

    Attributes:
        length: distance from old places that makes a place new [L].
        places: old ones, that far apart.
        since: when it came to the last of them, nearer, or became bolder [T].
        time_to_go: the highest since then, as it was believed [T]; what is learned may
            raise it.
        boldness: how often the patience ended so far.
        stalled: whether it has ended since the swimmer came to a new place.
    """

    length: float
    places: Float[np.ndarray, "place 2"]
    since: float
    time_to_go: float
    boldness: int = 0
    stalled: bool = False

    def after(
        self, time: float, place: Float[np.ndarray, "2"], time_to_go: float
    ) -> "Progress":
        """The progress a frame later.

        Args:
            time: of the frame [T].
            place: where the swimmer is [L].
            time_to_go: as the last plan has it [T].
        """
        new = np.min(np.linalg.norm(self.places - place, axis=1)) > self.length
        if not new and time - self.since < PATIENCE - CLOCK:
            highest = max(time_to_go, self.time_to_go)
            return dataclasses.replace(self, time_to_go=highest)
        places = np.concatenate([self.places, place[None]]) if new else self.places
        nearer = time_to_go < self.time_to_go - PATIENCE / 2
        stalled = not (new or nearer)
        boldness = self.boldness + stalled
        return Progress(self.length, places, time, time_to_go, boldness, stalled)
