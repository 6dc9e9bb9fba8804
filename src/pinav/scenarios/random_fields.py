"""Random fields of barriers and of fibres on a square of 20 by 20."""

import jax

from pinav.forces import Domain, random_barriers, random_fibres
from pinav.scenarios.crossings import DAMPING, paper_swimmer, planar_system
from pinav.scenarios.random_starts import with_random_starts
from pinav.systems import CoastingStarts, System

SQUARE = Domain((0.0, 0.0), (20.0, 20.0))
"""Where centres and starts are."""

FIELD_SEED = 12
"""Each field is drawn once: keys of a scenario change its starts, not its world."""


@with_random_starts
def many_barriers() -> System:
    """Twelve barriers of random height and width, at places that keep apart.

    Heights are uniform in [1, 3], widths in [1, 1.6]; the field is the same for every
    key. Starts are uniform on the square, with the velocity that drag alone would
    bring to rest at a uniform target: the median speed is 3.5, enough to climb most
    barriers. Thrust, drag and observation are those of `barrier_crossings`. Expected:
    swimmers are deflected several times, slow ones settle between the barriers and
    drift upwards with the thrust.

    It has 32 trajectories unless another number is given.
    """
    field = random_barriers(
        SQUARE,
        12,
        heights=(1.0, 3.0),
        widths=(1.0, 1.6),
        key=jax.random.key(FIELD_SEED),
    )
    starts = CoastingStarts(lower=SQUARE.lower, upper=SQUARE.upper, damping=DAMPING)
    return planar_system("many-barriers", paper_swimmer(field), starts)


@with_random_starts
def fibres() -> System:
    """Twelve fibres in random directions: ridges of length 2.5 and width 0.7.

    Heights are uniform in [1, 3]; the field is the same for every key. Starts, thrust,
    drag and observation are those of `many_barriers`. Expected: swimmers are reflected
    by the flanks of the ridges and slip past their ends.

    It has 32 trajectories unless another number is given.
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
    return planar_system("fibres", paper_swimmer(field), starts)
