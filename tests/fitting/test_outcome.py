"""One outcome for all fits, which reads as a word."""

import jax.numpy as jnp
import pytest

from pinav.fitting import Outcome, confirm


def test_an_outcome_prints_its_word():
    assert str(Outcome.CONVERGED) == "converged"
    assert f"{Outcome.UNDER_RESOLVED}" == "under-resolved"
    assert f"{Outcome.STALLED:>8}" == " stalled"


def test_a_traced_outcome_becomes_itself_again():
    chosen = jnp.where(jnp.asarray(1) > 0, Outcome.CONVERGED, Outcome.STALLED)
    assert Outcome(int(chosen)) is Outcome.CONVERGED


@pytest.mark.parametrize(
    ("outcome", "own", "independent", "confirmed"),
    [
        (Outcome.CONVERGED, 1e-6, 2e-4, Outcome.CONVERGED),
        (Outcome.CONVERGED, 1e-6, 0.02, Outcome.STALLED),
        (Outcome.CONVERGED, 1e-6, float("nan"), Outcome.STALLED),
        (Outcome.MISFIT, 1e-6, 0.02, Outcome.MISFIT),
        (Outcome.CONVERGED, 0.02, 0.021, Outcome.CONVERGED),  # the noise of residuals
    ],
)
def test_only_a_second_solver_confirms_a_fit(outcome, own, independent, confirmed):
    assert confirm(outcome, own, independent, spread=4.0) is confirmed
