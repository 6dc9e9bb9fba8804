"""`pinav identify`: model selection on every track of a recording, and a system."""

import itertools
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from pinav.commands.cells import EstimateRow
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.identify import IDENTIFY
from pinav.commands.identify.figures import figure_arrays
from pinav.commands.identify.metrics import (
    SHOWN,
    CandidateRow,
    CoverageOfBands,
    DelayMetrics,
    IdentifyMetrics,
    TrackMetrics,
    summarise_tracks,
)
from pinav.commands.identify.settings import IdentifyOptions, IdentifySettings
from pinav.commands.many_files import run_files
from pinav.commands.start import fingerprint, start_run
from pinav.errors import FitError, InputError
from pinav.fitting.environments.choice import ModelChoice
from pinav.fitting.environments.summary import summarise_data
from pinav.identification import (
    FrameJitter,
    Rollouts,
    Track,
    TrackFit,
    coverage,
    delay_findings,
    evidence_fit_of,
    finding_sentences,
    fit_track,
    path_of,
    select_model,
    system_of,
    tracks,
    trajectories_of,
)
from pinav.identification.forecast import HORIZONS
from pinav.identification.models import BOTH, FULL, CandidateModel
from pinav.identification.selection import RESIDUALS
from pinav.learning.evidence import Evidence
from pinav.learning.learned import DATA_FILE, ModelHeader, of_evidence
from pinav.recordings.conventions import remarks
from pinav.runs import RunFolder
from pinav.systems import system_text
from pinav.trajectories import Trajectories

THREADS = 2
"""Tracks fitted side by side; JAX computes without Python's lock."""

FIGURES = 9
"""Tracks with figures, the longest ones."""


def run(options: IdentifyOptions) -> CommandResult:
    """Identify as the command line does."""
    file, *others = options.data
    if others:
        return run_files(IDENTIFY, options)
    recording = read_data(file, options.recording)
    if recording.channels == ("x", "y", "z"):
        recording = recording.only(("x", "y"))  # the commands are headings in the plane
    settings = options.settings
    folder = start_run(
        IDENTIFY, options, settings, options.recording, data=fingerprint(recording)
    )
    metrics = identify(settings, recording, folder)
    return CommandResult(metrics, metrics.text(), folder)


def identify(
    settings: IdentifySettings, recording: Trajectories, folder: RunFolder
) -> IdentifyMetrics:
    """Compare all candidates on each track and write the results and a system.

    Tracks that are done stay done.

    Args:
        settings: how the recording is split, and how much is compared.
        recording: positions, with commands where there were any.
        folder: of the run.

    Raises:
        InputError: nothing is long enough to fit, or no track has the name that was
            asked for.
    """
    pooled = "frequency" not in recording.commands
    several = tracks(recording, pooled=pooled)
    _check_name(settings.track, several)
    longest = sorted(several, key=lambda track: -track.duration)
    compared = longest[: settings.max_tracks] if settings.candidates == "all" else []
    full = {track.name for track in compared}
    drawn = {track.name for track in longest[:FIGURES]}
    undone = [i for i in _alternate_lengths(several) if not folder.has(_track_file(i))]

    def result(index: int) -> "_Result":
        track = several[index]
        return _identify_track(
            track,
            settings.train_fraction,
            full=track.name in full,
            drawn=track.name in drawn,
        )

    with ThreadPoolExecutor(max_workers=THREADS) as pool:
        for index, one in zip(undone, pool.map(result, undone), strict=True):
            name = several[index].name
            if one.arrays:
                arrays = one.arrays | _in_image(recording, one.arrays)
                folder.write_arrays(f"track-{index}.npz", arrays)
            if one.fit is not None:
                _write_track_fit(folder, index, one, name, recording.units)
            folder.write_metrics(_track_file(index), one.metrics)
            folder.append_record({"track": name, "chosen": one.metrics.chosen})
    results = {
        track.name: folder.read_metrics(_track_file(i), TrackMetrics)
        for i, track in enumerate(several)
    }
    chosen = _system_track(settings.track, results)
    if chosen is not None:
        index = [track.name for track in several].index(chosen)
        trajectories = trajectories_of(recording, chosen, pooled=pooled)
        _write_system(folder, index, chosen, results[chosen], trajectories)
    metrics = IdentifyMetrics(
        units={name: recording.units[name] for name in ("x", "t")},
        system=chosen,
        tracks=results,
        summary=summarise_tracks(results.values()),
        remarks=remarks(recording),
    )
    folder.write_table("candidates.csv", *_table(results))
    folder.write_metrics("metrics.json", metrics)
    return metrics


def _check_name(name: str | None, several: list[Track]) -> None:
    names = [track.name for track in several]
    if name is not None and name not in names:
        raise InputError(
            f"--track: no track is called {name!r}; expected one of {', '.join(names)}"
        )


def _alternate_lengths(several: list[Track]) -> list[int]:
    """Tracks in an order in which neighbours differ in length.

    Fits of one length share compiled code; side by side both would compile it.
    """
    by_length = sorted(range(len(several)), key=lambda i: -several[i].duration)
    half = (len(several) + 1) // 2
    long, short = by_length[:half], by_length[half:][::-1]
    pairs = itertools.zip_longest(long, short)
    return [index for pair in pairs for index in pair if index is not None]


def _track_file(index: int) -> str:
    return f"track-{index}.json"


class _Result:
    """What one track gave; without a fit where it could not be fitted."""

    def __init__(
        self,
        metrics: TrackMetrics,
        arrays: dict[str, np.ndarray] | None = None,
        fit: TrackFit | None = None,
        jitter: float = 0.0,
    ) -> None:
        self.metrics, self.arrays = metrics, arrays or {}
        self.fit, self.jitter = fit, jitter


def _identify_track(
    track: Track, fraction: float, *, full: bool, drawn: bool
) -> _Result:
    """Results of one track, and the arrays behind its figures where it is drawn."""
    residuals = tuple(RESIDUALS) if full else ()
    begin = time.perf_counter()
    try:
        selection = select_model(track, train_fraction=fraction, residuals=residuals)
        whole = fit_track(track, selection.best.candidate, start=selection.best)
        delays = delay_findings(track, whole) if selection.train.commanded else None
    except (InputError, FitError) as error:
        return _Result(TrackMetrics(reason=str(error), duration=track.duration))
    estimates = whole.estimates()
    jitter = FrameJitter.of(selection.train, path_of(selection.best))
    rollouts = Rollouts.of(selection.held_out, SHOWN)
    bands = coverage(selection.held_out, rollouts, selection.best, jitter)
    metrics = TrackMetrics(
        chosen=selection.chosen,
        response=whole.candidate.response,
        free=whole.candidate.free,
        gain=whole.gain.tolist() if whole.candidate.gains else None,
        duration=track.duration,
        rows=tuple(map(CandidateRow.of_candidate, selection.rows)),
        estimates={n: EstimateRow.of(one) for n, one in estimates.items()},
        coverage=CoverageOfBands.of(bands),
        findings=tuple(finding_sentences(selection, estimates, delays)),
        delay=None if delays is None else DelayMetrics.of(delays),
        seconds=time.perf_counter() - begin,
    )
    arrays = figure_arrays(selection, whole, jitter, rollouts) if drawn else {}
    return _Result(metrics, arrays, whole, jitter.deviation)


def _write_track_fit(
    folder: RunFolder, index: int, one: _Result, name: str, units: dict[str, str]
) -> None:
    """Keep what the system of a track is made of, and the system itself."""
    fit = one.fit
    assert fit is not None
    folder.write_arrays(
        f"fit-{index}.npz",
        {
            "theta": fit.theta,
            "coefficients": fit.coefficients,
            "covariance": fit.covariance,
            "log_evidence": np.array(fit.log_evidence),
            "fastest": np.array(fit.fastest),
            "jitter": np.array(one.jitter),
        },
    )
    system = system_of(fit, jitter=one.jitter, name=name, units=units)
    folder.write_text(f"system-{index}.toml", _with_intervals(system_text(system), one))


def _with_intervals(text: str, one: _Result) -> str:
    """A system's file with the estimates and their deviations as comments."""
    lines = [
        f"# {name}: {value.value:.6g} ± {value.sd:.2g} (standard deviation)"
        for name, value in one.metrics.estimates.items()
    ]
    head = f"# Identified by pinav: {one.metrics.chosen}."
    return "\n".join([head, *lines, "", text])


def _read_track_fit(
    folder: RunFolder, index: int, metrics: TrackMetrics
) -> tuple[TrackFit, float]:
    """The fit of a track and the deviation of single frames."""
    stored = folder.read_arrays(f"fit-{index}.npz")
    candidate = CandidateModel(
        metrics.chosen,
        gains=FULL if metrics.gain is not None else (),
        drifts=BOTH,
        response=metrics.response,
        free=metrics.free,
    )
    fit = TrackFit(
        candidate=candidate,
        theta=stored["theta"],
        coefficients=stored["coefficients"],
        covariance=stored["covariance"],
        log_evidence=float(stored["log_evidence"]),
        evaluations=0,
        fastest=float(stored["fastest"]),
    )
    return fit, float(stored["jitter"])


def _system_track(name: str | None, results: dict[str, TrackMetrics]) -> str | None:
    """The track whose system the run holds: the longest one that was driven."""
    fitted = {key: track for key, track in results.items() if not track.reason}
    if name is not None:
        if name not in fitted:
            raise InputError(f"--track {name}: {results[name].reason}")
        return name
    order = sorted(
        fitted, key=lambda key: (fitted[key].gain is None, -fitted[key].duration)
    )
    return order[0] if order else None


def _write_system(
    folder: RunFolder, index: int, name: str, metrics: TrackMetrics, data: Trajectories
) -> None:
    """Write the system of the run, its model with the posterior, and its data."""
    if folder.has(DATA_FILE) and folder.has("model.eqx"):
        return
    fit, jitter = _read_track_fit(folder, index, metrics)
    system = system_of(fit, jitter=jitter, name=name, units=data.units)
    paths = tuple(number.path for number in system.learn)
    header = ModelHeader(
        ModelChoice(name="physics-only", learn=paths), summarise_data(data)
    )
    result = evidence_fit_of(fit, jitter=jitter)
    evidence = Evidence.of(result, header.choice, data)
    of_evidence(header, result, system, data, evidence).write(folder)


def _in_image(
    recording: Trajectories, arrays: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Paths and bands in the pixels of the image, where they came from one."""
    from pinav.recordings import image_positions

    if recording.provenance.get("positions", {}).get("unit in the file") != "px":
        return {}
    pixels = {}
    for key, values in arrays.items():
        if key.startswith(("observed/", "predicted/", "whole/")):
            pixels[f"image {key}"] = image_positions(recording, values)
        if key.startswith("sd/"):
            pixels[f"image {key}"] = np.abs(image_positions(recording, values))
    return pixels


def _table(results: dict[str, TrackMetrics]) -> tuple[list[str], list[list]]:
    """All lines of all tracks, for a CSV file."""
    header = ["track", "model", "log_evidence", "velocity_r2", "seconds"]
    header += [f"relative_{h:g}s" for h in HORIZONS]
    header += [f"median_{h:g}s" for h in HORIZONS]
    rows = []
    for name, track in results.items():
        for row in track.rows:
            if row.reason:
                continue
            cells = [row.horizons[f"{h:g}"] for h in HORIZONS]
            numbers = [row.log_evidence, row.velocity_r2, row.seconds]
            errors = [cell.relative for cell in cells] + [cell.median for cell in cells]
            rows.append([name, row.name, *numbers, *errors])
    return header, rows
