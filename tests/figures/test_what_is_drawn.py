"""Lines, bands and shapes lie where the numbers say that they do."""

from types import SimpleNamespace

import numpy as np
from matplotlib.patches import Circle, Rectangle
from tests.samples import stand_in

from pinav.evaluation import FieldMap
from pinav.evaluation.coverage import normal_quantile
from pinav.evaluation.force_fields import ForceLine, Regions
from pinav.figures import fits, heat, learned_tissue, maps, navigation
from pinav.figures.style import new_figure
from pinav.learning.findings import Findings, ForceMaps
from pinav.learning.thermal import ThermalFindings
from pinav.navigation.adaptive.flight import ShownFlight
from pinav.navigation.comparison import Navigation, OnlineNavigation, PlannedWay
from pinav.navigation.design.campaign import Decision, DesignResult
from pinav.navigation.task.task import Course
from pinav.thermal.learned_tissue import FOLLOWED, Forecast
from pinav.thermal.learning import PerfusionCurve

Z95 = normal_quantile(0.95)
UNITS = {"x": "um", "y": "um", "t": "s"}

HALF = normal_quantile()
"""Half width of a band of 95 %, in standard deviations."""


def panel(**options):
    return new_figure(4.0, 3.0).add_subplot(**options)


def lines(ax):
    """The data of lines that are long enough to be curves."""
    return [np.array(line.get_xydata()) for line in ax.get_lines()]


def drawn(ax, x, y):
    """Whether a line of these points was drawn."""
    points = np.stack(np.broadcast_arrays(x, y), axis=1)
    return any(
        one.shape == points.shape and np.allclose(one, points, equal_nan=True)
        for one in lines(ax)
    )


def ends_of_bands(ax):
    """Least and greatest height of each filled band."""
    boxes = [path.get_extents() for c in ax.collections for path in c.get_paths()]
    return [(box.y0, box.y1) for box in boxes]


def test_contours_lie_on_the_cells_of_the_image():
    spacing = 1e-3, 2e-3
    x = (np.arange(6) + 0.5)[:, None] * np.ones(4)
    ax = panel()
    inside = (x > 2.6).astype(float)
    heat.plane_map(x, spacing, levels=[3.0], label="T", outline=inside, ax=ax)
    (image,) = ax.images
    assert image.get_extent() == [0, 6, 0, 8]
    assert np.allclose(image.get_array(), x.T)
    outline, level = (c.get_paths()[0].vertices for c in ax.collections)
    assert np.allclose(outline[:, 0], 3.0)
    assert np.allclose(level[:, 0], 3.0)
    assert np.allclose([outline[:, 1].min(), outline[:, 1].max()], [1, 7])
    ax = panel()
    heat.plane_map(10.0**x, spacing, levels=[1e3], label="D", logarithmic=True, ax=ax)
    assert np.allclose(ax.images[0].get_array(), x.T)
    assert np.allclose(ax.collections[0].get_paths()[0].vertices[:, 0], 3.0)


def test_a_forecast_has_bands_of_ninety_five_percent():
    times, count = np.array([60.0, 120.0]), len(FOLLOWED)
    values = np.arange(count) + np.array([[40.0], [41.0]])
    sd = 0.1 * (1 + np.arange(count)) * np.ones((2, 1))
    found = Forecast(times, values, sd, 60.0, values + 0.3)
    above, below = learned_tissue.forecast_figure("", found).draw().axes
    for index in range(count):
        assert drawn(above, [1, 2], values[:, index])
        assert drawn(above, [1, 2], values[:, index] + 0.3)
        assert drawn(below, [1, 2], HALF * sd[:, index])
        assert drawn(below, [1, 2], -HALF * sd[:, index])
    assert drawn(below, [1, 2], 0.3)
    assert drawn(above, [1, 1], [0, 1])
    ends = ends_of_bands(below)
    assert np.allclose(ends, [(-HALF * s, HALF * s) for s in sd[0]])
    kelvin, flow = np.array([37.0, 40.0, 43.0]), np.array([1.0, 2.0, 3.0])
    law = PerfusionCurve(kelvin, flow, np.full(3, 0.1), (37.0, 40.0), flow + 0.5)
    ax = learned_tissue.perfusion_law(law)
    assert drawn(ax, kelvin, flow + 0.5)
    assert drawn(ax, kelvin, [1, 2, np.nan])
    assert np.allclose(ends_of_bands(ax), [(np.exp(-0.196), 3 * np.exp(0.196))])


def test_forces_and_thermal_numbers_have_bands_of_ninety_five_percent():
    places, mean, sd = np.arange(3.0), np.array([1.0, 2.0, 4.0]), np.full(3, 0.5)
    line = ForceLine(places, mean, sd, mean + 1)
    thermal = stand_in(
        ThermalFindings,
        lines={
            "x": SimpleNamespace(
                places=places,
                values=np.stack([mean, mean], 1),
                sd=np.stack([sd, sd], 1),
            )
        },
        channels=("x", "y"),
        reference=SimpleNamespace(times=places, values=mean, sd=sd),
    )
    fit = stand_in(Findings, lines={"x": line}, units=UNITS, thermal=thermal)
    pictures = [*fits.force_line_figures(fit), *fits.thermal_figures(fit)]
    for picture in pictures:
        (ax,) = picture.draw().axes
        assert drawn(ax, places, mean)
        assert np.allclose(ends_of_bands(ax), [(1 - 0.5 * Z95, 4 + 0.5 * Z95)])
    assert drawn(pictures[0].draw().axes[0], places, mean + 1)
    assert pictures[1].draw().axes[0].get_ylabel() == "diffusion [µm²/s]"
    shown = stand_in(
        ShownFlight,
        truth=np.ones((3, 2)),
        mean=np.zeros((3, 2)),
        sd=np.full((3, 2), 0.2),
    )
    flights = stand_in(OnlineNavigation, shown=shown, step=0.5, units=UNITS)
    for ax in fits.bands_figure(flights).axes:
        assert drawn(ax, [0, 0.5, 1.0], [1, 1, 1])
        assert np.allclose(ends_of_bands(ax), [(-0.2 * Z95, 0.2 * Z95)])


def flat_map(force=(3.0, 4.0)):
    x, y = np.linspace(0, 6, 7), np.linspace(0, 4, 5)
    there = np.broadcast_to(np.array(force), (5, 7, 2)).copy()
    return FieldMap(
        x, y, there, np.broadcast_to(x / 6, (5, 7)).copy(), Regions(0.2, 0.6)
    )


def test_trust_is_size_over_deviation_and_arrows_fill_their_cells():
    field = flat_map()
    sd = np.broadcast_to([0.6, 0.8], (5, 7, 2))
    ax = maps.trust_map(field, sd)
    assert np.allclose(ax.collections[0].get_array(), 5.0)
    ax = panel()
    maps.draw_arrows(ax, field.x, field.y, field.force, 2.5)
    (arrows,) = ax.collections
    assert np.allclose([arrows.U[0], arrows.V[0]], [1.5, 2.0])
    # As long as 1.2 of the spacing where the force is the largest that is shown.
    assert np.isclose(2.5 / arrows.scale, 1.2)
    assert (len(set(arrows.X)), len(set(arrows.Y))) == (7, 5)


def planned_in_space(course, route):
    plan = stand_in(PlannedWay, route=route)
    return stand_in(Navigation, course=course, plan=plan, units=UNITS)


def course(dim=2, radius=1.5):
    return stand_in(
        Course,
        arena=np.array([[0.0] * dim, [10.0] * dim]),
        start=np.full(dim, 1.0),
        goal=np.full(dim, 8.0),
        tolerance=0.5,
        discs=np.array([[*[4.0, 5.0, 6.0][:dim], radius]]),
    )


def test_a_course_shows_discs_goal_and_arena_in_their_sizes():
    ax = panel()
    navigation.draw_course(ax, course())
    rectangle, *circles = ax.patches
    assert isinstance(rectangle, Rectangle)
    assert (rectangle.get_xy(), rectangle.get_width()) == ((0, 0), 10)
    assert [(tuple(c.center), c.radius) for c in circles] == [
        ((4, 5), 1.5),
        ((8, 8), 0.5),
    ]
    assert drawn(ax, [8.0], [8.0])
    assert drawn(ax, [1.0], [1.0])
    assert np.allclose([*ax.get_xlim(), *ax.get_ylim()], [-0.2, 10.2] * 2)


def test_a_course_in_space_has_its_balls_in_every_projection():
    route = np.linspace(1, 8, 5)[:, None] * [1.0, 0.5, 0.25]
    figure = navigation.space_figure(
        planned_in_space(course(3), route), {"oracle": [route + 1]}
    )
    perspective, *planes = figure.axes
    wide = planned_in_space(course(3, 7.0), route)
    ball = navigation.space_figure(wide, {}).axes[0]
    (left, low), (right, high) = ball.xy_dataLim.get_points()
    assert np.allclose([left, right, low, high], [-3, 11, -2, 12], atol=0.2)
    assert np.allclose(ball.zz_dataLim.get_points()[:, 0], [-1, 13], atol=0.2)
    assert np.allclose(perspective.get_zlim(), [0, 10])
    for ax, axes in zip(planes, [(0, 1), (0, 2), (1, 2)], strict=True):
        shown, goal = [c for c in ax.patches if isinstance(c, Circle)]
        assert np.allclose(shown.center, course(3).discs[0, list(axes)])
        assert (shown.radius, goal.radius) == (1.5, 0.5)
        assert drawn(ax, *route[:, axes].T)
        assert drawn(ax, *(route[:, axes] + 1).T)


def test_bounds_are_percents_over_trajectories():
    field = flat_map()
    shown = stand_in(ForceMaps, learned=field, truth=None, sd=np.full((5, 7, 2), 0.3))
    way = np.array([[0.0, 0.0], [1.0, 2.0]])
    result = stand_in(
        DesignResult,
        bounds={"informed": (np.array([0.5, 0.2]),)},
        accuracy=0.1,
        maps=shown,
        course=course(),
        thrust=9.0,
        decision=stand_in(Decision, way=way),
        paths={"informed": (way + 1,)},
    )
    (ax,) = navigation.bounds_figure(result).axes
    assert drawn(ax, [0, 1], [50, 20])
    assert drawn(ax, [0, 1], [10, 10])
    ax = navigation.recordings_figure(result, "informed").axes[0]
    assert drawn(ax, *way.T)
    assert drawn(ax, *(way + 1).T)
    assert navigation.greatest_force(shown) == 5.0
    assert ax.collections[0].get_clim() == (0.0, np.hypot(0.3, 0.3))
