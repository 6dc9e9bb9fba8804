import numpy as np
import pytest

from pinav import figures
from pinav.analysis import LyapunovMap, helmholtz_split
from pinav.evaluation import FieldMap
from pinav.figures.maps import POTENTIAL, above_least, map_panel, trust_map
from pinav.figures.style import with_unit
from pinav.units import force_unit, with_order

UNITS = {"x": "um", "y": "um", "t": "s", "vx": "um/s", "vy": "um/s"}
AXIS = np.linspace(-3.0, 3.0, 21)
GRID = np.stack(np.meshgrid(AXIS, AXIS), axis=-1)
PATH = np.stack([np.linspace(-2.0, 2.0, 9), np.zeros(9)], axis=1)


def field():
    bump = np.exp(-0.5 * (GRID**2).sum(axis=-1))[..., None]
    return FieldMap(AXIS, AXIS, bump * GRID, np.abs(GRID[..., 1]))


def maps(figure):
    """Axes that show a plane: neither colour bars nor hidden ones."""
    return [ax for ax in figure.axes if ax.get_xlabel() == "$x$ [µm]"]


def bars(figure):
    labels = [ax.get_xlabel() for ax in figure.axes]
    return [label for label in labels if label and label != "$x$ [µm]"]


def potential():
    lifted = above_least(GRID[..., 0], field())
    return map_panel(field(), lifted, POTENTIAL, path=PATH, units=UNITS).figure


def trust():
    sd = np.full((*GRID.shape[:2], 2), 0.1)
    return trust_map(field(), sd, path=PATH, units=UNITS).figure


def parts():
    own = field()
    split = helmholtz_split(own)
    shown = figures.helmholtz_figure(split, own, spread=0.01, path=PATH, units=UNITS)
    return shown.draw()


def influence():
    changes = np.stack([k * field().force for k in (0.1, 0.3, 0.2)])
    paths = [PATH] * 3
    return figures.influence_figure(changes, field(), paths, most=2, units=UNITS).draw()


def constants():
    slopes = {"damping": field().force, "gain": -field().force}
    return figures.constants_figure(slopes, field(), path=PATH, units=UNITS).draw()


def exponents():
    values = np.geomspace(0.5, 40.0, AXIS.size**2).reshape(AXIS.size, AXIS.size)
    growth = LyapunovMap(AXIS, AXIS, values, GRID, 20.0)
    return figures.lyapunov_figure(growth, path=PATH, units=UNITS).draw()


FIGURES = {
    "potential": (potential, 1, "$U$ above its least value [µm² s⁻²]"),
    "trust": (trust, 1, r"$|F| / \mathrm{sd}(F)$"),
    "parts": (parts, 3, "$|F|$ [µm s⁻²]"),
    "influence": (influence, 2, r"$|\Delta F|$ [µm s⁻²]"),
    "constants": (constants, 2, r"$|\Delta F|$ per percent [µm s⁻²]"),
    "exponents": (exponents, 1, r"growth of separations, $e^{\lambda T}$"),
}


@pytest.mark.parametrize(("draw", "count", "label"), FIGURES.values(), ids=FIGURES)
def test_maps_have_equal_axes_and_units(draw, count, label):
    figure = draw()
    figure.canvas.draw()
    drawn = maps(figure)
    assert len(drawn) == count
    assert all(ax.get_aspect() == 1.0 for ax in drawn)
    assert drawn[0].get_ylabel() == "$y$ [µm]"
    assert bars(figure)[0] == label


def test_the_unit_of_a_force_is_that_of_the_dynamics():
    assert force_unit(UNITS, lengths=2) == "um² s⁻²"
    assert force_unit({}, lengths=2) == "1"
    assert force_unit(with_order(UNITS, 1)) == "um s⁻¹"
    assert force_unit(with_order(UNITS, 2)) == "um s⁻²"
    assert force_unit({"x": "?", "t": "?"}) == "?"
    assert with_unit("$|F|$", "?") == "$|F|$"
    units = {"x": "um", "t": "s"}
    assert force_unit(with_order(units, 1, "pN")) == "pN"
    assert force_unit(with_order(units, 1, "pN"), lengths=2) == "pN um"
    assert force_unit(with_order(units, 1)) == "um s⁻¹"
    assert force_unit(with_order(units, 2, "pN")) == "um s⁻²"
