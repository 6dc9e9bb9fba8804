"""`pinav navigate --learn-online` on seeds and worlds that chose nothing.

Numbers below 1000 were looked at while the controller was made. Each test prints the
figures of docs/adaptive.md; `PINAV_FLIGHTS=100 PINAV_FIRST_FLIGHT=1001 pytest
validation/test_adaptive.py -s` flies more, on odd numbers.
"""

import os
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import beta
from validation.adaptive_flights import (
    Row,
    endings,
    fly_rows,
    wander_rows,
)

FIRST = int(os.environ.get("PINAV_FIRST_FLIGHT", "1001"))
FLIGHTS = int(os.environ.get("PINAV_FLIGHTS", "20"))
GATES = int(os.environ.get("PINAV_GATES", "100"))

NUMBERS = range(FIRST, FIRST + 2 * FLIGHTS, 2)

REGRETS = {
    ("vortex", 0.0): 1.15,
    ("shear", 0.0): 1.17,
    ("barrier-weak", 0.0): 1.30,
    ("keep-out", 0.0): 1.40,
    ("many-barriers", 0.0): 1.20,  # missed by 0.02 (docs/adaptive.md)
    ("vortex", 0.2): 1.18,
    ("barrier-weak", 0.2): 1.42,
}
"""The greatest median of arrival over the oracle's, by task and delay."""

SECOND = {"vortex": 1.02, "barrier-weak": 1.12}
"""The same of a second visit with the map of the first."""

ERRORS = {
    "barrier-weak": 0.30,
    "many-barriers": 0.30,
    "fibres": 0.30,
    "vortex": 0.06,
    "shear": 0.06,
}
"""The greatest error of the force after 16 time units of being driven about."""


def spread(values: Sequence[float]) -> str:
    low, half, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{half:.3f} ({low:.3f} to {high:.3f})"


@pytest.mark.parametrize(("world", "delay"), REGRETS, ids=str)
def test_what_not_knowing_costs(world, delay):
    visits = 2 if world in SECOND and not delay else 1
    rows = list(fly_rows(world, NUMBERS, delay=delay, visits=visits))
    regrets = [row.arrival / row.oracle for row in rows]
    print(f"{world}, delay {delay:g}, {len(rows)} flights: regret {spread(regrets)}")
    show(rows)
    assert all(np.isfinite(row.arrival) for row in rows)
    assert all(row.arrival <= 3 * row.oracle for row in rows)
    assert not any(row.violated for row in rows)
    assert np.median(regrets) <= REGRETS[world, delay]
    if visits > 1:
        again = [row.second / row.oracle for row in rows]
        print(f"{world}, second visit: regret {spread(again)}")
        assert np.median(again) <= SECOND[world]


def show(rows: Sequence[Row]) -> None:
    """The other figures of some flights."""
    errors, covers = [r.error for r in rows], [r.cover for r in rows]
    stalled = sum(r.stalls > 0 for r in rows)
    print(
        f"  error {spread(errors)}, cover {np.mean(covers):.3f}, squared error of the "
        f"position over its variance {np.mean([r.consistency for r in rows]):.2f}, "
        f"least clearance {min(r.clearance for r in rows):.2f}, commands changed "
        f"{np.mean([r.changed for r in rows]):.1f}, {stalled} stalled"
    )


def test_fibres_are_crossed():
    rows = list(fly_rows("fibres", NUMBERS))
    regrets = [row.arrival / row.oracle for row in rows]
    print(f"fibres, {len(rows)} flights: regret {spread(regrets)}")
    show(rows)
    assert np.mean(np.array(regrets) <= 3.0) >= 0.95
    assert not any(row.violated for row in rows)


def test_gates_in_random_fields_are_passed_without_touching_a_disc():
    """With no violation in n runs the one-sided bound of 95 % is 3 / n.

    `PINAV_GATES=1000` flies as many as the bound of 0.5 % takes.
    """
    rows = list(fly_rows("gate", range(FIRST, FIRST + GATES), oracle=False))
    entered = [row.number for row in rows if row.violated]
    arrived = [row for row in rows if np.isfinite(row.arrival)]
    bound = beta.ppf(0.95, len(entered) + 1, len(rows) - len(entered))
    print(
        f"{len(rows)} gates: {entered} entered, at most {bound:.2%}; "
        f"{len(arrived)} arrived"
    )
    show(rows)
    assert len(entered) <= 0.005 * len(rows)
    assert bound <= 0.005 or len(rows) < 1000
    assert len(arrived) >= 0.98 * len(rows)


@pytest.mark.parametrize("world", ERRORS)
def test_what_a_wandering_swimmer_learns(world):
    lessons = list(wander_rows(world, NUMBERS))
    errors = [lesson.error for lesson in lessons]
    cover = np.mean([lesson.cover for lesson in lessons])
    consistency = np.mean([lesson.consistency for lesson in lessons])
    print(
        f"{world}: error {spread(errors)}, cover {cover:.3f}, squared error of the "
        f"position over its variance {consistency:.2f}, 99 % of a flight's frames "
        f"within {1e3 * np.median([lesson.frame for lesson in lessons]):.1f} ms"
    )
    assert np.median(errors) <= ERRORS[world]
    assert 0.88 <= cover <= 0.98
    assert 0.6 <= consistency <= 1.5


def test_campaigns_end_when_the_way_is_known():
    """A campaign ends when the belief says that the error is below a tenth."""
    informed = list(endings("vortex", "informed", NUMBERS))
    random = list(endings("vortex", "random", NUMBERS[:10]))
    counts = [
        np.median([one.trajectories for one in some]) for some in (informed, random)
    ]
    finished = [one for one in informed if one.finished]
    right = np.mean([one.error <= 0.1 for one in finished])
    print(
        f"{len(finished)} of {len(informed)} campaigns finished, {right:.3f} rightly, "
        f"true error {spread([one.error for one in finished])}; {counts[0]:g} "
        f"trajectories (median), random ones {counts[1]:g}"
    )
    assert len(finished) == len(informed)
    assert right >= 0.95
    assert counts[0] <= counts[1] / 2
