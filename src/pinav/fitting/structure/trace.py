"""Hypotheses of a search, how each of them ended, and the time that is left."""

import time

import equinox as eqx
import numpy as np

from pinav.fitting.structure.kinds import signature
from pinav.fitting.structure.trials import Terms


class Hypothesis(eqx.Module):
    """Terms that a search weighed.

    Attributes:
        kinds: of the terms, sorted; none of free kernels alone.
        log_evidence: in the data to which `ended` belongs [nats]; None of no fit.
        misfit: standard deviation of what it left, relative to the noise; None where it
            was not computed.
        seconds: since the search began.
        ended: why it went no further.
    """

    kinds: tuple[str, ...]
    log_evidence: float | None
    misfit: float | None
    seconds: float
    ended: str


class Trace:
    """The hypotheses of a search so far, and its budget.

    Args:
        budget: seconds after which the best fit so far is the result.
    """

    def __init__(self, budget: float = np.inf) -> None:
        self.hypotheses: list[Hypothesis] = []
        self._start = time.monotonic()
        self._budget = budget

    @property
    def is_over(self) -> bool:
        """True if the budget is spent."""
        return time.monotonic() - self._start > self._budget

    def note(
        self,
        terms: Terms,
        ended: str,
        log_evidence: float | None = None,
        misfit: float | None = None,
    ) -> None:
        """Keep a hypothesis and how it ended."""
        seconds = time.monotonic() - self._start
        self.hypotheses.append(
            Hypothesis(
                signature(terms), _finite(log_evidence), _finite(misfit), seconds, ended
            )
        )


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
