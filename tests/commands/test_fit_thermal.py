"""`pinav fit --recipe langevin --observation learn` from the command line."""

import numpy as np

from pinav.commands.fit.job import thermal_sentences
from pinav.fitting import Estimate, LangevinChecks, ReferencePath
from pinav.fitting.langevin.checks import ThinnedDiffusion
from pinav.learning.thermal import ObservedDiffusion, ThermalFindings


def test_fields_and_a_reference_have_sentences_of_their_own():
    above = ObservedDiffusion(("z",), Estimate(0.03, 0.001), 0.01, 0.06)
    exact = ObservedDiffusion(("x", "y"), Estimate(0.1, 0.001), 0.1, 0.1)
    checks = LangevinChecks(
        np.zeros((5, 3)), 400, (ThinnedDiffusion(2, (2,), Estimate(0.99, 0.02)),), ()
    )
    path = ReferencePath(2, np.arange(46.0), np.tile([-1.0, 1.0], 23), np.eye(46))
    findings = ThermalFindings(("x", "y", "z"), checks, (exact, above), {}, path)
    statement, diffusion, reference = thermal_sentences(findings)
    assert statement.startswith("The fit explains the increments")
    assert diffusion == (
        "diffusion along z: 0.0100 to 0.0600 for nine tenths of the data, mean 0.0300 "
        "± 0.0010 (sd)"
    )
    assert reference == (
        "the zero of z drifts by 1.00 (sd over 46 knots, each known to 1.0)"
    )
