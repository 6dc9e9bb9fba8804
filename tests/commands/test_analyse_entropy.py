"""Entropy production of thermal runs in `pinav analyse`."""

import pytest

from pinav import cli
from pinav.commands.analyse.job import produce_entropy
from pinav.commands.analyse.metrics import EntropyMetrics
from pinav.commands.fitted_run import FittedRun

TRAP = """
name = "trap"
dimension = 2
order = 1
mobility = 1.0

[thermal]
energy = 1.0

[unknown]
model = "kernel-force"

[truth]
kind = "harmonic-trap"
stiffness = 1.0
center = [0.0, 0.0]

[starts]
states = [[0.0, 0.0]]

[times]
first = 0.0
last = 40.0
samples = 2001
"""


def test_the_sentence_says_whether_equilibrium_is_excluded():
    out = EntropyMetrics(2.0, 0.3, 1.4)
    assert out.sentence() == (
        "entropy production of a steady state: 2 ± 0.3 (sd) k_B per unit of time: out "
        "of equilibrium; current velocity 1.4 (rms)"
    )
    assert "equilibrium is not excluded" in EntropyMetrics(0.5, 0.3, 1.4).sentence()


@pytest.mark.slow
def test_a_trap_is_not_out_of_equilibrium_and_a_potential_is_left_out(tmp_path):
    (tmp_path / "trap.toml").write_text(TRAP)
    data, run = str(tmp_path / "data.npz"), tmp_path / "run"
    assert cli.run(["simulate", str(tmp_path / "trap.toml"), "--out", data]) == 0
    assert cli.run(["fit", data, "--out", str(run)]) == 0
    fitted = FittedRun.open(run)
    entropy, arrays, left_out = produce_entropy(fitted)
    assert not left_out
    assert abs(entropy.rate) < 3 * entropy.sd
    assert arrays["entropy/current"].shape == arrays["entropy/positions"].shape
    potential = ["fit", data, "--out", str(run), "--model", "kernel-potential"]
    assert cli.run([*potential, "--overwrite"]) == 0
    entropy, _, left_out = produce_entropy(FittedRun.open(run))
    assert entropy is None
    assert "the model is a potential" in left_out[0]
