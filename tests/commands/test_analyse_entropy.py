"""Entropy production of thermal runs in `pinav analyse`."""

import numpy as np
import pytest

from pinav import cli
from pinav.analysis import EntropyProduction
from pinav.analysis.effects import produce_entropy
from pinav.commands.analyse.job import entropy_sentence
from pinav.errors import InputError
from pinav.fitting import Estimate
from pinav.learning.learned import Learned

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


def production(rate):
    current = np.array([[1.4, 0.0], [0.0, -1.4]])
    return EntropyProduction(Estimate(rate, 0.3), 0.1, 0.0 * current, current)


def test_the_sentence_says_whether_equilibrium_is_excluded():
    assert entropy_sentence(production(2.0)) == (
        "Entropy production of a steady state: 2 ± 0.3 (sd) k_B per unit of time: out "
        "of equilibrium; current velocity 1.4 (rms)."
    )
    assert "equilibrium is not excluded" in entropy_sentence(production(0.5))


@pytest.mark.slow
def test_a_trap_is_not_out_of_equilibrium_and_a_potential_is_left_out(tmp_path):
    (tmp_path / "trap.toml").write_text(TRAP)
    data, run = str(tmp_path / "data.npz"), tmp_path / "run"
    assert cli.run(["simulate", str(tmp_path / "trap.toml"), "--out", data]) == 0
    assert cli.run(["fit", data, "--out", str(run)]) == 0
    fitted = Learned.open(run)
    entropy = produce_entropy(fitted)
    assert abs(entropy.rate.value) < 3 * entropy.rate.sd
    assert entropy.current.shape == entropy.positions.shape
    potential = ["fit", data, "--out", str(run), "--model", "kernel-potential"]
    assert cli.run([*potential, "--overwrite"]) == 0
    with pytest.raises(InputError, match="the model is a potential"):
        produce_entropy(Learned.open(run))
