"""Figures and sections of `pinav fit RECORDING`."""

from typing import Any

import numpy as np

from pinav.commands.identify.job import label
from pinav.figures import save_figure
from pinav.figures.identification import horizon_errors, rollout_paths, speed_law
from pinav.figures.style import new_figure
from pinav.fitting import Estimate
from pinav.identification import interval, positive_interval
from pinav.identification.forecast import HORIZONS
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
    "Gaussian-process disturbance",
    "neural ODE",
)
"""Lines of the figure of errors by horizon."""


def identification_sections(folder: RunFolder) -> list[Section]:
    """The sections of a recording's report."""
    metrics = folder.read_json("metrics.json")
    sections = [Section("The selection of models", _overview(folder, metrics))]
    for index, (name, result) in enumerate(metrics["tracks"].items()):
        if "reason" in result:
            text = [Paragraph(f"Not fitted: {result['reason']}")]
            sections.append(Section(f"Track {name}", text))
        elif folder.has(f"track-{index}.npz"):
            content = _track(folder, index, result, metrics["units"])
            sections.append(Section(f"Track {name}", content))
    return sections


def _overview(folder, metrics) -> list[Paragraph | Table | Image]:
    unit = metrics["units"]["x"]
    header = (
        "model",
        "tracks",
        "log evidence",
        "velocity R²",
        *(f"{h:g} s" for h in HORIZONS),
        f"10 s ({unit})",
        "fit (s)",
    )
    keys = ("tracks", "log_evidence", "velocity_r2")
    keys += (*(f"relative {h:g}" for h in HORIZONS), "median 10", "seconds")
    rows = [
        (name, *("–" if row[key] is None else row[key] for key in keys))
        for name, row in metrics["summary"].items()
    ]
    relative = {
        name: [_number(metrics["summary"][name][f"relative {h:g}"]) for h in HORIZONS]
        for name in DRAWN
        if name in metrics["summary"]
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
    ]


def _number(value) -> float:
    return float("nan") if value is None else float(value)


def _track(folder, index, result, units) -> list[Paragraph | Table | Image]:
    content: list[Paragraph | Table | Image] = [
        Paragraph(sentence) for sentence in result["verdict"]
    ]
    covered = result["coverage"]
    if covered["rollouts"]:
        content.append(
            Paragraph(
                f"Nominal bands of 90 % hold {100 * covered['inside']:.1f} % of the "
                f"held-out positions, {100 * covered['at end']:.1f} % at the end of "
                f"{covered['rollouts']} rollouts of 10 s."
            )
        )
    return [
        *content,
        _estimates(result),
        _rows(result),
        *_figures(folder, index, units),
    ]


POSITIVE = (
    "corner",
    "lag",
    "still",
    "driven",
    "memory",
    "noise",
    "slow",
    "slow memory",
)
"""Quantities whose logarithm was fitted."""


def _estimates(result) -> Table:
    rows = []
    for name, pair in result["estimates"].items():
        estimate = Estimate(pair["value"], pair["sd"])
        between = positive_interval if name in POSITIVE else interval
        rows.append((name, estimate.value, *between(estimate)))
    note = (
        "The chosen candidate on the whole track, with intervals of 95 %. "
        "Angles in rad, times in s, frequencies in Hz."
    )
    return Table(("quantity", "value", "from", "to"), rows, note)


def _rows(result) -> Table:
    rows: list[tuple[Any, ...]] = []
    for row in result["rows"]:
        name = label(row["name"]) + (
            " (chosen)" if row["name"] == result["chosen"] else ""
        )
        if row["reason"]:
            rows.append((name, row["reason"], *("–",) * (len(HORIZONS) + 1)))
            continue
        evidence = "–" if row["log_evidence"] is None else row["log_evidence"]
        found = [row["horizons"][f"{h:g}"]["relative"] for h in HORIZONS]
        cells = ["–" if value is None else value for value in found]
        rows.append((name, evidence, row["velocity_r2"], *cells))
    header = ("model", "log evidence", "velocity R²", *(f"{h:g} s" for h in HORIZONS))
    return Table(header, rows, "Errors of held-out rollouts over the path length.")


def _figures(folder, index, units) -> list[Image]:
    arrays = folder.read_arrays(f"track-{index}.npz")
    law = "law/places" in arrays
    figure = new_figure(7.5 if law else 4.2, 3.6)
    axes = figure.subplots(1, 2) if law else [figure.subplots()]
    _paths(arrays, "", units["x"], axes[0])
    caption = (
        "Held-out part: observed positions, rollouts of 10 s, bands at their ends."
    )
    if law:
        curve = (arrays["law/places"], arrays["law/fitted"], arrays["law/sd"])
        unit = f"{units['x']}/{units['t']}"
        speed_law(
            arrays["law/frequency"], arrays["law/speed"], curve, unit=unit, ax=axes[1]
        )
        caption += " Right: speed along the command, over blocks."
    files = save_figure(figure, folder.path / "figures", f"track-{index}")
    images = [Image(files.svg, "Observed and predicted paths of a track", caption)]
    return images + _overlay(folder, index, arrays)


def _overlay(folder, index, arrays) -> list[Image]:
    """The same paths as they lie on the recorded image, where there was one."""
    if not any(key.startswith("image ") for key in arrays):
        return []
    figure = new_figure(4.2, 3.6)
    ax = figure.subplots()
    _paths(arrays, "image ", "px", ax)
    ax.invert_yaxis()
    files = save_figure(figure, folder.path / "figures", f"image-{index}")
    caption = "The same in the pixels of the image, y down: to lay over a frame."
    return [Image(files.svg, "Paths of a track in image coordinates", caption)]


def _paths(arrays, prefix: str, unit: str, ax) -> None:
    def group(name: str) -> list[np.ndarray]:
        found = [key for key in arrays if key.startswith(f"{prefix}{name}/")]
        return [arrays[key] for key in sorted(found, key=_trailing_number)]

    groups = (group(name) for name in ("observed", "predicted", "sd"))
    rollout_paths(*groups, units={"x": unit, "y": unit}, ax=ax)


def _trailing_number(key: str) -> int:
    return int(key.rpartition("/")[2])
