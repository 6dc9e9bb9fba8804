"""`identify`: the response to commands that each track of a recording supports."""

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float

from pinav.errors import FitError, InputError
from pinav.fitting import Estimate, EvidenceFit
from pinav.identification.baselines import least_squares
from pinav.identification.candidates import system_of
from pinav.identification.drive import gain_of
from pinav.identification.estimates import estimates
from pinav.identification.findings import (
    DelayFindings,
    delay_findings,
    finding_sentences,
)
from pinav.identification.fit import fit_track
from pinav.identification.rollouts import (
    HORIZONS,
    Coverage,
    ErrorGrowth,
    Errors,
    Paths,
    Rollouts,
    SpeedLaw,
    coverage,
)
from pinav.identification.selection import RESIDUALS, Row, select_model
from pinav.identification.tracks import Track, tracks
from pinav.recordings.conventions import remarks
from pinav.systems import System, parse_system, system_text
from pinav.trajectories import Trajectories

SHOWN = 10.0
"""Length of the rollouts of bands and of figures [s]."""

FIGURES = 9
"""Tracks with figures, the longest ones."""

THREADS = 2
"""Tracks fitted side by side; JAX computes without Python's lock."""


@dataclasses.dataclass(frozen=True)
class IdentifiedTrack:
    """The results of one track.

    Attributes:
        duration: observed time [T].
        reason: cause where it was not fitted.
        gain: gain matrix [L per cycle]; none without a propulsion.
        estimates: numbers of the chosen candidate, fitted to the whole track; names and
            units as in `QUANTITIES`.
        system_file: the identified swimmer as the text of a system file.
        image_paths: rollouts in pixels of the image, if there was one.
    """

    name: str
    duration: float
    reason: str = ""
    chosen: str = ""
    rows: tuple[Row, ...] = ()
    gain: Float[np.ndarray, "2 2"] | None = None
    estimates: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    coverage: Coverage | None = None
    findings: tuple[str, ...] = ()
    delay: DelayFindings | None = None
    seconds: float = 0.0
    system_file: str = ""
    paths: Paths | None = None
    image_paths: Paths | None = None
    growth: ErrorGrowth | None = None
    law: SpeedLaw | None = None

    @property
    def system(self) -> System:
        """The swimmer that was found; its open numbers may be learned again."""
        return parse_system(self.system_file)

    def row(self, name: str) -> Row | None:
        """A line of the table by its name; none without results."""
        return next((r for r in self.rows if r.name == name and not r.reason), None)


@dataclasses.dataclass(frozen=True)
class Identification:
    """The results of a recording.

    Attributes:
        system: name of the track that gives the system of the recording; none if no
            track was fitted.
        summary: medians over tracks of each candidate and baseline, by its label; the
            log evidence is summed.
    """

    units: dict[str, str]
    system: str | None
    tracks: tuple[IdentifiedTrack, ...]
    summary: dict[str, Row]
    remarks: tuple[str, ...] = ()

    def track(self, name: str) -> IdentifiedTrack:
        """The results of a track by its name."""
        return next(track for track in self.tracks if track.name == name)

    @property
    def fitted(self) -> list[IdentifiedTrack]:
        """The tracks that could be fitted."""
        return [track for track in self.tracks if not track.reason]


OnTrack = Callable[[int, IdentifiedTrack, EvidenceFit | None], None]
"""Called with the place of a track, its results, and the fit to all of it."""


def identify(
    recording: Trajectories,
    *,
    train_fraction: float = 0.7,
    fields: int = 0,
    track: str | None = None,
    done: Mapping[int, IdentifiedTrack] | None = None,
    on_track: OnTrack | None = None,
) -> Identification:
    """Compare all candidates on each track of a recording.

    Args:
        train_fraction: part of each track's time for training, from its beginning.
        fields: number of tracks, the longest ones, with fits of fields of position.
        track: name of the track that gives the system; the longest driven one by
            default.
        done: results of tracks that are not fitted again, by their places.
        on_track: called when a track is done, in no order.

    Raises:
        InputError: nothing is long enough to fit, or no track has that name, or it
            could not be fitted.
    """
    several = tracks(recording, pooled=is_pooled(recording))
    check_track(track, several)
    results = dict(done or {})
    longest = sorted(several, key=lambda one: -one.duration)
    full, drawn = ({t.name for t in longest[:n]} for n in (fields, FIGURES))
    undone = [place for place in alternate_lengths(several) if place not in results]

    def identify_one(place: int) -> tuple[IdentifiedTrack, EvidenceFit | None]:
        one = several[place]
        kinds = tuple(RESIDUALS) if one.name in full else ()
        options = {"train_fraction": train_fraction, "drawn": one.name in drawn}
        return identify_track(one, recording, residuals=kinds, **options)

    with ThreadPoolExecutor(max_workers=THREADS) as pool:
        pairs = zip(undone, pool.map(identify_one, undone), strict=True)
        for place, (result, fit) in pairs:
            results[place] = result
            if on_track:
                on_track(place, result, fit)
    ordered = tuple(results[place] for place in range(len(several)))
    return Identification(
        units={name: recording.units[name] for name in ("x", "t")},
        system=_system_track(track, ordered),
        tracks=ordered,
        summary=summarise(ordered),
        remarks=tuple(remarks(recording)),
    )


def is_pooled(recording: Trajectories) -> bool:
    """True where particles of a kind are one track: without commands."""
    return "frequency" not in recording.commands


def check_track(name: str | None, several: Sequence[Track]) -> None:
    """Raise `InputError` where no track has this name."""
    names = [track.name for track in several]
    if name is not None and name not in names:
        raise InputError(
            f"--track: no track is called {name!r}; expected one of {', '.join(names)}"
        )


def alternate_lengths(several: Sequence[Track]) -> list[int]:
    """Tracks ordered so that neighbours differ in length.

    Fits of one length share compiled code; side by side both would compile it.
    """
    by_length = sorted(range(len(several)), key=lambda i: -several[i].duration)
    half = (len(several) + 1) // 2
    long, short = by_length[:half], by_length[half:][::-1]
    pairs = itertools.zip_longest(long, short)
    return [index for pair in pairs for index in pair if index is not None]


def identify_track(
    track: Track,
    recording: Trajectories,
    *,
    train_fraction: float = 0.7,
    residuals: Sequence[str] = (),
    drawn: bool = True,
) -> tuple[IdentifiedTrack, EvidenceFit | None]:
    """Results of one track, and the fit to all of it; none where it has none."""
    begin = time.perf_counter()
    try:
        selection = select_model(
            track, train_fraction=train_fraction, residuals=residuals
        )
        candidate, held_out = selection.system, selection.held_out
        whole = fit_track(track, candidate, start=selection.best)
        commanded = selection.train.commanded
        rolls = commanded and gain_of(candidate.swimmer) is not None
        delays = delay_findings(track, candidate, whole) if rolls else None
    except (InputError, FitError) as error:
        return IdentifiedTrack(track.name, track.duration, str(error)), None
    numbers, predictor = estimates(whole), selection.predictor
    rollouts = Rollouts.of(held_out, SHOWN)
    system = system_of(
        whole,
        jitter=predictor.jitter.deviation,
        name=track.name,
        units=dict(recording.units),
    )
    result = IdentifiedTrack(
        name=track.name,
        duration=track.duration,
        chosen=selection.chosen,
        rows=tuple(selection.rows),
        gain=gain_of(whole.model),
        estimates=numbers,
        coverage=coverage(held_out, rollouts, predictor),
        findings=tuple(finding_sentences(selection, numbers, delays)),
        delay=delays,
        seconds=time.perf_counter() - begin,
        system_file=_with_estimates(system_text(system), selection.chosen, numbers),
    )
    if not drawn:
        return result, whole
    paths = Paths.of(held_out, predictor, rollouts)
    baseline = least_squares(selection.train)
    return dataclasses.replace(
        result,
        paths=paths,
        image_paths=paths.in_image(recording),
        growth=ErrorGrowth.of(held_out, predictor, baseline),
        law=None if result.gain is None else SpeedLaw.of(track, whole),
    ), whole


def _with_estimates(text: str, chosen: str, numbers: Mapping[str, Estimate]) -> str:
    """A system's file with the estimates and their deviations as comments."""
    lines = [
        f"# {name}: {one.value:.6g} ± {one.sd:.2g} (standard deviation)"
        for name, one in numbers.items()
    ]
    return "\n".join([f"# Identified by pinav: {chosen}.", *lines, "", text])


def _system_track(name: str | None, several: Iterable[IdentifiedTrack]) -> str | None:
    results = {track.name: track for track in several}
    fitted = [track for track in results.values() if not track.reason]
    if name is not None:
        if results[name].reason:
            raise InputError(f"--track {name}: {results[name].reason}")
        return name
    fitted.sort(key=lambda track: (track.gain is None, -track.duration))
    return fitted[0].name if fitted else None


def summarise(several: Iterable[IdentifiedTrack]) -> dict[str, Row]:
    """Medians over tracks of each line, and of the chosen candidates."""
    rows: dict[str, list[Row]] = {}
    for track in several:
        for row in track.rows:
            if not row.reason:
                rows.setdefault(row.label, []).append(row)
            if row.name == track.chosen:
                rows.setdefault("chosen", []).append(row)
    return {name: _median_row(name, group) for name, group in rows.items()}


def _median_row(name: str, rows: Sequence[Row]) -> Row:
    by_horizon = {f"{h:g}": [row.errors[f"{h:g}"] for row in rows] for h in HORIZONS}
    return Row(
        name=name,
        log_evidence=float(sum(row.log_evidence for row in rows)),
        seconds=_median([row.seconds for row in rows]),
        errors={
            horizon: Errors(
                relative=_median([one.relative for one in errors]),
                median=_median([one.median for one in errors]),
                rollouts=sum(one.rollouts for one in errors),
            )
            for horizon, errors in by_horizon.items()
        },
        velocity_r2=_median([row.velocity_r2 for row in rows]),
        tracks=len(rows),
    )


def _median(values: Sequence[float]) -> float:
    known = np.array(values, float)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


def pooled_coverage(several: Iterable[IdentifiedTrack]) -> float:
    """Share of held-out positions within bands, over all rollouts; NaN without any."""
    bands = [track.coverage for track in several if track.coverage is not None]
    count = sum(band.rollouts for band in bands)
    inside = sum(band.inside * band.rollouts for band in bands if band.rollouts)
    return inside / count if count else float("nan")
