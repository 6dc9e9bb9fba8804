import json

import numpy as np
import pytest
from tests.fitted_runs import trap_system

from pinav.analysis import (
    Analysis,
    EntropyProduction,
    LyapunovMap,
    effects,
    helmholtz_split,
)
from pinav.analysis.effects import produce_entropy
from pinav.commands.analyse import job
from pinav.errors import InputError
from pinav.evaluation import FieldMap, Regions
from pinav.fitting import Estimate
from pinav.learning.learned import Learned
from pinav.systems import write_system

SMALL = ["--points", "21", "--draws", "4", "--samples", "8"]


@pytest.fixture(autouse=True, scope="module")
def few_starts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "LYAPUNOV_POINTS", 5)
        yield


@pytest.mark.slow
def test_without_a_posterior_the_rest_is_done_and_said(fitted_run, printed):
    copy, _ = fitted_run("network")
    found = json.loads(printed("analyse", copy, *SMALL, "--json"))
    assert "doubt" not in found
    assert len(found["left_out"]) == 2
    assert "the run has no posterior; fit with --recipe bayes" in found["left_out"][0]
    assert "influence" not in found
    assert np.isfinite(found["split"]["rotational_fraction"])
    page = (copy / "report.html").read_text(encoding="utf-8")
    assert "Left out of the analysis" in page
    assert "standard deviations: the run has no posterior" in page


def analysis(units, separation=2.0):
    axis = np.linspace(-60.0, 60.0, 9)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1)
    field = FieldMap(axis, axis, grid, 0.0 * grid[..., 0], Regions(10.0, 31.2213))
    split = helmholtz_split(field)
    growth = LyapunovMap(axis, axis, np.full((9, 9), separation), grid, 10.23)
    return Analysis(
        model="kernel-force",
        reference=0,
        relative=0.1,
        shift=0.1,
        units=units,
        paths=(grid[0],),
        field=field,
        split=split,
        potential=split.potential,
        is_potential_learned=False,
        lyapunov=growth,
    )


def test_the_findings_are_stated_in_the_units_of_the_data():
    found = analysis({"x": "um", "t": "s"})
    words = "of the learned field within 31.2 um of the data."
    assert words in job.rotation_sentence(found)
    assert "within 31.2 of the data." in job.rotation_sentence(analysis({}))
    assert "over 10.2 s; median" in job.growth_sentence(found.lyapunov, "s")
    missing = analysis({}, separation=np.nan)
    assert "no finite growth" in job.growth_sentence(missing.lyapunov, "s")
    assert job.entropy_sentence(production(2.0)) == (
        "Entropy production of a steady state: 2 ± 0.3 (sd) k_B per unit of time: out "
        "of equilibrium; current velocity 1.4 (rms)."
    )
    assert "equilibrium is not excluded" in job.entropy_sentence(production(0.5))


@pytest.mark.slow
def test_what_cannot_be_analysed_is_refused(tiny_fit, fitted_run, refused):
    refused(
        ["analyse", tiny_fit[0], "--reference", "1"], "--reference: expected 0 to 0"
    )
    run, _ = fitted_run("identified")
    refused(["analyse", run], "has no learned force of the environment")


def production(rate):
    current = np.array([[1.4, 0.0], [0.0, -1.4]])
    return EntropyProduction(Estimate(rate, 0.3), 0.1, 0.0 * current, current)


@pytest.mark.slow
def test_a_trap_is_not_out_of_equilibrium_and_a_potential_is_left_out(
    tmp_path, printed
):
    trap = trap_system(
        stiffness=2.0,
        thermal_energy=2.0,
        model="kernel-force",
        starts=np.zeros((1, 2)),
        times=np.linspace(0.0, 40.0, 2001),
    )
    write_system(trap, tmp_path / "trap.toml")
    data, run = tmp_path / "data.npz", tmp_path / "run"
    printed("simulate", tmp_path / "trap.toml", "--out", data)
    printed("fit", data, "--out", run)
    fitted = Learned.open(run)
    entropy = produce_entropy(fitted)
    assert abs(entropy.rate.value) < 3 * entropy.rate.sd
    assert entropy.current.shape == entropy.positions.shape
    printed("fit", data, "--out", run, "--model", "kernel-potential", "--overwrite")
    with pytest.raises(InputError, match="the model is a potential"):
        produce_entropy(Learned.open(run))
