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
    ("outcome", "independent", "confirmed"),
    [
        (Outcome.CONVERGED, 2e-4, Outcome.CONVERGED),
        (Outcome.CONVERGED, 0.02, Outcome.STALLED),
        (Outcome.CONVERGED, float("nan"), Outcome.STALLED),
        (Outcome.MISFIT, 0.02, Outcome.MISFIT),
    ],
)
def test_only_a_second_solver_confirms_a_fit(outcome, independent, confirmed):
    assert confirm(outcome, 1e-6, independent, spread=4.0) is confirmed


def test_residuals_of_noise_are_confirmed_at_the_level_of_the_noise():
    ended = confirm(Outcome.CONVERGED, 0.02, 0.021, spread=4.0)
    assert ended is Outcome.CONVERGED
