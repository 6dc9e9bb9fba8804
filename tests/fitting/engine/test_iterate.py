import jax.numpy as jnp
import numpy as np
import pytest

from pinav.fitting.engine.evidence_fit import iterate
from pinav.fitting.evidence.weights import NoWeights
from pinav.fitting.least_squares import Regression
from pinav.fitting.outcome import Outcome

COLUMN = np.linspace(0.5, 2.0, 12)
DATA = np.exp(0.7 * COLUMN) + 0.01 * np.random.default_rng(0).normal(size=12)


def problem():
    return Regression.of(
        jnp.asarray(0.6),
        lambda rate: jnp.exp(rate * COLUMN) - DATA,
        weights=lambda _: (),
        weights_prior=NoWeights(),
        constants=lambda rate: rate,
    )


@pytest.mark.parametrize(("is_likelier", "more"), [(False, 0), (True, 2)])
def test_a_step_under_another_prior_is_judged_by_the_one_after_it(
    monkeypatch, is_likelier, more
):
    """Its own defect is that of the point from which it went."""
    asked = []

    def search_anew(self, quadratic, chosen, noise):
        asked.append(True)
        return chosen if is_likelier else None

    monkeypatch.setattr(NoWeights, "search_anew", search_anew)
    steps_before = []
    outcome, steps = iterate(
        problem(), 20, lambda _: steps_before.append(None if asked else True)
    )
    assert outcome is Outcome.CONVERGED
    assert len(asked) == 1
    assert len(steps) == steps_before.count(True) + more


def test_an_iteration_that_goes_on_repeats_no_step():
    outcome, whole = iterate(problem(), 20)
    _, begun = iterate(problem(), 20, enough=lambda _: True)
    assert len(begun) < len(whole)
    seen = []
    ended, steps = iterate(problem(), 20, seen.append, begun=begun)
    assert ended is outcome
    assert [one.done for one in seen] == [*range(len(begun) + 1, len(whole) + 1)]
    for one, other in zip(steps, whole, strict=True):
        np.testing.assert_array_equal(one.move.theta, other.move.theta)
