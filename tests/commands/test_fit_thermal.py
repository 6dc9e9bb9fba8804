"""`pinav fit --recipe langevin --observation learn` from the command line."""

import numpy as np
import pytest
from pinav.commands.fit.metrics import FitMetrics
from pinav.commands.fit.thermal import (
    CHECKS_FILE,
    ObservedRow,
    ReferenceRow,
    ThermalRow,
    ThinnedRow,
    read_checks,
)

from pinav import cli
from pinav.commands.cells import EstimateRow
from pinav.errors import InputError
from pinav.fitting import Estimate
from pinav.runs import RunFolder

ROW = ThermalRow(
    correlations={"x": (0.01, -0.02), "y": (0.004, 0.0)},
    limit=0.015,
    thinned=(ThinnedRow(2, ("x", "y"), EstimateRow(0.99, 0.02)),),
    observed=(
        ObservedRow(
            ("x", "y"),
            EstimateRow(0.25, 0.006),
            (0.25, 0.25),
            EstimateRow(0.4, 0.1),
            EstimateRow(0.2, 0.05),
        ),
    ),
    statement="The fit explains the increments.",
)


def test_the_terminal_shows_the_checks_of_thermal_motion():
    learned = {"diffusion": EstimateRow.of(Estimate(0.25, 0.006))}
    metrics = FitMetrics(
        "kernel-potential",
        "langevin",
        "converged",
        {"total": 1.0},
        learned,
        thermal=ROW,
    )
    lines = metrics.text().splitlines()
    assert "diffusion: 0.2500 ± 0.0060 (sd)" in lines
    assert (
        "exposure: 0.400 ± 0.10 (sd) of the interval; error: 0.200 ± 0.050 (sd) of a "
        "step"
    ) in lines
    assert (
        "innovations 1 to 2 samples apart correlate by x +0.010 -0.020; y +0.004 "
        "+0.000 (independent ones within 0.015)"
    ) in lines
    assert "diffusion of every 2 samples: 0.990 ± 0.020 (sd) of that of all" in lines
    assert ROW.statement in lines


def test_fields_and_a_reference_have_sentences_of_their_own():
    above = ObservedRow(
        ("z",), EstimateRow(0.03, 0.001), (0.01, 0.06), EstimateRow(0.3, 0.1), None
    )
    exact = ObservedRow(("x", "y"), EstimateRow(0.1, 0.001), (0.1, 0.1), None, None)
    row = ThermalRow(
        ROW.correlations,
        0.015,
        (ThinnedRow(2, ("z",), EstimateRow(0.99, 0.02)),),
        (exact, above),
        "The fit explains the increments.",
        ReferenceRow("z", 46, 0.033, 0.008),
    )
    lines = row.text().splitlines()
    assert lines[:2] == [
        "diffusion along z: 0.0100 to 0.0600 for nine tenths of the data, mean 0.0300 "
        "± 0.0010 (sd)",
        "the zero of z drifts by 0.0330 (sd over 46 knots, each known to 0.0080)",
    ]
    assert (
        "diffusion along z of every 2 samples: 0.990 ± 0.020 (sd) of that of all"
        in lines
    )


def test_the_checks_of_a_run_are_kept_and_a_damaged_file_is_named(tmp_path):
    folder = RunFolder.create(tmp_path / "run", {}, overwrite=False)
    assert read_checks(folder) is None
    folder.write_metrics(CHECKS_FILE, ROW)
    assert read_checks(folder) == ROW
    folder.write_json(CHECKS_FILE, {"limit": "wide"})
    with pytest.raises(InputError, match=r"checks\.json is damaged"):
        read_checks(folder)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Twenty paths of a bead with an error of a seventh of a step."""
    path = tmp_path_factory.mktemp("thermal")
    data, run = str(path / "data.npz"), path / "run"
    drawn = ["--count", "20", "--noise", "0.02", "--seed", "0"]
    assert cli.run(["simulate", "brownian", "--out", data, *drawn]) == 0
    learn = ["--recipe", "langevin", "--observation", "learn"]
    assert cli.run(["fit", data, "--out", str(run), *learn]) == 0
    return RunFolder.open(run)


@pytest.mark.slow
def test_a_run_keeps_and_shows_diffusion_blur_error_and_checks(run):
    metrics = run.read_metrics("metrics.json", FitMetrics)
    diffusion = metrics.learned["diffusion"]
    assert abs(diffusion.value - 0.245) < 3 * diffusion.sd < 0.03
    assert metrics.learned.keys() == {"diffusion", "exposure", "error"}
    assert metrics.noise == pytest.approx(np.sqrt(2 * diffusion.value))
    checks = read_checks(run)
    assert checks is not None
    assert metrics.thermal == checks
    assert checks.correlations.keys() == {"x", "y"}
    assert np.abs(list(checks.correlations.values())).max() < 4 * checks.limit / 2
    assert [one.every for one in checks.thinned] == [2, 3]
    for one in checks.thinned:
        ratio, sd = one.ratio.value, one.ratio.sd
        assert ratio is not None
        assert sd is not None
        assert abs(ratio - 1) < 4 * sd
    page = (run.path / "report.html").read_text()
    assert "The thermal motion" in page
    assert "um of an observed position of the training data" in page
    assert checks.statement in page
    assert "diffusion of every 2 samples over that of all, along x, y" in page


@pytest.mark.slow
def test_bands_hold_the_force_in_spite_of_localisation_error(run):
    """Far from the barrier there is no force, and no band to speak of."""
    arrays = run.read_arrays("results.npz")
    near = arrays["field/distance"] < 0.35
    truth, sd = arrays["field/true"][near], arrays["field/sd"][near]
    miss = np.abs(arrays["field/learned"][near] - truth)
    size = np.sqrt(np.mean(truth**2))
    acts = np.linalg.norm(truth, axis=1) > 0.1 * size
    assert np.mean(miss[acts] < 1.96 * sd[acts]) > 0.8
    assert np.median(sd[acts]) > 0.02 * size
