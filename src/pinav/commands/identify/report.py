"""Figures and sections of `pinav identify`."""

import numpy as np

from pinav.commands.identify.metrics import (
    SHOWN,
    IdentifyMetrics,
    TrackMetrics,
    as_float,
    label,
    pooled_coverage,
)
from pinav.commands.identify.quantities import QUANTITIES, Quantity
from pinav.figures import save_figure
from pinav.figures.identification import (
    error_growth,
    horizon_errors,
    rollout_paths,
    single_rollouts,
    speed_law,
)
from pinav.figures.style import new_figure
from pinav.fitting import Estimate
from pinav.identification import interval, positive_interval
from pinav.identification.forecast import HORIZONS
from pinav.identification.selection import LEAST_SQUARES
from pinav.report import Image, Paragraph, Section, Table
from pinav.runs import RunFolder

SCOPE = (
    "The robots in public recordings of this kind are rollers and cellbots of 5 to "
    "30 µm in plain fluid: nothing here is a claim about tissue."
)

DRAWN = (
    "drift only",
    "scalar gain",
    "gain matrix and drift",
    "chosen",
    "least squares",
)
"""Lines of the figure of errors by horizon."""


def identification_sections(folder: RunFolder) -> list[Section]:
    """The sections of a recording's report."""
    metrics = folder.read_metrics("metrics.json", IdentifyMetrics)
    sections = [Section("The selection of models", _overview(folder, metrics))]
    for index, (name, result) in enumerate(metrics.tracks.items()):
        if result.reason:
            text = [Paragraph(f"Not fitted: {result.reason}")]
            sections.append(Section(f"Track {name}", text))
        elif folder.has(f"track-{index}.npz"):
            content = _track(folder, index, result, metrics.units)
            sections.append(Section(f"Track {name}", content))
    return sections


def _overview(
    folder: RunFolder, metrics: IdentifyMetrics
) -> list[Paragraph | Table | Image]:
    unit = metrics.units["x"]
    header = (
        "model",
        "tracks",
        "log evidence",
        "velocity R²",
        *(f"{h:g} s" for h in HORIZONS),
        f"10 s ({unit})",
        "fit (s)",
    )
    rows = [
        (
            name,
            row.tracks,
            *map(_cell, (row.log_evidence, row.velocity_r2)),
            *map(_cell, row.relative.values()),
            *map(_cell, (row.median["10"], row.seconds)),
        )
        for name, row in metrics.summary.items()
    ]
    relative = {
        name: [as_float(value) for value in metrics.summary[name].relative.values()]
        for name in DRAWN
        if name in metrics.summary
    }
    figure = new_figure(5.0, 3.4)
    horizon_errors(HORIZONS, relative, ax=figure.subplots())
    files = save_figure(figure, folder.path / "figures", "horizons")
    return [
        Paragraph(SCOPE),
        Table(
            header,
            rows,
            "Held-out part of each track: medians over tracks of the end-point error "
            "of open-loop rollouts of 1 to 30 s from observed positions, as a fraction "
            f"of the path length, and in {unit} for 10 s. The log evidence is that of "
            "the training parts, summed.",
        ),
        Image(
            files.svg,
            "Rollout error over the horizon for each model",
            "Error over horizon, medians over tracks.",
        ),
        _track_table(metrics),
    ]


def _track_table(metrics: IdentifyMetrics) -> Table:
    """Each track on a line: what was chosen, its gain, its errors and its bands."""
    fitted = {n: track for n, track in metrics.tracks.items() if not track.reason}
    rows = []
    for name, track in fitted.items():
        bands = track.coverage
        inside = None if bands is None else bands.inside
        held = "–" if inside is None else f"{100 * inside:.0f} %"
        errors = [
            _cell(track.error_at(SHOWN, row)) for row in (track.chosen, LEAST_SQUARES)
        ]
        rows.append((name, label(track.chosen), track.gain_text(), *errors, held))
    unit = metrics.units["x"]
    header = ("track", "model", f"gain ({unit} per turn)", "10 s", "least squares")
    note = (
        "Gain: the matrix of the whole track, rows x and y of the velocity. 10 s: "
        "median end-point error over the path, of the chosen model and of least "
        "squares. In band: held-out positions within nominal bands of 90 %"
    )
    pooled = pooled_coverage(fitted.values())
    note += "." if pooled is None else f"; pooled {100 * pooled:.0f} %."
    return Table((*header, "in band"), rows, note)


def _cell(value: float | None) -> float | str:
    return "–" if value is None else value


def _track(
    folder: RunFolder, index: int, result: TrackMetrics, units: dict[str, str]
) -> list[Paragraph | Table | Image]:
    content: list[Paragraph | Table | Image] = [
        Paragraph(sentence) for sentence in result.findings
    ]
    bands = result.coverage
    if bands is not None and bands.rollouts:
        content.append(
            Paragraph(
                f"Nominal bands of 90 % hold {100 * as_float(bands.inside):.1f} % of "
                f"the held-out positions, {100 * as_float(bands.at_end):.1f} % at the "
                f"end of {bands.rollouts} rollouts of 10 s."
            )
        )
    return [
        *content,
        _estimates(result, units),
        *_gain(result, units),
        _rows(result),
        *_figures(folder, index, units),
    ]


def _estimates(result: TrackMetrics, units: dict[str, str]) -> Table:
    rows = [
        _estimate(name, Estimate(as_float(value.value), as_float(value.sd)), units)
        for name, value in result.estimates.items()
    ]
    note = "The chosen candidate on the whole track, with intervals of 95 %."
    return Table(("quantity", "unit", "value", "from", "to", "meaning"), rows, note)


def _estimate(
    name: str, estimate: Estimate, units: dict[str, str]
) -> tuple[str | float, ...]:
    """A row of the table; a quantity that is not described there keeps its name."""
    shown = QUANTITIES.get(name, Quantity(name, "1"))
    between = positive_interval if shown.positive else interval
    unit = shown.unit.format(length=units["x"], time=units["t"])
    return (shown.title, unit, estimate.value, *between(estimate), shown.meaning)


def _gain(result: TrackMetrics, units: dict[str, str]) -> list[Table]:
    """The gain matrix."""
    if result.gain is None:
        return []
    rows = [
        (f"velocity {axis}", *row) for axis, row in zip("xy", result.gain, strict=True)
    ]
    note = (
        f"Gain matrix [{units['x']} per turn]: velocity for an effective frequency of "
        "1 Hz along each axis of the commanded heading."
    )
    return [Table(("", "heading x", "heading y"), rows, note)]


def _rows(result: TrackMetrics) -> Table:
    rows: list[tuple[float | str, ...]] = []
    for row in result.rows:
        name = row.label + (" (chosen)" if row.name == result.chosen else "")
        if row.reason:
            rows.append((name, row.reason, *("–",) * (len(HORIZONS) + 1)))
            continue
        errors = [_cell(row.horizons[f"{h:g}"].relative) for h in HORIZONS]
        rows.append((name, _cell(row.log_evidence), _cell(row.velocity_r2), *errors))
    header = ("model", "log evidence", "velocity R²", *(f"{h:g} s" for h in HORIZONS))
    return Table(header, rows, "Errors of held-out rollouts over the path length.")


def _figures(folder: RunFolder, index: int, units: dict[str, str]) -> list[Image]:
    """Rollouts one by one, their error over time, and the speed by frequency."""
    arrays = folder.read_arrays(f"track-{index}.npz")
    images = [_rollouts(folder, index, arrays, units)] if "start/0" in arrays else []
    if len(arrays["growth/lengths"]) > 1:
        images.append(_growth(folder, index, arrays, units))
    if "law/places" in arrays:
        images.append(_law(folder, index, arrays, units))
    return images + _overlay(folder, index, arrays)


def _rollouts(
    folder: RunFolder,
    index: int,
    arrays: dict[str, np.ndarray],
    units: dict[str, str],
) -> Image:
    seen, paths, sds, starts = (
        _rollout_arrays(arrays, name)
        for name in ("observed", "predicted", "sd", "start")
    )
    figure = new_figure(4.6, 2.1 * -(-len(seen) // 3) + 0.7)
    titles = [f"from {float(start):.0f} {units['t']}" for start in starts]
    panels = list(zip(seen, paths, sds, strict=True))
    plane = {"x": units["x"], "y": units["x"]}
    single_rollouts(panels, titles, units=plane, figure=figure)
    files = save_figure(figure, folder.path / "figures", f"track-{index}")
    caption = (
        f"Held-out part: {len(seen)} rollouts of 10 s, evenly spread over it, each "
        "from an observed position (○) that is put at the origin. × is where the robot "
        "was 10 s later, the ellipse where the model expects 90 % of each coordinate."
    )
    return Image(files.svg, "Observed and predicted paths, one by one", caption)


def _growth(
    folder: RunFolder,
    index: int,
    arrays: dict[str, np.ndarray],
    units: dict[str, str],
) -> Image:
    names = ("lengths", "errors", "reference", "promised")
    curves = [arrays[f"growth/{name}"] for name in names]
    figure = new_figure(4.2, 3.4)
    error_growth(*curves, units=units, ax=figure.subplots())
    files = save_figure(figure, folder.path / "figures", f"growth-{index}")
    caption = (
        "Held-out part: end-point error of rollouts over their length, median and the "
        "middle 80 %, with the median of least squares. Dotted: the distance within "
        "which the model's own bands expect 90 % of the ends; it should run along the "
        "upper edge."
    )
    return Image(files.svg, "End-point error over the length of rollouts", caption)


def _law(
    folder: RunFolder,
    index: int,
    arrays: dict[str, np.ndarray],
    units: dict[str, str],
) -> Image:
    curve = (arrays["law/places"], arrays["law/fitted"], arrays["law/sd"])
    figure = new_figure(4.2, 3.4)
    unit = f"{units['x']}/{units['t']}"
    points = arrays["law/frequency"], arrays["law/speed"]
    speed_law(*points, curve, unit=unit, ax=figure.subplots())
    files = save_figure(figure, folder.path / "figures", f"speed-{index}")
    caption = "Speed along the command over blocks of the whole track, by frequency."
    return Image(files.svg, "Speed along the command against frequency", caption)


def _overlay(
    folder: RunFolder, index: int, arrays: dict[str, np.ndarray]
) -> list[Image]:
    """The same rollouts as they lie on the recorded image, where there was one."""
    if "image whole/0" not in arrays:
        return []
    names = ("whole", "predicted", "observed", "sd")
    whole, paths, seen, sds = (
        _rollout_arrays(arrays, f"image {name}") for name in names
    )
    figure = new_figure(4.2, 3.6)
    ends = [path[-1] for path in seen]
    ax = figure.subplots()
    rollout_paths(whole, paths, ends, sds, units={"x": "px", "y": "px"}, ax=ax)
    ax.invert_yaxis()
    files = save_figure(figure, folder.path / "figures", f"image-{index}")
    caption = "The same in the pixels of the image, y down: to lay over a frame."
    return [Image(files.svg, "Paths of a track in image coordinates", caption)]


def _rollout_arrays(arrays: dict[str, np.ndarray], name: str) -> list[np.ndarray]:
    """The arrays `name/0`, `name/1` and so on, in this order."""
    keys = [key for key in arrays if key.startswith(f"{name}/")]
    return [arrays[key] for key in sorted(keys, key=_trailing_number)]


def _trailing_number(key: str) -> int:
    return int(key.rpartition("/")[2])
