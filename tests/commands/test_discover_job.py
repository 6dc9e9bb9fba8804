import dataclasses
import re

import equinox as eqx
import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser
from tests.fitted_runs import trap_system
from tests.samples import sample

from pinav import analysis
from pinav.analysis.discovery.candidates import POTENTIALS
from pinav.commands import DISCOVER
from pinav.commands.discover.job import central_sentence, sections, sentences
from pinav.fitting import Outcome
from pinav.forces.geometries import Center
from pinav.forces.law_library import GAUSSIAN, GAUSSIAN_SWIRL, SADDLE
from pinav.forces.laws import ProfileLaw, latex
from pinav.forces.profiles import Yukawa
from pinav.report import sections_text
from pinav.runs import RunFolder
from pinav.systems import Observation, UniformStarts, Units, write_system


def constant(name, value, sd=np.inf):
    return sample(
        analysis.EstimatedConstant,
        name=name,
        unit="1",
        value=value,
        sd=sd,
        low=value - 1.96 * sd,
        high=value + 1.96 * sd,
        identifiable=bool(np.isfinite(sd)),
    )


def law(law, delta, *constants):
    fits = bool(np.isfinite(delta))
    return sample(
        analysis.Candidate,
        name=law.name,
        law=law,
        constants=constants,
        delta_bic=delta,
        outcome=Outcome.CONVERGED if fits else Outcome.DIVERGED,
        fits=fits,
        latex="U = U_0",
    )


FORCE = np.linspace(-1.0, 1.0, 20).reshape(10, 2)
FOUND = analysis.Discovery(
    candidates=(
        law(GAUSSIAN, 0.0, constant("height", 5.25, 0.01)),
        law(ProfileLaw(Yukawa(), Center()), 3.0, constant("core", 7.0)),
        law(GAUSSIAN + SADDLE, 800.0, constant("edge", 1.0, 0.1)),
        law(GAUSSIAN_SWIRL, np.inf, constant("height", 1.0, 0.1)),
    ),
    screened=(("Gaussian", 1.5),),
    verdict=analysis.Verdict.IDENTIFIED,
    central=analysis.CentralTest((5.0, 5.0), (0.1, 0.1), 0.01, 0.02, 0.7, 8.0),
    learned_noise=0.02,
    num_effective=9.0,
    sample=analysis.ForceSample(FORCE, FORCE, 0.01 * np.eye(20), 9.0),
    best_force=1.1 * FORCE,
)


def text(found):
    return sections_text(sections(found))


def test_text_lists_the_close_laws_with_their_intervals():
    printed = text(FOUND)
    assert re.search(r"height +1 +5\.25000 .* 5\.23040 +5\.26960 +yes", printed)
    assert re.search(r"core .* not identifiable", printed)
    assert "edge" not in printed
    assert "p = 0.7" in printed
    best, second, *others = FOUND.candidates
    laws = (best, dataclasses.replace(second, extends_best=True), *others)
    found = dataclasses.replace(FOUND, candidates=laws)
    assert [law.name for law in found.close] == ["Gaussian"]
    assert "core" not in text(found)
    assert "has no structure" in text(FOUND)
    structured = dataclasses.replace(FOUND, structure=("wall", "central"))
    assert "the structure of the fit (wall + central)" in text(structured)


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (analysis.Verdict.IDENTIFIED, "Law: Gaussian, Yukawa"),
        (
            analysis.Verdict.NOT_IDENTIFIABLE,
            "identifiable from these data (Gaussian, Yukawa)",
        ),
        (analysis.Verdict.NO_LAW_FITS, "no candidate explains the data"),
    ],
)
def test_every_verdict_is_a_sentence(verdict, words):
    assert words in sentences(dataclasses.replace(FOUND, verdict=verdict))[0]


def test_a_force_that_is_not_central_has_no_centre():
    assert "centre (5 ± 0.1, 5 ± 0.1)" in central_sentence(FOUND.central)
    off = dataclasses.replace(FOUND.central, p_value=0.001)
    assert "centre" not in central_sentence(off)
    unknown = dataclasses.replace(FOUND.central, center_sd=(9.0, 0.1))
    assert "do not determine a centre" in central_sentence(unknown)


@pytest.fixture
def folder(tmp_path):
    run = {"run": {"command": "fit"}}
    return RunFolder.create(tmp_path / "run", run, overwrite=False)


def test_a_discovery_comes_back_as_it_was(folder):
    folder.store(DISCOVER.file, FOUND)
    found = folder.load(DISCOVER.file, analysis.Discovery)
    assert eqx.tree_equal(found, FOUND)
    assert [one.law for one in found.candidates] == [c.law for c in FOUND.candidates]
    assert text(found) == text(FOUND)


@pytest.mark.parametrize(
    "law",
    [*POTENTIALS, GAUSSIAN + GAUSSIAN],
    ids=lambda law: law.name,
)
def test_every_formula_can_be_drawn(law):
    parsed = MathTextParser("path").parse(f"${latex(law)}$")
    assert parsed.width > 10


@pytest.mark.slow
def test_the_law_of_a_swimmer_without_inertia_is_a_force(tmp_path, printed):
    trap = trap_system(
        stiffness=2.0,
        center=[1.0, -0.5],
        observation=Observation(noise=0.01),
        rule=UniformStarts((-2.0, -2.0), (3.0, 3.0), count=6),
        times=np.linspace(0.0, 3.0, 61),
        base_units=Units("um", "s", "pN"),
    )
    write_system(trap, tmp_path / "trap.toml")
    data, run = tmp_path / "trap.npz", tmp_path / "run"
    printed("simulate", tmp_path / "trap.toml", "--out", data)
    printed("fit", data, "--out", run)
    printed("discover", run, "--refits", "2")
    best = RunFolder.open(tmp_path / "run").load("laws", analysis.Discovery).best
    assert best.name == "harmonic"
    stiffness = best.constants[0]
    assert stiffness.low < 2.0 < stiffness.high
    assert stiffness.unit == "pN um⁻¹"


@pytest.mark.slow
def test_a_law_of_stochastic_paths_is_refused(fitted_run, refused):
    run, _ = fitted_run("langevin")
    refused(["discover", str(run)], "expected a swimmer without thermal noise")
