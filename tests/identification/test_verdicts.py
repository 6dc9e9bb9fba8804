"""Verdicts agree with themselves: numbers hold their intervals, losses are said."""

import numpy as np

from pinav.fitting import Estimate
from pinav.identification import candidates
from pinav.identification.drive import response_name
from pinav.identification.findings import _offset, _range, choice, shortcomings
from pinav.identification.parameters import CORNER, DELAY, DRIFT, GAIN, RESIDUAL
from pinav.identification.rollouts import Errors
from pinav.identification.selection import Row


def rows(ours, theirs, *, rollouts=4, r2=0.9):
    """The chosen line and that of least squares."""

    def row(name, error):
        errors = Errors.of(np.full(rollouts, error), np.ones(rollouts))
        return Row(name, 0.0, 0.0, {"10": errors}, r2)

    return row("chosen", ours), row("least squares", theirs)


def test_a_loss_to_least_squares_a_prediction_of_nothing_and_few_rollouts_are_said():
    (sentence,) = shortcomings(*rows(0.07, 0.04))
    assert "loses to least squares: 0.070 against 0.040" in sentence
    assert shortcomings(*rows(0.03, 0.04)) == []
    first, second = shortcomings(*rows(0.03, 0.04, rollouts=1, r2=0.02))
    assert "explains 2 % of the held-out velocity's variance" in first
    assert "that of a single rollout" in second
    (none,) = shortcomings(*rows(0.03, 0.04, rollouts=0))
    assert "No held-out rollout of 10 s" in none


def test_evidence_is_said_to_choose_only_what_has_most_of_it():
    most = choice("slips", "slipping", {"linear": 1.0, "slipping": 9.0})
    assert most == "The evidence chooses: slips."
    less = choice("slips", "slipping", {"linear": 3.5, "slipping": 1.0})
    assert "does not decide the response" in less
    assert "linear is 2.5 nats ahead of slipping" in less
    assert choice("drift only", "linear", {}) == "The evidence chooses: drift only."


def test_an_interval_holds_its_value():
    assert _range(11.66, 11.7, 11.74) == "11.66 to 11.74"
    assert _range(11.0, 11.7, 12.4) == "11 to 12"
    assert _range(1.0, 1.0, 1.0) == "1 to 1"


def test_an_offset_that_is_not_known_is_not_stated():
    assert _offset(Estimate(0.57, 0.34)) == "not known to within 19 degrees"
    assert _offset(Estimate(0.57, 0.01)) == "32.7 ± 0.6 degrees"
    assert _offset(Estimate(0.57, 4.0)).startswith("not known, because the heading")


def test_a_verdict_compares_with_the_same_model():
    chosen = candidates.with_response(candidates.gain_matrix(), "slipping")
    chosen = candidates.with_learned(chosen, "delay", DELAY)
    slow = candidates.with_slow_drift(chosen)
    scalar = candidates.like(candidates.scalar_gain(), chosen)
    assert scalar.name == "scalar gain, else as chosen"
    assert [n.path for n in scalar.learn] == [GAIN, CORNER, RESIDUAL, DELAY]
    assert scalar.swimmer.propulsion.gain.ndim == 0
    assert response_name(scalar.swimmer) == "slipping"
    idle = candidates.like(candidates.drift_only(), slow)
    assert idle.name == "drift only, else as chosen"
    assert [number.path for number in idle.learn] == [DRIFT]
    assert idle.wandering == slow.wandering
    assert response_name(idle.swimmer) == "linear"
    alone = candidates.drift_only()
    assert candidates.like(alone, chosen) is alone
