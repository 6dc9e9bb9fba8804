import msgspec
import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser

from pinav import cli
from pinav.analysis.discovery.laws import latex
from pinav.analysis.discovery.potentials import GAUSSIAN, POTENTIALS
from pinav.commands.discover.job import LAWS_FILE, SAMPLE_FILE, text
from pinav.commands.discover.metrics import DiscoveryMetrics
from pinav.commands.discover.report import law_sections
from pinav.commands.system_choice import write_system_of
from pinav.runs import RunFolder
from pinav.scenarios import paper
from pinav.trajectories import save, simulate


def constant(name, value, sd):
    return {
        "name": name,
        "symbol": name[0],
        "unit": "1",
        "value": value,
        "sd": sd,
        "low": None if sd is None else value - 1.96 * sd,
        "high": None if sd is None else value + 1.96 * sd,
        "identifiable": sd is not None,
    }


def law(name, delta, constants):
    return {
        "name": name,
        "num_constants": len(constants),
        "bic": None if delta is None else delta - 100.0,
        "delta_bic": delta,
        "noise": 0.02,
        "outcome": "diverged" if delta is None else "converged",
        "fits": delta is not None,
        "latex": "U = U_0",
        "sympy": "(0, 0)",
        "constants": constants,
    }


METRICS = msgspec.convert(
    {
        "verdict": "identified",
        "laws": [
            law("Gaussian", 0.0, [constant("height", 5.25, 0.01)]),
            law("Yukawa", 3.0, [constant("core", 7.0, None)]),
            law("soft disc", 800.0, [constant("edge", 1.0, 0.1)]),
            law("double well", None, [constant("height", 1.0, 0.1)]),
        ],
        "screened": [],
        "central": {
            "verdict": "central",
            "center": [5.0, 5.0],
            "center_sd": [0.1, 0.1],
            "ratio": 0.01,
            "noise_ratio": 0.02,
            "p_value": 0.7,
        },
        "noise": 0.02,
        "num_effective": 9.0,
    },
    DiscoveryMetrics,
)


def test_text_lists_the_close_laws_with_their_intervals():
    printed = text(METRICS)
    assert "height = 5.25, 95 % from 5.2304 to 5.2696" in printed
    assert "core = 7: not identifiable" in printed
    assert "edge" not in printed
    assert "p = 0.7" in printed


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("identified", "law: Gaussian, Yukawa"),
        ("not identifiable", "not identifiable from these data (Gaussian, Yukawa)"),
        ("no law fits", "no candidate explains the data"),
    ],
)
def test_every_verdict_is_a_sentence(verdict, words):
    assert words in msgspec.structs.replace(METRICS, verdict=verdict).sentences()[0]


def test_a_law_that_extends_the_best_one_is_no_rival():
    extension = msgspec.structs.replace(METRICS.laws[1], extends_best=True)
    laws = (METRICS.laws[0], extension, *METRICS.laws[2:])
    metrics = msgspec.structs.replace(METRICS, laws=laws)
    assert metrics.close_laws == METRICS.laws[:1]
    assert "core" not in text(metrics)


def test_the_candidates_are_those_of_the_structure():
    assert "has no structure" in text(METRICS)
    structured = msgspec.structs.replace(METRICS, structure=("wall", "central"))
    assert "the structure of the fit (wall + central)" in text(structured)


def test_a_force_that_is_not_central_has_no_centre():
    central = msgspec.structs.replace(METRICS.central, verdict="not central")
    assert "centre (5 ± 0.1, 5 ± 0.1)" in METRICS.central.sentence()
    assert "centre" not in central.sentence()


def test_report_section_holds_figure_and_tables(tmp_path):
    folder = RunFolder.create(
        tmp_path / "run", {"run": {"command": "fit"}}, overwrite=False
    )
    assert law_sections(folder) == []
    save(simulate(paper()), folder.path / "data.npz")
    write_system_of(folder, paper())
    folder.write_json(LAWS_FILE, msgspec.to_builtins(METRICS))
    force = np.linspace(-1.0, 1.0, 20).reshape(10, 2)
    arrays = {"learned": force, "sd": 0.1 + 0.0 * force, "law": 1.1 * force}
    folder.write_arrays(SAMPLE_FILE, arrays | {"positions": force})
    (section,) = law_sections(folder)
    assert section.heading == "The law behind the force"
    assert (folder.path / "figures" / "laws.svg").is_file()


def test_messages(tmp_path, capsys):
    RunFolder.create(tmp_path / "run", {"run": {"command": "fit"}}, overwrite=False)
    for argv, words in (
        ([str(tmp_path / "run")], "holds no fitted"),
        ([str(tmp_path)], "holds no run"),
        ([str(tmp_path / "run"), "--refits", "0"], "--refits: expected 1 or more"),
    ):
        assert cli.run(["discover", *argv]) == cli.USAGE_ERROR
        assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "law", [*POTENTIALS, GAUSSIAN + GAUSSIAN], ids=lambda law: law.name
)
def test_every_formula_can_be_drawn(law):
    parsed = MathTextParser("path").parse(f"${latex(law)}$")
    assert parsed.width > 10


TRAP = """
name = "trap"
dimension = 2
order = 1
mobility = 0.5
observation = {noise = 0.01}
truth = {kind = "harmonic-trap", stiffness = 2.0, center = [1.0, -0.5]}
times = {first = 0.0, last = 3.0, samples = 61}

[starts]
kind = "uniform-starts"
lower = [-2.0, -2.0]
upper = [3.0, 3.0]
count = 6
"""


@pytest.mark.slow
def test_the_law_of_a_swimmer_without_inertia_is_a_force(tmp_path):
    (tmp_path / "trap.toml").write_text(TRAP)
    data, run = str(tmp_path / "trap.npz"), str(tmp_path / "run")
    for words in (
        ["simulate", str(tmp_path / "trap.toml"), "--out", data],
        ["fit", data, "--out", run],
        ["discover", run, "--refits", "2"],
    ):
        assert cli.run(words) == 0
    best = RunFolder.open(tmp_path / "run").read_metrics(LAWS_FILE, DiscoveryMetrics)
    assert best.laws[0].name == "harmonic"
    stiffness = best.laws[0].constants[0]
    assert stiffness.low < 2.0 < stiffness.high
    assert stiffness.unit == "F L⁻¹"


@pytest.mark.slow
def test_a_law_of_stochastic_paths_is_refused(fitted_run, capsys):
    run, _ = fitted_run("langevin")
    assert cli.run(["discover", str(run)]) == cli.USAGE_ERROR
    assert "expected a swimmer without thermal noise" in capsys.readouterr().err
