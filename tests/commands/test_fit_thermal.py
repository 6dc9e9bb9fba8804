"""`pinav fit --recipe langevin --observation learn` from the command line."""

import numpy as np
import pytest
from tests.fitted_runs import DATA, simulate

from pinav import cli
from pinav.commands.fit.job import thermal_sentences
from pinav.fitting import Estimate, LangevinChecks, ReferencePath
from pinav.fitting.langevin.checks import ThinnedDiffusion
from pinav.learning.learned import Learned
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


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Twenty paths of a bead with an error of a seventh of a step."""
    path = tmp_path_factory.mktemp("thermal")
    simulate("brownian", path, "--count", "20", "--noise", "0.02", "--seed", "0")
    learn = ["--recipe", "langevin", "--observation", "learn"]
    run = path / "run"
    assert cli.run(["fit", str(path / DATA), "--out", str(run), *learn]) == 0
    return Learned.open(run)


@pytest.mark.slow
def test_a_run_keeps_and_shows_diffusion_blur_error_and_checks(run):
    found = run.findings
    diffusion = found.constants["diffusion"]
    assert abs(diffusion.value - 0.245) < 3 * diffusion.sd < 0.03
    units = {name: one.unit for name, one in found.constants.items()}
    assert units == {"diffusion": "um² s⁻¹", "exposure": "s", "error": "um"}
    assert found.noise == pytest.approx(np.sqrt(2 * diffusion.value))
    checks = found.thermal.checks
    assert found.thermal.channels == ("x", "y")
    assert np.abs(checks.correlations).max() < 4 * checks.band / 2
    assert [one.every for one in checks.thinned] == [2, 3]
    for one in checks.thinned:
        assert abs(one.ratio.value - 1) < 4 * one.ratio.sd
    page = (run.folder.path / "report.html").read_text()
    assert "The thermal motion" in page
    assert "um of an observed position of the training data" in page
    assert checks.statement in page
    assert "diffusion of every 2 samples over that of all, along x, y" in page
