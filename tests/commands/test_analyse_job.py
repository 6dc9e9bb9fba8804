import csv
import json
import shutil

import equinox as eqx
import jax
import numpy as np
import pytest

from pinav import cli
from pinav.analysis import Analysis, LyapunovMap, effects, helmholtz_split
from pinav.commands.analyse import AnalyseSettings
from pinav.commands.analyse.job import growth_sentence, rotation_sentence
from pinav.errors import InputError
from pinav.evaluation import FieldMap, Regions
from pinav.runs import RunFolder
from pinav.scenarios import barrier_crossings
from pinav.trajectories import save, simulate

SMALL = ["--points", "21", "--draws", "4", "--samples", "8"]


@pytest.fixture(autouse=True, scope="module")
def few_starts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "LYAPUNOV_POINTS", 5)
        yield


@pytest.fixture(scope="module")
def inferred(tmp_path_factory):
    """A run with a posterior, damping learned with the force."""
    folder = tmp_path_factory.mktemp("analyse")
    short = eqx.tree_at(
        lambda s: (s.starts, s.times),
        barrier_crossings(),
        replace_fn=lambda a: a[:3] if a.ndim == 2 else a[:31],
    )
    save(simulate(short, key=jax.random.key(3)), folder / "data.npz")
    argv = ["fit", str(folder / "data.npz"), "--out", str(folder / "run")]
    argv += ["--model", "kernel-potential", "--train", "damping", "--noise", "0.02"]
    assert cli.run(argv) == 0
    assert cli.run(["analyse", str(folder / "run"), *SMALL]) == 0
    return folder / "run"


@pytest.mark.slow
def test_the_analysis_of_a_posterior_is_whole(inferred):
    found = RunFolder.open(inferred).load("analysis", Analysis)
    assert not found.left_out
    split = found.split
    fractions = split.least_fraction, split.rotational_fraction, split.greatest_fraction
    assert list(fractions) == sorted(fractions)
    assert split.least_fraction < 0.01  # a potential was learned
    assert found.is_potential_learned
    assert [row.trajectory for row in found.influence] == [0, 1, 2]
    assert all(row.leverage > 0 for row in found.influence)
    learned = {row.constant: row.learned for row in found.constants}
    assert learned == {"damping": True, "gain": False}
    assert {"final x", "final y", "least distance"} <= set(found.sobol.outcomes)
    assert found.lyapunov.horizon == pytest.approx(3.0)


@pytest.mark.slow
def test_tables_say_what_the_result_says(inferred):
    found = RunFolder.open(inferred).load("analysis", Analysis)
    counts = {"influence": 3, "constants": 2, "sobol": found.sobol.total.size}
    for name, count in counts.items():
        with open(inferred / f"analysis-{name}.csv", newline="") as file:
            rows = list(csv.reader(file))
        assert len(rows) == 1 + count
    with open(inferred / "analysis-influence.csv", newline="") as file:
        cells = [float(row["Cook's distance"]) for row in csv.DictReader(file)]
    assert cells == [row.cook for row in found.influence]


@pytest.mark.slow
def test_the_report_has_the_figures(inferred):
    page = (inferred / "report.html").read_text(encoding="utf-8")
    for title in (
        "What was learned",
        "What the field depends on",
        "What a rollout depends on",
    ):
        assert title in page
    names = ("helmholtz", "potential", "influence", "constants", "lyapunov", "sobol")
    for name in names:
        assert (inferred / "figures" / f"analysis-{name}.png").stat().st_size > 0


@pytest.mark.slow
def test_without_a_posterior_the_rest_is_done_and_said(tiny_fit, tmp_path, capsys):
    copy = tmp_path / "run"
    shutil.copytree(tiny_fit[0], copy)
    assert cli.run(["analyse", str(copy), *SMALL, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
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
    assert words in rotation_sentence(found)
    assert "within 31.2 of the data." in rotation_sentence(analysis({}))
    assert "over 10.2 s; median" in growth_sentence(found.lyapunov, "s")
    missing = analysis({}, separation=np.nan)
    assert "no finite growth" in growth_sentence(missing.lyapunov, "s")


def test_what_cannot_be_analysed_is_refused(tiny_fit, tmp_path, refused):
    run = str(tiny_fit[0])
    refused(["analyse", run, "--reference", "1"], "--reference: expected 0 to 0")
    other = tmp_path / "other"
    RunFolder.create(other, {"run": {"command": "reproduce"}}, overwrite=False)
    refused(["analyse", str(other)], "holds no fitted")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": 4}, "--points: expected 5 or more"),
        ({"draws": 1}, "--draws: expected 2 or more"),
        ({"reference": -1}, "--reference: expected 0 or more"),
        ({"samples": 100}, "--samples: expected a power of two"),
        ({"relative": 1.5}, "--relative: expected between 0 and 1"),
        ({"shift": 0.0}, "--shift: expected > 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        AnalyseSettings(**change).check()


@pytest.mark.slow
def test_a_model_without_a_learned_force_is_refused(tmp_path, refused):
    data, run = tmp_path / "data.npz", tmp_path / "run"
    short = eqx.tree_at(
        lambda s: (s.starts, s.times),
        barrier_crossings(),
        replace_fn=lambda a: a[:2] if a.ndim == 2 else a[:11],
    )
    save(simulate(short, key=jax.random.key(3)), data)
    argv = ["fit", str(data), "--out", str(run), "--model", "physics-only"]
    assert cli.run([*argv, "--train", "damping"]) == 0
    refused(["analyse", str(run)], "has no learned force of the environment")
