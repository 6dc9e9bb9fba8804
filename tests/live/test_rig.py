"""Both processes: a simulated rig with faults, and `pinav live`, by file and socket."""

import numpy as np
import pytest
from tests.live.processes import Both, kill_and_resume

pytestmark = pytest.mark.slow

STEER = ("--to=60,40", "--tolerance", "4", "--keep-out=45,10,12")


@pytest.mark.parametrize(
    ("way", "faults"),
    [
        ("file", ("garbage", "half", "repeat", "back", "lost", "swap", "truncate")),
        ("file", ("rotate", "forward", "burst")),
        ("socket", ("garbage", "repeat", "forward", "lost", "swap", "burst", "close")),
    ],
)
def test_the_goal_is_reached_through_faults_and_the_disc_is_not_entered(
    tmp_path, way, faults
):
    both = Both(tmp_path, way, *faults)
    complaint = both.wait(both.start(*STEER))
    assert "Traceback" not in complaint
    truth = both.told()
    kinds = {event["kind"] for event in both.said("event")}
    assert "arrived" in kinds, kinds
    assert np.hypot(*(truth[:, 2:4] - (45, 10)).T).min() > 12
    assert np.hypot(*(truth[:, 2:4] - (60, 40)).T).min() < 5
    expected = {"garbage": "refused", "repeat": "repeated", "lost": "lost"}
    expected |= {"back": "jump", "forward": "jump", "swap": "reacquired"}
    expected |= {"rotate": "source", "truncate": "source", "close": "source"}
    assert {expected[fault] for fault in faults if fault in expected} <= kinds
    known = [state for state in both.said("state") if state["gain"] is not None]
    assert abs(known[-1]["offset"] - 1.4) < 0.15
    assert abs(known[-1]["gain"] - 9 * (0.3 + 0.7 * 2 / 5**0.5)) < 1.0


def test_a_killed_session_goes_on_as_if_nothing_had_been(tmp_path):
    """Killed at random frames; the belief is that of a session that lived on."""
    kill_and_resume(tmp_path, 3, 2.5)
