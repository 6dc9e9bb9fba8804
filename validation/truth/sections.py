"""The sections of a report on recordings whose truth is known."""

import math
from collections.abc import Sequence

from matplotlib.figure import Figure
from validation.truth.metrics import BAND, Curve, Truth, TruthCase

from pinav.evaluation import normal_quantile
from pinav.figures.images import Picture
from pinav.figures.palette import LEARNED, TRUTH
from pinav.figures.style import add_legend, label_axes, new_figure, prepare_axes
from pinav.report import Paragraph, Section, Table, capitalise, number


def sections(result: Truth) -> list[Section]:
    """The table of all cases, the bars that are missed, and a section for each case."""
    bars = [row.met for case in result.cases for row in case.rows if row.bar]
    count = f"{sum(map(bool, bars))} of {len(bars)} bars met"
    missed = [f"missed: {text}" for text in result.failures]
    return [
        Section("Learned, and known by physics", [case_table(result.cases)]),
        Section("What failed", [Paragraph(text) for text in (count, *missed)]),
        *(_case_section(case) for case in result.cases if case.status == "judged"),
    ]


def _case_section(case: TruthCase) -> Section:
    notes = [Paragraph(note) for note in case.notes]
    pictures = [
        _picture(f"truth-{case.name}-{index}", curve)
        for index, curve in enumerate(case.curves)
    ]
    return Section(case.name, [*notes, *pictures])


def _picture(name: str, curve: Curve) -> Picture:
    caption = (
        f"{capitalise(curve.title)}. Blue: learned, with its 95 % band; black: the "
        "truth, with twice its standard deviation."
    )
    alt = capitalise(curve.title)
    return Picture(name, lambda: truth_band(curve), caption, alt, width=0.6)


def truth_band(curve: Curve) -> Figure:
    """A field along one coordinate with its band of 95 %, and its truth.

    The truth is not drawn where it is NaN; its band is twice its standard deviation.
    """
    figure = new_figure(4.0, 3.2)
    ax, places = prepare_axes(figure.add_subplot()), curve.places
    half = normal_quantile() * curve.sd
    low, high = curve.learned - half, curve.learned + half
    ax.fill_between(places, low, high, color=LEARNED, alpha=0.25, lw=0)
    ax.plot(places, curve.learned, color=LEARNED, lw=1.2, label="learned, 95 % band")
    ax.plot(
        places, curve.truth, color=TRUTH, lw=1.0, ls="--", label="known independently"
    )
    low, high = curve.truth - 2 * curve.truth_sd, curve.truth + 2 * curve.truth_sd
    ax.fill_between(places, low, high, color=TRUTH, alpha=0.12, lw=0)
    x, y = (label.replace("um", "µm") for label in curve.labels)
    label_axes(ax, x, y)
    add_legend(ax)
    return figure


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
