"""What fits of recordings are judged by: quantities and fields beside their truths."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pinav.fitting import Estimate

BAND = 1.96
"""Standard deviations on either side of a band of 95 %."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TruthRow:
    """A learned quantity beside its truth.

    Attributes:
        quantity: its name and unit.
        truth: what is known of it; none where it is judged in itself.
        truth_sd: standard deviation of that.
        learned: what the fit found.
        sd: its standard deviation, where the fit gives one.
        covered: the truth lies in the 95 % band of both errors.
        bar: what is asked for, in words.
        met: the bar is met; none where nothing is asked.
        naive: of one lag, or without blur.
        peer: of StochasticForceInference.
    """

    quantity: str
    truth: float | None = None
    truth_sd: float | None = None
    learned: float
    sd: float | None = None
    covered: bool | None = None
    bar: str = ""
    met: bool | None = None
    naive: float | None = None
    peer: float | None = None


def compare_estimates(
    quantity: str,
    truth: Estimate,
    learned: Estimate,
    *,
    bar: str = "",
    met: bool | None = None,
    naive: float | None = None,
) -> TruthRow:
    """A row whose truth and estimate have errors; covered if they agree within both."""
    both = math.hypot(truth.sd, learned.sd)
    return TruthRow(
        quantity=quantity,
        truth=truth.value,
        truth_sd=truth.sd,
        learned=learned.value,
        sd=learned.sd,
        covered=abs(learned.value - truth.value) <= BAND * both,
        bar=bar,
        met=met,
        naive=naive,
    )


def error_row(
    quantity: str,
    error: float,
    most: float,
    *,
    naive: float | None = None,
    peer: float | None = None,
) -> TruthRow:
    """A row of an error [%] that shall be small, and smaller than the peer's.

    Args:
        quantity: its name.
        error: of the fit, a fraction.
        most: the bar, a fraction.
        naive: error of the naive estimate, a fraction.
        peer: that of the peer.
    """
    met = error <= most and (peer is None or error <= peer)
    bar = f"at most {100 * most:g} %"
    return TruthRow(
        quantity=f"{quantity} [%]",
        truth=0.0,
        learned=100 * error,
        bar=bar if peer is None else f"{bar}, and the peer's",
        met=met,
        naive=None if naive is None else 100 * naive,
        peer=None if peer is None else 100 * peer,
    )


class Curve(NamedTuple):
    """A field beside its truth.

    Attributes:
        title: what is shown.
        labels: of the two axes, with units.
        places: along the field.
        learned: the field.
        sd: its standard deviation.
        truth: at the same places.
        truth_sd: standard deviation of the truth.
    """

    title: str
    labels: tuple[str, str]
    places: Float[np.ndarray, " place"]
    learned: Float[np.ndarray, " place"]
    sd: Float[np.ndarray, " place"]
    truth: Float[np.ndarray, " place"]
    truth_sd: Float[np.ndarray, " place"]


class Judgement(NamedTuple):
    """Rows, figures and remarks of one case.

    Attributes:
        rows: quantities beside their truths.
        curves: fields beside theirs.
        notes: what else the fit says, in sentences.
        seconds: from reading to the last row, StochasticForceInference apart.
    """

    rows: tuple[TruthRow, ...]
    curves: tuple[Curve, ...]
    notes: tuple[str, ...]
    seconds: float


@dataclasses.dataclass(frozen=True)
class TruthCase:
    """One recording.

    Attributes:
        name: of its folder.
        known: what is known of it, the kind of its description.
        status: "judged", "absent", "skipped" or "failed".
        reason: why it was not judged.
        seconds: from reading to the last row, StochasticForceInference apart.
        rows: its quantities.
        notes: what else the fit says, in sentences.
        curves: fields beside their truths.
    """

    name: str
    known: str
    status: str
    reason: str = ""
    seconds: float | None = None
    rows: tuple[TruthRow, ...] = ()
    notes: tuple[str, ...] = ()
    curves: tuple[Curve, ...] = ()


@dataclasses.dataclass(frozen=True)
class Truth:
    """All cases of a folder.

    Attributes:
        cases: in the order of the table.
    """

    cases: tuple[TruthCase, ...]

    @property
    def failures(self) -> list[str]:
        """Sentences on bars that are missed and cases that failed."""
        missed = [
            f"{case.name}: {row.quantity}: {row.learned:.4g}, expected {row.bar}"
            for case in self.cases
            for row in case.rows
            if row.met is False
        ]
        failed = [
            f"{case.name}: {case.reason}"
            for case in self.cases
            if case.status == "failed"
        ]
        return [*failed, *missed]
