"""Progress of a swimmer, and the boldness that it needs where there is none."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

CLOCK = 1e-6
"""Times that are nearer than this are one [T]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Progress:
    """Places where a swimmer was, and the time since it came to a new one.

    A place is new if it is far from all places where the swimmer was. Who hovers comes
    nowhere new, and neither does who goes to and fro, however fast. Who goes back out
    of a dead end does not either, but as it believes the goal comes nearer.

    Attributes:
        length: distance from old places that makes a place new [L].
        places: old ones, that far apart.
        since: when it came to the last of them, nearer, or became bolder [T].
        state: in which it was then.
        patience: stalled is who came nowhere new in so long [T], and not nearer by half
            of it.
        boldness: how often the patience ended so far.
        stalled: whether it has ended since the swimmer came to a new place.
    """

    length: float
    places: Float[np.ndarray, "place 2"]
    since: float
    state: Float[np.ndarray, " state"]
    patience: float
    boldness: int = 0
    stalled: bool = False

    def after(
        self,
        time: float,
        state: Float[np.ndarray, " state"],
        time_to_go: Callable[[Float[np.ndarray, " state"]], float],
    ) -> "Progress":
        """The progress a frame later.

        Args:
            time: time of the frame [T].
            state: state of the swimmer, its position first.
            time_to_go: from a state, as the last plan has it [T]. Old and new state are
                compared by one plan, because what is learned changes all of them.
        """
        place = state[None, :2]
        new = np.min(np.linalg.norm(self.places - place, axis=1)) > self.length
        if not new and time - self.since < self.patience - CLOCK:
            return self
        places = np.concatenate([self.places, place]) if new else self.places
        gained = time_to_go(self.state) - time_to_go(state)
        stalled = not new and bool(gained < self.patience / 2)
        boldness = self.boldness + stalled
        return Progress(
            self.length, places, time, state, self.patience, boldness, stalled
        )
