"""The results of `pinav identify`, as its JSON files hold them."""

from collections.abc import Iterable

import msgspec
import numpy as np

from pinav import identification
from pinav.commands.cells import EstimateRow, Row
from pinav.identification.forecast import HORIZONS

NUMBER = float | None
"""A number, or none where it is not finite."""


class HorizonErrors(Row, frozen=True):
    """Errors of the held-out rollouts of one length.

    Attributes:
        relative: median of the end-point error over the length of the path.
        median: median of the end-point error [L].
        rollouts: their number.
    """

    relative: NUMBER
    median: NUMBER
    rollouts: int


class CandidateRow(Row, frozen=True):
    """A line of the table of a track.

    Attributes:
        name: of the candidate or baseline.
        log_evidence: of the training part; none for baselines [nats].
        seconds: that the fit took.
        velocity_r2: explained part of the held-out velocity's variance.
        reason: why there are no results, where there are none.
        horizons: errors by the length of the rollouts in seconds.
    """

    name: str
    log_evidence: NUMBER
    seconds: NUMBER
    velocity_r2: NUMBER
    reason: str
    horizons: dict[str, HorizonErrors]

    @classmethod
    def of_candidate(cls, row: identification.Row) -> "CandidateRow":
        """The line of a candidate."""
        horizons = {f"{horizon:g}": errors for horizon, errors in row.errors.items()}
        return cls.of(row, horizons=horizons)

    @property
    def label(self) -> str:
        """The name without the candidates that this one extends."""
        return label(self.name)


class CoverageOfBands(Row, frozen=True):
    """How often held-out positions lie within nominal bands of 90 %.

    Attributes:
        inside: part of all coordinates within the band.
        at_end: the same at the ends of the rollouts.
        rollouts: their number.
    """

    inside: NUMBER
    at_end: NUMBER
    rollouts: int


class DelayMetrics(Row, frozen=True):
    """Delay and heading offset; see `DelayFindings`."""

    free: EstimateRow
    offset: EstimateRow
    offset_without_delay: EstimateRow
    zero_offset: EstimateRow | None
    turning_rate: float
    confounded: bool


class TrackMetrics(msgspec.Struct, frozen=True):
    """The results of one track.

    Attributes:
        reason: why it was not fitted; empty where it was.
        chosen: name of the candidate that the evidence chose.
        response: what becomes of the speed at high frequencies.
        free: nonlinear parameters that the chosen candidate learns.
        gain: gain matrix [L per cycle]; none where nothing was commanded.
        duration: observed time [s].
        rows: the table.
        estimates: what the chosen candidate learned from the whole track.
        coverage: of the bands on the held-out part.
        findings: sentences on what the track supports.
        delay: what it says of delay and heading offset.
        seconds: that all of it took.
    """

    reason: str = ""
    chosen: str = ""
    response: str = "linear"
    free: tuple[str, ...] = ()
    gain: list[list[float]] | None = None
    duration: float = 0.0
    rows: tuple[CandidateRow, ...] = ()
    estimates: dict[str, EstimateRow] = {}
    coverage: CoverageOfBands | None = None
    findings: tuple[str, ...] = ()
    delay: DelayMetrics | None = None
    seconds: float = 0.0

    def error_at(self, horizon: float, name: str) -> NUMBER:
        """Relative error of rollouts of a length [s], of one line of the table."""
        for row in self.rows:
            if row.name == name and not row.reason:
                return row.horizons[f"{horizon:g}"].relative
        return None

    def gain_text(self) -> str:
        """The gain matrix on a line; a dash where there is none."""
        if self.gain is None:
            return "–"
        rows = (" ".join(f"{value:.3g}" for value in row) for row in self.gain)
        return "; ".join(rows)


class SummaryRow(msgspec.Struct, frozen=True):
    """Medians over tracks of one candidate or baseline.

    Attributes:
        tracks: their number.
        log_evidence: summed over tracks [nats].
        velocity_r2: median.
        seconds: median.
        relative: medians of the relative error by horizon in seconds.
        median: medians of the error by horizon in seconds [L].
    """

    tracks: int
    log_evidence: NUMBER
    velocity_r2: NUMBER
    seconds: NUMBER
    relative: dict[str, NUMBER]
    median: dict[str, NUMBER]

    @classmethod
    def of(cls, rows: list[CandidateRow]) -> "SummaryRow":
        """The summary of lines of different tracks."""
        keys = [f"{horizon:g}" for horizon in HORIZONS]
        return cls(
            tracks=len(rows),
            log_evidence=_total(row.log_evidence for row in rows),
            velocity_r2=_median(row.velocity_r2 for row in rows),
            seconds=_median(row.seconds for row in rows),
            relative={k: _median(r.horizons[k].relative for r in rows) for k in keys},
            median={k: _median(r.horizons[k].median for r in rows) for k in keys},
        )


class IdentifyMetrics(msgspec.Struct, frozen=True):
    """The results of a recording.

    Attributes:
        units: of positions, x, and of time, t.
        system: name of the track whose system the run holds; none without one.
        tracks: results by the name of the track.
        summary: medians over tracks by the label of the candidate or baseline.
        remarks: how the recording was read, and what looks odd about it.
    """

    units: dict[str, str]
    system: str | None
    tracks: dict[str, TrackMetrics]
    summary: dict[str, SummaryRow]
    remarks: tuple[str, ...] = ()

    def text(self) -> str:
        """The table and the findings for a terminal."""
        lines = [_heading(self.units["x"])]
        lines += [_line(name, row) for name, row in self.summary.items()]
        lines.append(
            "columns 1 s to 30 s: end-point error of held-out open-loop rollouts over "
            "the length of the path"
        )
        pooled = pooled_coverage(self.tracks.values())
        if pooled is not None and len(self.tracks) > 1:
            lines.append(
                f"nominal 90 % bands hold {100 * pooled:.0f} % of the held-out "
                "positions of all tracks"
            )
        for name, track in self.tracks.items():
            lines += [f"{name}:", *(f"  {line}" for line in _track_lines(track))]
        lines += self.remarks
        if self.system is not None:
            lines.append(f"system.toml: the swimmer of track {self.system}")
        return "\n".join(lines)


def label(name: str) -> str:
    """A candidate's name without those that it extends."""
    first, *others = name.split(" + ")
    return f"+ {others[-1]}" if others else first


def summarise_tracks(tracks: Iterable[TrackMetrics]) -> dict[str, SummaryRow]:
    """Medians over tracks of each line, and of the chosen candidates."""
    rows: dict[str, list[CandidateRow]] = {}
    for track in tracks:
        for row in track.rows:
            if not row.reason:
                rows.setdefault(row.label, []).append(row)
            if row.name == track.chosen:
                rows.setdefault("chosen", []).append(row)
    return {name: SummaryRow.of(group) for name, group in rows.items()}


SHOWN = 10.0
"""Length of the rollouts of bands, of figures and of tables of all tracks [s]."""


def pooled_coverage(tracks: Iterable[TrackMetrics]) -> NUMBER:
    """Share of held-out positions within bands, over all rollouts; none without any."""
    bands = [track.coverage for track in tracks if track.coverage is not None]
    count = sum(band.rollouts for band in bands)
    inside = sum(
        as_float(band.inside) * band.rollouts for band in bands if band.rollouts
    )
    return inside / count if count else None


def as_float(value: NUMBER) -> float:
    """A number; NaN where there is none."""
    return float("nan") if value is None else value


def _finite(values: Iterable[NUMBER]) -> tuple[np.ndarray, bool]:
    """The finite ones, and whether all are."""
    array = np.array([as_float(value) for value in values], float)
    finite = np.isfinite(array)
    return array[finite], bool(finite.all())


def _median(values: Iterable[NUMBER]) -> NUMBER:
    known, _ = _finite(values)
    return float(np.median(known)) if len(known) else None


def _total(values: Iterable[NUMBER]) -> NUMBER:
    known, complete = _finite(values)
    return float(known.sum()) if complete else None


def _heading(unit: str) -> str:
    horizons = "".join(f"{f'{h:g} s':>9}" for h in HORIZONS)
    first = f"{'median over tracks':<32}{'evidence':>10}{'R2':>8}"
    return first + horizons + f"{f'10 s [{unit}]':>12}{'fit [s]':>9}"


def _line(name: str, row: SummaryRow) -> str:
    cells = [_cell(row.log_evidence, 10, 1), _cell(row.velocity_r2, 8, 3)]
    cells += [_cell(value, 9, 3) for value in row.relative.values()]
    cells += [_cell(row.median["10"], 12, 2), _cell(row.seconds, 9, 2)]
    return f"{name:<32}" + "".join(cells)


def _cell(value: NUMBER, width: int, digits: int) -> str:
    return f"{'–':>{width}}" if value is None else f"{value:{width}.{digits}f}"


def _track_lines(track: TrackMetrics) -> list[str]:
    if track.reason:
        return [f"not fitted: {track.reason}"]
    lines, bands = list(track.findings), track.coverage
    if track.gain is not None:
        lines.append(f"Gain matrix, rows x and y of the velocity: {track.gain_text()}.")
    if bands is not None and bands.rollouts:
        lines.append(
            f"Nominal 90 % bands hold {100 * as_float(bands.inside):.0f} % of the "
            f"held-out positions ({bands.rollouts} rollouts of 10 s)."
        )
    return lines
