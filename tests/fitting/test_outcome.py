"""One outcome for all fits, which reads as a word."""

import jax.numpy as jnp

from pinav.fitting import Outcome


def test_an_outcome_prints_its_word():
    assert str(Outcome.CONVERGED) == "converged"
    assert f"{Outcome.UNDER_RESOLVED}" == "under-resolved"
    assert f"{Outcome.STALLED:>8}" == " stalled"


def test_a_traced_outcome_becomes_itself_again():
    chosen = jnp.where(jnp.asarray(1) > 0, Outcome.CONVERGED, Outcome.STALLED)
    assert Outcome(int(chosen)) is Outcome.CONVERGED
