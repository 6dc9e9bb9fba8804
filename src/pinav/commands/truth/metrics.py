"""The results of `pinav truth`, as its files hold them."""

import math
from collections.abc import Sequence

import msgspec

from pinav.fitting import Estimate
from pinav.report import Table, number

BAND = 1.96
"""Standard deviations on either side of a band of 95 %."""


class TruthRow(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
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


class TruthCase(msgspec.Struct, frozen=True, omit_defaults=True):
    """One recording.

    Attributes:
        name: of its folder.
        kind: what is known of it.
        status: "judged", "absent", "skipped" or "failed".
        reason: why it was not judged.
        seconds: from reading to the last row, StochasticForceInference apart.
        rows: its quantities.
        notes: what else the fit says, in sentences.
    """

    name: str
    kind: str
    status: str
    reason: str = ""
    seconds: float | None = None
    rows: tuple[TruthRow, ...] = ()
    notes: tuple[str, ...] = ()


class TruthMetrics(msgspec.Struct, frozen=True):
    """All cases of a folder.

    Attributes:
        cases: in the order of the table.
    """

    cases: tuple[TruthCase, ...]

    def case(self, name: str) -> TruthCase:
        """The case of a folder."""
        return next(case for case in self.cases if case.name == name)

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


def case_table(cases: Sequence[TruthCase]) -> Table:
    """Quantity by quantity, with the seconds of each case in its first row."""
    rows = []
    for case in cases:
        if case.status != "judged":
            rows.append((case.name, f"{case.status}: {case.reason}", *["–"] * 8))
        for index, row in enumerate(case.rows):
            first = index == 0
            rows.append(
                (
                    case.name if first else "",
                    row.quantity,
                    _with_error(row.truth, row.truth_sd),
                    _with_band(row.learned, row.sd),
                    WORDS[row.covered],
                    row.bar or "–",
                    WORDS[row.met],
                    number(row.naive, 3),
                    number(row.peer, 3),
                    number(case.seconds, 2) if first else "–",
                )
            )
    return Table(HEADER, rows, NOTE)


HEADER = (
    *("case", "quantity", "truth ± sd", "learned, 95 % band", "covered", "bar", "met"),
    *("naive", "SFI", "seconds"),
)
NOTE = (
    "The fit sees the recording alone. Covered: the truth lies in the 95 % band of "
    "both errors. Naive: one lag, no blur. SFI: StochasticForceInference, where it is "
    "installed."
)


def _with_error(value: float | None, sd: float | None) -> str:
    if value is None:
        return "–"
    if sd is None:
        return number(value)
    shown, spread = _round_to_error((value, sd), sd)
    return f"{shown} ± {spread}"


def _with_band(value: float, sd: float | None) -> str:
    if sd is None:
        return number(value)
    shown, low, high = _round_to_error(
        (value, value - BAND * sd, value + BAND * sd), sd
    )
    return f"{shown} [{low}, {high}]"


def _round_to_error(values: Sequence[float], sd: float) -> list[str]:
    """Numbers with as many digits as their standard deviation allows."""
    if not 1e-5 < sd < 1e5:
        return [number(value) for value in values]
    digits = max(0, 1 - math.floor(math.log10(sd)))
    return [f"{value:.{digits}f}".replace("-", "−") for value in values]


WORDS = {None: "–", True: "yes", False: "no"}
"""Answers in a table."""
