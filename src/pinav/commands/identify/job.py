"""`pinav identify`: a model of every track of a recording, and a system."""

import dataclasses
from collections.abc import Callable

from pinav.commands import IDENTIFY
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.identify import IdentifyOptions
from pinav.commands.results import fingerprint, keep, start_run
from pinav.commands.sweep import run_files
from pinav.figures.identification import horizons_figure, track_figures
from pinav.fitting import Estimate, EvidenceFit
from pinav.fitting.environments.summary import ModelChoice, summarise_data
from pinav.identification import (
    Identification,
    IdentifiedTrack,
    Row,
    identify,
    identify_track,
    tracks,
    trajectories_of,
)
from pinav.identification.findings import positive_interval
from pinav.identification.identify import SHOWN, is_pooled, pooled_coverage
from pinav.identification.parameters import ESTIMATED, Parameter, Scale
from pinav.identification.rollouts import HORIZONS
from pinav.identification.selection import LEAST_SQUARES
from pinav.learning.learned import DATA_FILE, ModelHeader, of_evidence
from pinav.report import AbstractBlock, Cell, Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories
from pinav.units import unit_of


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
                rows.append([track.name, row.name, *numbers])
    return header, rows


SCOPE = (
    "The robots in public recordings of this kind are rollers and cellbots of 5 to "
    "30 µm in plain fluid: nothing here is a claim about tissue."
)


def sections(result: Identification) -> list[Section]:
    """The comparison over all tracks, and what each of them supports."""
    overview = [Paragraph(SCOPE), _summary(result), horizons_figure(result)]
    overview += [_tracks(result), *map(Paragraph, result.remarks)]
    if result.system is not None:
        line = f"system.toml: the swimmer of track {result.system}"
        overview.append(Paragraph(line))
    return [
        Section("The selection of models", overview),
        *(
            Section(f"Track {track.name}", _track(index, track, result.units))
            for index, track in enumerate(result.tracks)
        ),
    ]


def _errors(row: Row) -> list[Cell]:
    """Relative errors by horizon."""
    return [row.errors[f"{horizon:g}"].relative for horizon in HORIZONS]


def _summary(result: Identification) -> Table:
    unit = result.units["x"]
    header = ("model", "tracks", "log evidence", "velocity R²")
    header += (*(f"{h:g} s" for h in HORIZONS), f"10 s ({unit})", "fit (s)")
    rows = [
        (
            name,
            row.tracks,
            row.log_evidence,
            row.velocity_r2,
            *_errors(row),
            row.errors["10"].median,
            row.seconds,
        )
        for name, row in result.summary.items()
    ]
    return Table(
        header,
        rows,
        "Held-out part of each track: medians over tracks of the end-point error "
        "of open-loop rollouts of 1 to 30 s from observed positions, as a fraction "
        f"of the path length, and in {unit} for 10 s. The log evidence is that of "
        "the training parts, summed.",
    )


def _tracks(result: Identification) -> Table:
    """Each track on a line: the choice, its gain, its errors and its bands."""

    def error(track: IdentifiedTrack, name: str) -> Cell:
        row = track.row(name)
        errors = None if row is None else row.over(SHOWN)
        return None if errors is None else errors.relative

    def held(track: IdentifiedTrack) -> Cell:
        bands = track.coverage
        if bands is None or not bands.rollouts:
            return None
        return f"{100 * bands.inside:.0f} %"

    columns: dict[str, Callable[[IdentifiedTrack], Cell]] = {
        "track": lambda track: track.name,
        "model": lambda track: next(
            row.label for row in track.rows if row.name == track.chosen
        ),
        f"gain ({result.units['x']} per turn)": gain_text,
        "10 s": lambda track: error(track, track.chosen),
        "least squares": lambda track: error(track, LEAST_SQUARES),
        "in band": held,
    }
    note = (
        "Gain: the matrix of the whole track, rows x and y of the velocity. 10 s: "
        "median end-point error over the path, of the chosen model and of least "
        "squares. In band: held-out positions within nominal bands of 90 %"
    )
    pooled = pooled_coverage(result.fitted)
    note += "." if pooled != pooled else f"; pooled {100 * pooled:.0f} %."
    return Table.of(result.fitted, columns, note)


def gain_text(track: IdentifiedTrack) -> str | None:
    """The gain matrix on a line, if there is one."""
    if track.gain is None:
        return None
    return "; ".join(" ".join(f"{v:.3g}" for v in row) for row in track.gain)


def _track(
    index: int, track: IdentifiedTrack, units: dict[str, str]
) -> list[AbstractBlock]:
    if track.reason:
        return [Paragraph(f"Not fitted: {track.reason}")]
    blocks: list[AbstractBlock] = [*map(Paragraph, track.findings)]
    bands = track.coverage
    if bands is not None and bands.rollouts:
        blocks.append(
            Paragraph(
                f"Nominal bands of 90 % hold {100 * bands.inside:.1f} % of the "
                f"held-out positions, {100 * bands.at_end:.1f} % at the end of "
                f"{bands.rollouts} rollouts of 10 s."
            )
        )
    if track.paths is None:
        return blocks
    estimates = Table(
        ("quantity", "unit", "value", "from", "to", "meaning"),
        [estimate_row(name, one, units) for name, one in track.estimates.items()],
        "The chosen candidate on the whole track, with intervals of 95 %.",
    )
    blocks += [estimates, *_gain(track, units), _rows(track)]
    return blocks + track_figures(index, track, units)


def estimate_row(
    name: str, estimate: Estimate, units: dict[str, str]
) -> tuple[Cell, ...]:
    """A row of the table; a quantity that is not described there keeps its name."""
    shown = ESTIMATED.get(name, Parameter(name, name, scale=Scale.PLAIN))
    ends = estimate.low, estimate.high
    if shown.scale is Scale.LOG:
        ends = positive_interval(estimate)
    unit = unit_of(shown.dimension, {"L": units["x"], "T": units["t"]})
    title = shown.title or name
    return (title, unit, estimate.value, *ends, shown.meaning)


def _gain(track: IdentifiedTrack, units: dict[str, str]) -> list[Table]:
    """The gain matrix."""
    if track.gain is None:
        return []
    rows = [
        (f"velocity {axis}", *map(float, row))
        for axis, row in zip("xy", track.gain, strict=True)
    ]
    note = (
        f"Gain matrix [{units['x']} per turn]: velocity for an effective frequency of "
        "1 Hz along each axis of the commanded heading."
    )
    return [Table(("", "heading x", "heading y"), rows, note)]


def _rows(track: IdentifiedTrack) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for row in track.rows:
        name = row.label + (" (chosen)" if row.name == track.chosen else "")
        if row.reason:
            rows.append((name, row.reason, *(None,) * (len(HORIZONS) + 1)))
        else:
            rows.append((name, row.log_evidence, row.velocity_r2, *_errors(row)))
    header = ("model", "log evidence", "velocity R²", *(f"{h:g} s" for h in HORIZONS))
    return Table(header, rows, "Errors of held-out rollouts over the path length.")
