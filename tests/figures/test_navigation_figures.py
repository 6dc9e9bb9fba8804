"""Figures of navigation show what they are given."""

import numpy as np
import pytest
from PIL import Image as Picture
from tests.samples import sample

from pinav.evaluation import FieldMap
from pinav.figures.animation import FRAMES, LAST_FRAME, Trails, save_animation
from pinav.figures.navigation import closed_loop_figure, outcome_bars, plan_map
from pinav.learning.findings import ForceMaps
from pinav.navigation import Course, Interval, Navigation, Suggestion
from pinav.navigation.comparison import PlannedWay

COURSE = Course(
    arena=np.array([[0.0, 0.0], [4.0, 3.0]]),
    start=np.array([0.5, 0.5]),
    goal=np.array([3.5, 2.5]),
    tolerance=0.3,
    discs=np.array([[2.0, 1.0, 0.4]]),
)
ROUTE = np.array([[0.5, 0.5], [3.5, 2.5]])


def maps(*, true=True, sd=True):
    """Forces on the arena, few points."""
    x, y = np.linspace(0.0, 4.0, 9), np.linspace(0.0, 3.0, 7)
    force = np.stack(np.meshgrid(np.sin(x), np.cos(y)), axis=-1)
    learned = FieldMap(x, y, force, np.zeros((7, 9)))
    truth = FieldMap(x, y, 1.1 * force, np.zeros((7, 9)))
    return ForceMaps(
        learned, truth if true else None, 0.1 * np.abs(force) if sd else None
    )


def walk(steps, length):
    """A path that ends after some steps and then stays."""
    share = np.minimum(np.arange(length) / steps, 1.0)
    return np.stack([0.5 + 3 * share, 0.5 + 2 * share], axis=1)


def test_ground_without_a_way_is_hatched_and_the_rest_is_not():
    time = np.tile(np.linspace(0.0, 5.0, 9)[:, None], (1, 7))
    open_ground = plan_map(time, COURSE)
    blocked = time.copy()
    blocked[:4] = np.inf
    closed = plan_map(blocked, COURSE, route=ROUTE)

    def hatches(ax):
        found = [getattr(artist, "hatches", None) for artist in ax.collections]
        return sum(bool(h) and any(h) for h in found)

    assert hatches(open_ground) == 0
    assert hatches(closed) == 1


@pytest.mark.parametrize(("true", "sd", "panels"), [(1, 1, 3), (1, 0, 2), (0, 0, 1)])
def test_a_panel_for_each_force_that_is_known(true, sd, panels):
    forces = maps(true=bool(true), sd=bool(sd))
    paths = {"learned": [walk(5, 9)], "oracle": [walk(4, 9)]}
    plan = sample(PlannedWay, route=ROUTE)
    suggestion = sample(Suggestion, path=ROUTE)
    known = {"plan": plan, "suggestion": suggestion, "maps": forces, "thrust": 1.0}
    figure = closed_loop_figure(sample(Navigation, course=COURSE, **known), paths)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert len([title for title in titles if title]) == panels
    keys = [text.get_text() for text in figure.legends[0].get_texts()]
    lines = ["planned route", "trajectory to record next"] if sd else []
    assert keys == [*paths, *lines]


def test_bars_show_success_with_its_interval_and_an_endless_regret():
    success = Interval(0.5, 0.3, 0.7)
    successes = dict.fromkeys(("learned", "oracle", "straight line"), success)
    regrets = {
        "learned": Interval(1.1, 1.0, np.inf),
        "straight line": Interval(np.inf, np.inf, np.inf),
    }
    left, right = outcome_bars(successes, regrets).axes
    assert [bar.get_width() for bar in left.patches] == [50.0] * 3
    assert [text.get_text() for text in right.texts] == ["∞"]


@pytest.mark.slow
def test_the_animation_has_a_frame_for_each_step_up_to_a_limit(tmp_path):
    for steps, frames in ((5, 6), (4 * FRAMES, FRAMES)):
        trails = Trails({"learned": walk(steps, steps + 30)}, 0.1)
        assert trails.steps == steps
        path = save_animation(COURSE, maps(), trails, tmp_path / "figures" / "run.gif")
        with Picture.open(path) as picture:
            assert picture.n_frames == frames
            picture.seek(frames - 1)
            assert picture.info["duration"] == LAST_FRAME
            assert picture.info["loop"] == 0
        if frames == 6:
            before = path.read_bytes()
            again = save_animation(COURSE, maps(), trails, tmp_path / "again.gif")
            assert again.read_bytes() == before
