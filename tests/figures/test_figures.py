import subprocess
import sys
from functools import partial

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from pinav import figures
from pinav.evaluation import Decomposition, FieldMap
from pinav.evaluation.scores import Whiteness
from pinav.figures.errors import residual_autocorrelation
from pinav.figures.maps import ERROR, FORCE
from pinav.figures.palette import BLACK, BLUE, VERMILLION
from pinav.figures.style import add_legend, pale

UNITS = {"x": "um", "y": "um", "t": "s", "vx": "um/s", "vy": "um/s"}
PHASES = (("Adam", 0), ("L-BFGS", 75))
TIMES = np.linspace(0.0, 5.0, 51)


@pytest.fixture(autouse=True)
def _untouched_settings():
    before = dict(matplotlib.rcParams)
    yield
    assert dict(matplotlib.rcParams) == before


def states(shift=0.0):
    x, y = TIMES + shift, np.sin(TIMES) + shift
    return np.stack([x, y, np.ones_like(TIMES), np.cos(TIMES) + shift], axis=1)


def losses(seeds=1):
    steps = np.arange(101.0)
    return np.stack([(s + 1) * np.exp(-steps / 10) for s in range(seeds)])


def field(strength=1.0, points=41):
    axis = np.linspace(-3.0, 3.0, points)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1)
    distance = np.hypot(grid[..., 1], np.maximum(np.abs(grid[..., 0]) - 1.0, 0.0))
    return FieldMap(axis, axis, strength * grid, distance)


def deviation():
    return 0.1 + 0.01 * np.abs(field().force)


def budget(strength=1.0):
    wave = np.stack([np.sin(TIMES), np.cos(TIMES)], axis=1)
    names = ("propulsion", "environment", "drag")
    terms = {name: strength * k * wave for k, name in enumerate(names, start=1)}
    return Decomposition(TIMES, terms)


def paper_figure(**options):
    parts = (TIMES, states(), states(0.5), states(0.01), losses(3), PHASES)
    return figures.figure1(*parts, barrier=([2.0, 0.0], 1.0), **options)


def force_map(shown, **options):
    return figures.map_panel(shown, shown.force, FORCE, **options)


def error_map(learned, **options):
    true = field()
    return figures.map_panel(true, learned.force - true.force, ERROR, **options)


def path_panel(ax=None):
    paths = {"ude": states(0.1)[:, :2]}
    return figures.trajectory(states()[:, :2], paths, units=UNITS, ax=ax)


def speed_panel(ax=None):
    speeds = {"ude": states(0.1)[:, 2:]}
    return figures.velocity(TIMES, states()[:, 2:], speeds, units=UNITS, ax=ax)


def loss_panel(ax=None):
    return figures.loss_curve(losses(), PHASES, ax=ax)


PANELS = {
    "trajectory": (path_panel, "$x$ [µm]", "$y$ [µm]"),
    "velocity": (speed_panel, "$t$ [s]", "velocity [µm/s]"),
    "loss_curve": (loss_panel, "step", "training loss"),
    "force_map": (partial(force_map, field(), units=UNITS), "$x$ [µm]", "$y$ [µm]"),
    "error_map": (partial(error_map, field(1.1), units=UNITS), "$x$ [µm]", "$y$ [µm]"),
    "decomposition": (
        partial(figures.decomposition, budget(), units=UNITS),
        *("$t$ [s]", "$a_x$ [µm s⁻²]"),
    ),
}
"""Panels, and the labels of their axes."""

FIGURES = {
    "figure1": paper_figure,
    "force_comparison": lambda: figures.force_comparison(field(1.1), true=field()),
    "force and deviation": lambda: figures.force_comparison(field(), sd=deviation()),
    "all of the force": lambda: figures.force_comparison(
        field(1.1), true=field(), sd=deviation()
    ),
    "acceleration": lambda: figures.acceleration_figure(budget(1.1), true=budget()),
}


def legend_texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def line_labelled(ax, label):
    (line,) = [line for line in ax.get_lines() if line.get_label() == label]
    return line


@pytest.mark.parametrize(("draw", "x", "y"), PANELS.values(), ids=PANELS)
def test_every_panel_draws_where_it_is_told_and_has_labels_with_units(draw, x, y):
    ax = Figure().add_subplot()
    assert draw(ax=ax) is ax
    assert (ax.get_xlabel(), ax.get_ylabel()) == (x, y)
    is_map = y == "$y$ [µm]"
    assert (ax.get_aspect() == 1.0) == is_map


def test_dimensionless_channels_print_no_bracket():
    path = states()[:, :2]
    units = {"x": "1", "y": "1"}
    ax = figures.trajectory(path, {}, units=units)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x$", "$y$")
    assert figures.decomposition(budget(), 1).get_ylabel() == "$a_y$"
    bare_length = {"x": "1", "t": "s"}
    assert figures.decomposition(budget(), units=bare_length).get_ylabel() == (
        "$a_x$ [s⁻²]"
    )


def test_models_have_one_look_everywhere():
    path = states()[:, :2]
    ax = figures.trajectory(path, {"ude": path, "ude-untrained": path, "mine": path})
    assert legend_texts(ax) == ["truth", "trained UDE", "untrained UDE", "mine"]
    assert line_labelled(ax, "truth").get_color() == BLACK
    assert line_labelled(ax, "trained UDE").get_color() == BLUE
    untrained = line_labelled(ax, "untrained UDE")
    assert (untrained.get_color(), untrained.get_linestyle()) == (VERMILLION, "--")
    ax = speed_panel()
    for model, color in (("truth", BLACK), ("trained UDE", BLUE)):
        assert line_labelled(ax, f"$v_x$ {model}").get_color() == color
        assert line_labelled(ax, f"$v_y$ {model}").get_color() == pale(color)
    assert_allclose(line_labelled(ax, "$v_y$ truth").get_ydata(), states()[:, 3])
    assert sum(pale(BLUE)) > sum(to_rgb(BLUE))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_diverged_model_is_said_and_cut(bad):
    model = states()
    model[20:] = bad
    ax = figures.trajectory(states()[:, :2], {"ude": model[:, :2]})
    assert "trained UDE\n(diverged)" in legend_texts(ax)
    ax = figures.velocity(TIMES, states()[:, 2:], {"ude": model[:, 2:]})
    assert "$v_x$ trained UDE (diverged)" in legend_texts(ax)
    ax.figure.draw_without_rendering()


@pytest.mark.parametrize("far", [1e2, 1e30, 1e300])
def test_far_model_does_not_shrink_the_truth(far):
    path = states()[:, :2]
    ax = figures.trajectory(path, {"ude": path * far})
    ax.figure.draw_without_rendering()
    assert np.ptp(ax.get_xlim()) < 5.0 * np.ptp(path[:, 0])
    assert any("ends at" in text for text in legend_texts(ax))
    ax = figures.velocity(TIMES, states()[:, 2:], {"ude": far * states()[:, 2:]})
    assert np.ptp(ax.get_ylim()) < 5.0 * np.ptp(states()[:, 2:])


def test_model_that_never_was_finite_leaves_the_truth():
    path = states()[:, :2]
    ax = figures.trajectory(path, {"ude": np.full_like(path, np.nan)})
    ax.figure.draw_without_rendering()
    assert np.isfinite(ax.get_xlim()).all()


@pytest.mark.parametrize("gap", [range(3, 6), range(101)])
def test_loss_leaves_a_gap_where_it_is_no_positive_number(gap):
    values = losses()[0]
    values[gap] = np.resize([np.nan, np.inf, 0.0], len(gap))
    ax = figures.loss_curve(values, PHASES)
    drawn = ax.get_lines()[0].get_ydata()
    assert np.flatnonzero(np.isnan(drawn)).tolist() == [*gap]
    ax.figure.draw_without_rendering()


@pytest.mark.parametrize("limit", [0.0143, 0.143, 1.43, 14.3, 143.0])
def test_a_colour_bar_has_few_labels(limit):
    figure = force_map(field(), limits=(0.0, limit)).figure
    figure.set_size_inches(3.0, 3.6)
    FigureCanvasAgg(figure).draw()
    (bar,) = figure.axes[1:]
    shown = [t for t in bar.get_xticklabels() if 0 <= t.get_position()[0] <= limit]
    assert 2 <= len([label for label in shown if label.get_text()]) <= 6


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_force_map_without_a_finite_force_still_draws(value):
    flat = FieldMap(
        field().x, field().y, np.full_like(field().force, value), field().distance
    )
    force_map(flat).figure.draw_without_rendering()


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_saved_figures_are_whole_and_the_same_every_time(tmp_path, name):
    first = figures.save_figure(FIGURES[name](), tmp_path / "new" / "one", name)
    second = figures.save_figure(FIGURES[name](), tmp_path / "two", name)
    assert first.svg.read_bytes() == second.svg.read_bytes()
    assert first.png.read_bytes() == second.png.read_bytes()
    assert first.png.read_bytes().startswith(b"\x89PNG")
    text = first.svg.read_text(encoding="utf-8")
    assert "</text>" in text
    assert "<dc:date>" not in text
    assert sorted(p.name for p in first.png.parent.iterdir()) == [
        f"{name}.png",
        f"{name}.svg",
    ]


def test_residuals_of_many_channels_are_all_drawn():
    names = tuple(f"channel {i}" for i in range(9))
    none = np.zeros(9)
    test = Whiteness(names, np.full((9, 4), 0.1), none, none, (50,) * 9)
    _, labels = residual_autocorrelation(test).get_legend_handles_labels()
    assert set(names) <= set(labels)


def test_import_leaves_pyplot_alone():
    code = "import sys, pinav.report; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_nothing_drawn_has_no_legend():
    ax = Figure().add_subplot()
    add_legend(ax)
    assert ax.get_legend() is None
    ax.plot([0, 1], label="a line")
    add_legend(ax)
    assert ax.get_legend() is not None
