"""Random fields of barriers and of fibres on a square of 20 by 20."""

import jax
from jaxtyping import PRNGKeyArray

from pinav.forces import Domain, random_barriers, random_fibres
from pinav.scenarios.crossings import DAMPING, paper_swimmer, planar_system
from pinav.systems import CoastingStarts, System

SQUARE = Domain((0.0, 0.0), (20.0, 20.0))
"""Where centres and starts are."""

FIELD_SEED = 12
"""Each field is drawn once: keys of a scenario change its starts, not its world."""


def many_barriers(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
    """Twelve barriers of random height and width, at places that keep apart.

    Heights are uniform in [1, 3], widths in [1, 1.6]; the field is the same for every
    key. Starts are uniform on the square, with the velocity that drag alone would
    bring to rest at a uniform target: the median speed is 3.5, enough to climb most
    barriers. Thrust, drag and observation are those of `barrier_crossings`. Expected:
    swimmers are deflected several times, slow ones settle between the barriers and
    drift upwards with the thrust.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
        count: number of trajectories; 32 unless given.
    """
    field = random_barriers(
        SQUARE,
        12,
        heights=(1.0, 3.0),
        widths=(1.0, 1.6),
        key=jax.random.key(FIELD_SEED),
    )
    starts = CoastingStarts(lower=SQUARE.lower, upper=SQUARE.upper, damping=DAMPING)
    return planar_system("many-barriers", paper_swimmer(field), starts, key, count)


def fibres(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
    """Twelve fibres in random directions: ridges of length 2.5 and width 0.7.

    Heights are uniform in [1, 3]; the field is the same for every key. Starts, thrust,
    drag and observation are those of `many_barriers`. Expected: swimmers are reflected
    by the flanks of the ridges and slip past their ends.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
        count: number of trajectories; 32 unless given.
    """
    field = random_fibres(
        SQUARE,
        12,
        heights=(1.0, 3.0),
        length=2.5,
        width=0.7,
        key=jax.random.key(FIELD_SEED),
    )
    starts = CoastingStarts(lower=SQUARE.lower, upper=SQUARE.upper, damping=DAMPING)
    return planar_system("fibres", paper_swimmer(field), starts, key, count)
