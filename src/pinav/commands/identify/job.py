"""`pinav identify`: model selection on every track of a recording, and a system."""

import dataclasses

from pinav.commands import IDENTIFY
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.identify import IdentifyOptions
from pinav.commands.results import fingerprint, keep, start_run
from pinav.commands.sweep import run_files
from pinav.fitting import EvidenceFit
from pinav.fitting.environments.summary import ModelChoice, summarise_data
from pinav.identification import (
    Identification,
    IdentifiedTrack,
    identify,
    identify_track,
    tracks,
    trajectories_of,
)
from pinav.identification.identify import is_pooled
from pinav.identification.rollouts import HORIZONS
from pinav.learning.learned import DATA_FILE, ModelHeader, of_evidence
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories


def run(options: IdentifyOptions) -> CommandResult:
    """Identify as the command line does; tracks that are done stay done."""
    file = options.file
    if file is None:
        return run_files(IDENTIFY, options)
    recording = read_data(file, options.reading)
    if recording.channels == ("x", "y", "z"):
        recording = recording.only(("x", "y"))  # the commands are headings in the plane
    settings = options.settings
    folder = start_run(
        IDENTIFY, options, settings, options.reading, data=fingerprint(recording)
    )
    fits: dict[str, EvidenceFit] = {}

    def keep_track(place: int, track: IdentifiedTrack, fit: EvidenceFit | None) -> None:
        if fit is not None:
            fits[track.name] = fit
            folder.write_text(f"system-{place}.toml", track.system_file)
        folder.store(f"track-{place}", track)
        folder.append_record({"track": track.name, "chosen": track.chosen})

    result = identify(
        recording,
        train_fraction=settings.train_fraction,
        fields=settings.max_tracks if settings.candidates == "all" else 0,
        track=settings.track,
        done=_finished_tracks(folder, recording),
        on_track=keep_track,
    )
    if result.system is not None:
        _write_system(folder, result, recording, fits, settings.train_fraction)
    folder.write_table("candidates.csv", *_table(result))
    return keep(IDENTIFY, folder, result)


def _finished_tracks(
    folder: RunFolder, recording: Trajectories
) -> dict[int, IdentifiedTrack]:
    """Results that an earlier start of the run has written."""
    places = range(len(tracks(recording, pooled=is_pooled(recording))))
    return {
        place: folder.load(f"track-{place}", IdentifiedTrack)
        for place in places
        if folder.has(f"track-{place}.json")
    }


def _write_system(
    folder: RunFolder,
    result: Identification,
    recording: Trajectories,
    fits: dict[str, EvidenceFit],
    train_fraction: float,
) -> None:
    """Write the system of the run, its model with the posterior, and its data."""
    if folder.has(DATA_FILE) and folder.has("model.eqx"):
        return
    track = result.track(result.system or "")
    data = trajectories_of(recording, track.name, pooled=is_pooled(recording))
    system = track.system
    fit = fits.get(track.name) or _fit_again(recording, track.name, train_fraction)
    # The run keeps the noise of single positions, and no constants of the noise.
    jitter, paths = system.observation.noise, [number.path for number in system.learn]
    constants = {
        name: estimate
        for name, estimate in fit.constants.items()
        if name.partition("[")[0] in paths
    }
    chosen = dataclasses.replace(fit.hyperparameters, noise=jitter)
    fit = dataclasses.replace(fit, constants=constants, hyperparameters=chosen)
    choice = ModelChoice(name="physics-only", learn=tuple(paths))
    header = ModelHeader(choice, summarise_data(data))
    of_evidence(header, fit, system, data).write(folder)


def _fit_again(
    recording: Trajectories, name: str, train_fraction: float
) -> EvidenceFit:
    """The fit of a track that was done when the run was killed."""
    several = tracks(recording, pooled=is_pooled(recording))
    track = next(one for one in several if one.name == name)
    options = {"train_fraction": train_fraction, "drawn": False}
    fit = identify_track(track, recording, **options)[1]
    assert fit is not None
    return fit


def _table(result: Identification) -> tuple[list[str], list[list]]:
    """All lines of all tracks, for a CSV file."""
    header = ["track", "model", "log_evidence", "velocity_r2", "seconds"]
    header += [f"relative_{h:g}s" for h in HORIZONS]
    header += [f"median_{h:g}s" for h in HORIZONS]
    rows = []
    for track in result.tracks:
        for row in track.rows:
            if not row.reason:
                errors = row.errors.values()
                numbers = [row.log_evidence, row.velocity_r2, row.seconds]
                numbers += [one.relative for one in errors]
                numbers += [one.median for one in errors]
                blank = [None if value != value else value for value in numbers]
                rows.append([track.name, row.name, *blank])
    return header, rows
