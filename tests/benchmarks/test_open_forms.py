import sys

import numpy as np
import pytest
import sympy
from benchmarks.open_forms import search_radial_law

from pinav.analysis.discovery.force_sample import ForceSample
from pinav.analysis.discovery.law_regression import law_force
from pinav.errors import InputError
from pinav.forces.law_library import GAUSSIAN, GAUSSIAN_SWIRL

POSITIONS = np.random.default_rng(0).uniform(0.0, 8.0, (60, 2))
BARRIER = np.array([5.25, 5.0, 4.0, 2.9])


def barrier_sample():
    force = law_force(GAUSSIAN, BARRIER, POSITIONS)
    return ForceSample(POSITIONS, force, 1e-6 * np.eye(120), 40.0)


@pytest.mark.extras("pyoperon")
@pytest.mark.filterwarnings("default")
def test_the_radial_law_of_a_barrier_is_found():
    central, forms = search_radial_law(barrier_sample(), seconds=4)
    np.testing.assert_allclose(central.center, (5.0, 4.0), atol=1e-3)
    assert [f.bic for f in forms] == sorted(f.bic for f in forms)
    formula = sympy.sympify(forms[0].formula.replace("^", "**"))
    for r in (0.5, 2.0, 4.0):
        true = 5.25 * r / 2.9**2 * np.exp(-(r**2) / (2 * 2.9**2))
        assert float(formula.subs("r", r)) == pytest.approx(true, abs=0.02)


def test_messages(monkeypatch):
    with pytest.raises(InputError, match="one or more seconds and symbols"):
        search_radial_law(barrier_sample(), seconds=0)
    swirl = law_force(GAUSSIAN_SWIRL, np.array([0.5, 5.0, 4.0, 2.0]), POSITIONS)
    turned = ForceSample(POSITIONS, swirl, 1e-6 * np.eye(120), 40.0)
    with pytest.raises(InputError, match="only a central force has a radial law"):
        search_radial_law(turned)
    monkeypatch.setitem(sys.modules, "pyoperon", None)
    monkeypatch.setitem(sys.modules, "pyoperon.sklearn", None)
    with pytest.raises(InputError, match=r"install pinav\[symbolic\]"):
        search_radial_law(barrier_sample())
