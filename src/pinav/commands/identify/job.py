"""`pinav fit RECORDING`: the selection of models on every track of a recording."""

import itertools
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from pinav.commands.command import CommandResult
from pinav.commands.identify.command import IDENTIFY
from pinav.commands.identify.settings import IdentifyOptions, IdentifySettings
from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.start import fingerprint, start_run
from pinav.errors import FitError, InputError
from pinav.fitting import Estimate
from pinav.identification import (
    Forecast,
    FrameJitter,
    Rollouts,
    Row,
    Selection,
    Track,
    TrackFit,
    coverage,
    delay_findings,
    finding_sentences,
    fit_track,
    path_of,
    select_model,
    tracks,
)
from pinav.identification.baselines import commands
from pinav.identification.forecast import HORIZONS, cycles
from pinav.identification.selection import BASELINES, RESIDUALS
from pinav.recordings import image_positions
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories, is_trajectories, load

SHOWN = 10.0
"""Horizon of bands, of figures and of the table in the terminal [s]."""

THREADS = 2
"""Tracks fitted side by side; JAX computes without Python's lock."""

FIGURES = 9
"""Tracks with figures, the longest ones."""


def fit_recording(
    settings: IdentifySettings,
    recording: Trajectories,
    folder: RunFolder,
    *,
    all_candidates: bool,
) -> dict[str, Any]:
    """Fit all candidates to each track and write the results; what is done stays done.

    Args:
        settings: how the recording is split.
        recording: positions, with commands where there were any.
        folder: of the run.
        all_candidates: with position-dependent residuals and all baselines too.

    Returns:
        The content of `metrics.json`.
    """
    driven = "frequency" in recording.commands
    found = tracks(recording, pooled=not driven)
    longest = sorted(found, key=lambda track: -track.duration)
    full = (
        {track.name for track in longest[: settings.tracks]}
        if all_candidates
        else set()
    )
    drawn = {track.name for track in longest[:FIGURES]}
    undone = [i for i in _mixed(found) if not folder.has(_stored(i))]

    def fitted(index: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        track = found[index]
        return _track(track, settings.share, full=track.name in full)

    with ThreadPoolExecutor(max_workers=THREADS) as pool:
        for index, (result, arrays) in zip(
            undone, pool.map(fitted, undone), strict=True
        ):
            name = found[index].name
            if name in drawn and arrays:
                arrays |= _in_image(recording, arrays)
                folder.write_arrays(f"track-{index}.npz", arrays)
            folder.write_json(_stored(index), result)
            folder.append_record({"track": name, "chosen": result.get("chosen")})
    results = {
        track.name: folder.read_json(_stored(i)) for i, track in enumerate(found)
    }
    metrics = {
        "units": {name: recording.units[name] for name in ("x", "t")},
        "tracks": results,
        "summary": summary(list(results.values())),
    }
    folder.write_table("candidates.csv", *_csv(results))
    folder.write_json("metrics.json", metrics)
    return metrics


def _mixed(found: list[Track]) -> list[int]:
    """Tracks in an order in which neighbours differ in length.

    Fits of one length share compiled code; side by side both would compile it.
    """
    by_length = sorted(range(len(found)), key=lambda i: -found[i].duration)
    half = (len(found) + 1) // 2
    long, short = by_length[:half], by_length[half:][::-1]
    pairs = itertools.zip_longest(long, short)
    return [index for pair in pairs for index in pair if index is not None]


def _stored(index: int) -> str:
    return f"track-{index}.json"


def _track(
    track: Track, share: float, *, full: bool
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Results of one track, and the arrays behind its figures."""
    residuals = tuple(RESIDUALS) if full else ()
    baselines = tuple(BASELINES) if full else ("least squares",)
    if not track.commanded:
        baselines = tuple(b for b in baselines if b != "Gaussian-process disturbance")
    begin = time.perf_counter()
    try:
        selection = select_model(
            track, share=share, residuals=residuals, baselines=baselines
        )
        whole = fit_track(track, selection.best.candidate, start=selection.best)
        delays = delay_findings(track, whole) if selection.train.commanded else None
    except (InputError, FitError) as error:
        return {"reason": str(error), "rows": []}, {}
    estimates = whole.estimates()
    jitter = FrameJitter.of(selection.train, path_of(selection.best))
    rollouts = Rollouts.of(selection.held_out, SHOWN)
    covered = coverage(selection.held_out, rollouts, selection.best, jitter)
    result = {
        "chosen": selection.chosen,
        "response": selection.best.candidate.response,
        "gain": whole.gain.tolist() if whole.candidate.gains else None,
        "duration": track.duration,
        "rows": [_row(row) for row in selection.rows],
        "estimates": {name: _pair(value) for name, value in estimates.items()},
        "coverage": {
            "inside": covered.inside,
            "at end": covered.at_end,
            "rollouts": covered.count,
        },
        "verdict": finding_sentences(selection, estimates, delays),
        "seconds": time.perf_counter() - begin,
    }
    if delays is not None:
        aligned = delays.zero_offset
        result["delay"] = {
            "free": _pair(delays.free),
            "offset": _pair(delays.offset),
            "offset without delay": _pair(delays.offset_without_delay),
            "zero offset": None if aligned is None else _pair(aligned),
            "turning rate": delays.turning_rate,
            "confounded": delays.confounded,
        }
    return result, _arrays(selection, whole, jitter, rollouts)


def _pair(estimate: Estimate) -> dict[str, float]:
    return {"value": estimate.value, "sd": estimate.sd}


def _row(row: Row) -> dict[str, Any]:
    """A line of the table as JSON."""
    return {
        "name": row.name,
        "log_evidence": row.log_evidence,
        "seconds": row.seconds,
        "velocity_r2": row.velocity_r2,
        "reason": row.reason,
        "horizons": {
            f"{horizon:g}": {
                "relative": found.relative,
                "median": found.median,
                "rollouts": len(found.distance),
            }
            for horizon, found in row.errors.items()
        },
    }


def _arrays(
    selection: Selection, whole: TrackFit, jitter: FrameJitter, rollouts: Rollouts
) -> dict[str, np.ndarray]:
    """What the figures of a track need."""
    held_out, fit = selection.held_out, selection.best
    arrays: dict[str, np.ndarray] = {}
    for index, piece in enumerate(held_out.pieces):
        arrays[f"observed/{index}"] = piece.states
    ends = zip(rollouts.piece, rollouts.first, rollouts.last, strict=True)
    forecasts = [Forecast.of(piece, fit, jitter) for piece in held_out.pieces]
    for index, (own, a, b) in enumerate(ends):
        arrays[f"predicted/{index}"] = forecasts[own].rollout(int(a), int(b))
        arrays[f"sd/{index}"] = np.sqrt(forecasts[own].variance(int(a), int(b))[-1])
    if whole.candidate.gains:
        arrays |= _speed_law(selection.track, whole)
    return arrays


def _in_image(
    recording: Trajectories, arrays: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Paths and bands in the pixels of the image, where they came from one."""
    if recording.provenance.get("positions", {}).get("unit in the file") != "px":
        return {}
    found = {}
    for key, values in arrays.items():
        if key.startswith(("observed/", "predicted/")):
            found[f"image {key}"] = image_positions(recording, values)
        if key.startswith("sd/"):
            found[f"image {key}"] = np.abs(image_positions(recording, values))
    return found


def _speed_law(track: Track, fit: TrackFit) -> dict[str, np.ndarray]:
    """Speed along the turned heading over blocks, and the response with its sd."""
    frequency, speed = [], []
    for piece in track.pieces:
        along = cycles(fit, piece) @ fit.gain.T
        drift = np.outer(piece.times - piece.times[0], fit.drift)
        later = np.searchsorted(piece.times, piece.times + track.width)
        index = np.arange(0, len(later), max(1, len(later) // 400))
        index = index[later[index] < len(piece.times)]
        later = later[index]
        step, seen = along[later] - along[index], (piece.states - drift)
        moved = seen[later] - seen[index]
        size = np.hypot(*step.T)
        interval = piece.times[later] - piece.times[index]
        rolling = size > 0
        speed.append(((moved * step).sum(axis=1) / np.where(rolling, size, 1))[rolling])
        speed[-1] = speed[-1] / interval[rolling]
        frequency.append(commands(piece)[0][index][rolling])
    places = np.linspace(0, max(float(np.concatenate(frequency).max()), 1e-3), 60)
    fitted, sd = fit.speed(places)
    return {
        "law/frequency": np.concatenate(frequency),
        "law/speed": np.concatenate(speed),
        "law/places": places,
        "law/fitted": fitted,
        "law/sd": sd,
    }


def label(name: str) -> str:
    """A candidate's name without those that it extends."""
    first, *others = name.split(" + ")
    return f"+ {others[-1]}" if others else first


def summary(results: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Medians over tracks of each line, and the sum of its evidence."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        for row in result["rows"]:
            if not row["reason"]:
                rows.setdefault(label(row["name"]), []).append(row)
            if row["name"] == result["chosen"]:
                rows.setdefault("chosen", []).append(row)
    return {
        name: {
            "tracks": len(group),
            "log_evidence": _total([row["log_evidence"] for row in group]),
            "velocity_r2": _median([row["velocity_r2"] for row in group]),
            "seconds": _median([row["seconds"] for row in group]),
            **{
                f"{quantity} {horizon:g}": _median(
                    [row["horizons"][f"{horizon:g}"][quantity] for row in group]
                )
                for quantity in ("relative", "median")
                for horizon in HORIZONS
            },
        }
        for name, group in rows.items()
    }


def _values(values) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values], float)


def _median(values) -> float | None:
    known = _values(values)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else None


def _total(values) -> float | None:
    known = _values(values)
    return float(known.sum()) if np.isfinite(known).all() else None


def _csv(results) -> tuple[list[str], list[list]]:
    header = ["track", "model", "log_evidence", "velocity_r2", "seconds"]
    header += [f"relative_{h:g}s" for h in HORIZONS] + [
        f"median_{h:g}s" for h in HORIZONS
    ]
    rows = []
    for name, result in results.items():
        for row in result["rows"]:
            if row["reason"]:
                continue
            found = [row["horizons"][f"{h:g}"] for h in HORIZONS]
            rows.append(
                [
                    name,
                    row["name"],
                    row["log_evidence"],
                    row["velocity_r2"],
                    row["seconds"],
                    *(cell["relative"] for cell in found),
                    *(cell["median"] for cell in found),
                ]
            )
    return header, rows


def text(metrics: dict[str, Any]) -> str:
    """The table and the verdicts for a terminal."""
    unit = metrics["units"]["x"]
    heads = [f"{h:g} s" for h in HORIZONS]
    lines = [
        f"{'median over tracks':<32}{'evidence':>10}{'R2':>8}"
        + "".join(f"{head:>9}" for head in heads)
        + f"{f'10 s [{unit}]':>12}{'fit [s]':>9}"
    ]
    for name, row in metrics["summary"].items():
        relative = [row[f"relative {h:g}"] for h in HORIZONS]
        cells = [_cell(row["log_evidence"], "10.1f"), _cell(row["velocity_r2"], "8.3f")]
        cells += [_cell(value, "9.3f") for value in relative]
        cells += [_cell(row["median 10"], "12.2f"), _cell(row["seconds"], "9.2f")]
        lines.append(f"{name:<32}" + "".join(cells))
    lines.append(
        "columns 1 s to 30 s: end-point error of held-out open-loop rollouts over the "
        "length of the path"
    )
    for name, result in metrics["tracks"].items():
        lines.append(f"{name}:")
        if "reason" in result:
            lines.append(f"  not fitted: {result['reason']}")
            continue
        lines += [f"  {sentence}" for sentence in result["verdict"]]
        covered = result["coverage"]
        if covered["rollouts"]:
            lines.append(
                f"  Nominal 90 % bands hold {100 * covered['inside']:.0f} % of the "
                f"held-out positions ({covered['rollouts']} rollouts of 10 s)."
            )
    return "\n".join(lines)


def _cell(value: float | None, form: str) -> str:
    width = int(form.split(".")[0])
    return f"{'–':>{width}}" if value is None else f"{value:{form}}"


def run(options: IdentifyOptions) -> CommandResult:
    """Identify as the command line does."""
    groups: list[IdentifySettings | RecordingSettings] = [options.settings]
    if is_trajectories(options.data):
        data = load(options.data)
    else:
        data = options.recording.read(options.data)
        groups.append(options.recording)
    identity = {
        "data": fingerprint(data),
        "baselines": str(options.baselines).lower(),
    }
    folder = start_run(IDENTIFY, options, *groups, **identity)
    metrics = fit_recording(
        options.settings, data, folder, all_candidates=options.baselines
    )
    return CommandResult(metrics, text(metrics), folder)
