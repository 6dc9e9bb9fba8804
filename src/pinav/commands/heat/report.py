"""Figures and sections of `pinav heat`."""

from typing import Any

import msgspec
import numpy as np

from pinav.commands.heat.fitting import FOLLOWED
from pinav.commands.heat.history import SHARES
from pinav.commands.heat.metrics import (
    HeatMetrics,
    LearnMetrics,
    OptimumMetrics,
    RunMetrics,
)
from pinav.commands.heat.tables import (
    constraint_table,
    fit_table,
    judgement_table,
    run_table,
)
from pinav.commands.heat.task import RESULTS
from pinav.figures.heat import (
    DOSES,
    ISOTHERMS,
    dose_profile,
    forecast_figure,
    perfusion_figure,
    plane_map,
    probe_curves,
    profiles,
    protocol_figure,
)
from pinav.figures.images import Figures
from pinav.figures.style import SMALL, new_figure, title_panel
from pinav.report import Image, Paragraph, Section
from pinav.runs import RunFolder

Arrays = dict[str, np.ndarray]

NUM_PROFILES = 6
"""Times at which temperature is drawn over the radius."""

CAUTION = (
    "Research code. The tissue, its readings and its perfusion are synthetic; nothing "
    "here is medical advice or treatment planning."
)


def heat_sections(folder: RunFolder) -> list[Section]:
    """The sections of a finished task."""
    metrics = msgspec.convert(folder.read_json("metrics.json"), HeatMetrics)
    arrays = folder.read_arrays(RESULTS)
    if isinstance(metrics, LearnMetrics):
        return _learned_sections(folder, metrics, arrays)
    run = metrics if isinstance(metrics, RunMetrics) else metrics.result
    warnings = [Paragraph(f"Warning: {line}.") for line in run.warnings]
    bound = None if isinstance(metrics, RunMetrics) else metrics.max_temperature
    sections = [
        Section("Result", [Paragraph(CAUTION), run_table(run), *warnings]),
        Section("Field", [_protocol(folder, arrays, bound)]),
        Section("Temperature and dose", [_fields(folder, arrays)]),
    ]
    if isinstance(metrics, OptimumMetrics):
        tables = [constraint_table(metrics)]
        if metrics.judged is not None:
            tables.append(judgement_table(metrics.judged))
        sections.insert(1, Section("Constraints", tables))
    if "probes" in arrays:
        curves = probe_curves(
            arrays["times"],
            arrays["probes"],
            [_place(point) for point in arrays["points"]],
        )
        image = _image(folder, curves.figure, "probes", "Temperature of each probe.")
        sections.append(Section("Probes", [image]))
    return sections


def _learned_sections(
    folder: RunFolder, metrics: LearnMetrics, arrays: Arrays
) -> list[Section]:
    sections = [Section("The fit", [Paragraph(CAUTION), fit_table(metrics)])]
    if laws := _laws(arrays):
        perfusion = _image(
            folder,
            perfusion_figure(laws),
            "perfusion",
            "Perfusion over temperature with its 95 % band. Dotted: temperatures that "
            "the tissue did not reach, where the law is extrapolated. Near the "
            "arterial temperature the data do not determine perfusion.",
        )
        sections.append(Section("Learned perfusion", [perfusion]))
    if "predicted" in arrays:
        sections.append(Section("Probes", [_fitted_probes(folder, arrays)]))
    else:
        sections.append(Section("Frames", _fitted_frames(folder, arrays)))
    if "forecast/values" in arrays:
        sections.append(Section("Prediction", [_prediction(folder, arrays)]))
    return sections


def _laws(arrays: Arrays) -> dict[str, Arrays]:
    """Learned laws by tissue."""
    laws: dict[str, Arrays] = {}
    for key, values in arrays.items():
        if key.startswith("law/"):
            _, name, field = key.split("/")
            laws.setdefault(name, {})[field] = values
    return laws


def _fitted_probes(folder: RunFolder, arrays: Arrays) -> Image:
    curves = probe_curves(
        arrays["data_times"],
        arrays["predicted"],
        [_place(point) for point in arrays["points"]],
        readings=(arrays["data_times"], arrays["data_values"]),
    )
    return _image(folder, curves.figure, "probes", "Readings and the fitted model.")


def _fitted_frames(folder: RunFolder, arrays: Arrays) -> list[Image]:
    """Means of each tissue over time, and the last frame beside the fit."""
    names = [
        key.split("/")[1]
        for key in arrays
        if key.startswith("mean/") and key.endswith("/fit")
    ]
    times = arrays["data_times"]
    curves = probe_curves(
        times,
        np.stack([arrays[f"mean/{name}/fit"] for name in names], axis=1),
        names,
        readings=(
            times,
            np.stack([arrays[f"mean/{name}/reading"] for name in names], axis=1),
        ),
    )
    caption = (
        "Mean temperature of the voxels of each tissue that are read: dots are the "
        "readings without turns of the phase and drift, lines the fit."
    )
    means = _image(folder, curves.figure, "means", caption)
    return [means, _last_frame(folder, arrays)]


def _last_frame(folder: RunFolder, arrays: Arrays) -> Image:
    name, cut = next(iter(_sections(arrays, arrays["frame/fit"]).items()))
    reading, fit = arrays["frame/reading"][cut], arrays["frame/fit"][cut]
    figure = new_figure(7.5, 2.5)
    panels = figure.subplots(1, 3)
    spacing = float(arrays["spacing"][0]), float(arrays["spacing"][1])
    shared = float(np.nanmin(fit)) - 1.0, float(np.nanmax(fit)) + 1.0
    widest = float(np.nanmax(np.abs(reading - fit)))
    shown: tuple[tuple[np.ndarray, tuple[float, ...], str, tuple[float, float]], ...]
    shown = (
        (reading, (), "reading [°C]", shared),  # noise has no contours
        (fit, ISOTHERMS, "fit [°C]", shared),
        (reading - fit, (), "difference [K]", (-widest, widest)),
    )
    for ax, (values, levels, label, limits) in zip(panels, shown, strict=True):
        plane_map(
            values,
            spacing,
            levels=levels,
            label=label,
            outline=arrays["target"][cut],
            limits=limits,
            ax=ax,
        )
    for ax in panels[1:]:
        ax.set_ylabel("")
    title_panel(panels[0], name.replace(", ", ",\n"))  # else into the next panel
    caption = (
        f"The frame at {_duration(float(arrays['data_times'][-1]))}, the last that was "
        "fitted, without turns of the phase and drift, and the fit in the same "
        "colours; reading less fit; white where no voxel is read; the tumour is "
        "outlined in blue."
    )
    return _image(folder, figure, "frame", caption)


def _prediction(folder: RunFolder, arrays: Arrays) -> Image:
    figure = forecast_figure(
        arrays["forecast/times"],
        dict(zip(FOLLOWED, arrays["forecast/values"].T, strict=True)),
        dict(zip(FOLLOWED, arrays["forecast/sd"].T, strict=True)),
        true=arrays["forecast/true"].T if "forecast/true" in arrays else None,
        fitted_until=float(arrays["forecast/from"][0]),
    )
    caption = (
        "Temperatures of the target, fitted up to the dashed line, predicted after it, "
        "and their 95 % bands on a scale of their own; with the truth where it is "
        "known: black above, less the prediction below."
    )
    return _image(folder, figure, "forecast", caption)


def _protocol(folder: RunFolder, arrays: Arrays, bound: float | None) -> Image:
    names = {"hottest": "hottest cell", **{name: name for name in SHARES}}
    figure = protocol_figure(
        (arrays["edges"], arrays["starts"], arrays["ends"]),
        arrays["times"],
        {label: arrays[name] for name, label in names.items()},
        {
            "D90 of the tumour": arrays["dose/D90"],
            "largest outside it": arrays["dose/outside"],
        },
        fractions={"V43, of the tumour above 43 °C": arrays["V43"]},
        bound=bound,
    )
    caption = (
        "Peak amplitude of the field; the hottest cell and the temperatures that 10, "
        "50 and 90 % of the tumour exceed; the fraction of it above 43 °C; doses so "
        "far."
    )
    return _image(folder, figure, "protocol", caption)


def _fields(folder: RunFolder, arrays: Arrays) -> Image:
    if arrays["temperature"].ndim > 1:
        return _maps(folder, arrays)
    figure = new_figure(7.5, 3.4)
    left, right = figure.subplots(1, 2)
    edge = _edge(arrays)
    last = len(arrays["times"]) - 1
    steps = np.unique(np.linspace(0, last, NUM_PROFILES + 1).astype(int)[1:])
    lines = {_duration(float(arrays["times"][i])): arrays["field"][i] for i in steps}
    profiles(arrays["radius"], lines, edge=edge, ax=left)
    dose_profile(arrays["radius"], arrays["dose"], edge=edge, ax=right)
    caption = "Temperature over the radius, and dose; the tumour's edge is dashed."
    return _image(folder, figure, "fields", caption)


def _maps(folder: RunFolder, arrays: Arrays) -> Image:
    """Sections through the hottest cell and through the middle of the tumour."""
    sections = _sections(arrays, arrays["temperature"])
    figure = new_figure(7.5, 3.2 * len(sections))
    panels = figure.subplots(len(sections), 2, squeeze=False)
    for row, (name, cut) in zip(panels, sections.items(), strict=True):
        outline, spacing = arrays["target"][cut], arrays["spacing"][:2]
        for ax, key, levels, label in (
            (row[0], "temperature", ISOTHERMS, "temperature [°C]"),
            (row[1], "dose", DOSES, "CEM43 [min]"),
        ):
            plane_map(
                arrays[key][cut],
                (float(spacing[0]), float(spacing[1])),
                levels=levels,
                label=label,
                outline=outline,
                logarithmic=key == "dose",
                ax=ax,
            )
        title_panel(row[0], name)
    caption = "Temperature at the end, and dose; the tumour is outlined in blue."
    return _image(folder, figure, "fields", caption)


def _sections(arrays: Arrays, temperature: np.ndarray) -> dict[str, tuple]:
    """Planes of a map by what their titles say."""
    if arrays["target"].ndim == 2:
        return {"": (slice(None), slice(None))}
    height = float(arrays["spacing"][2])
    hottest = np.unravel_index(np.nanargmax(temperature), temperature.shape)
    mass = arrays["target"].sum(axis=(0, 1))
    middle = round(float(mass @ np.arange(mass.size) / mass.sum()))
    cuts: dict[int, list[str]] = {}
    for name, index in (("hottest cell", int(hottest[2])), ("tumour", middle)):
        cuts.setdefault(index, []).append(name)
    return {
        f"z = {1e3 * height * (index + 0.5):.4g} mm, {' and '.join(names)}": (
            slice(None),
            slice(None),
            index,
        )
        for index, names in cuts.items()
    }


def _duration(seconds: float) -> str:
    """A time for a legend, exact to a thousandth of a second."""
    minutes = seconds / 60
    if abs(minutes - round(minutes)) < 1e-9:
        return f"{round(minutes)} min"
    return f"{round(seconds, 3):.10g} s"


def _edge(arrays: Arrays) -> float:
    """Radius of the tumour, where the volume fraction passes one half."""
    inside = arrays["radius"][arrays["target"] > 0.5]
    step = float(np.diff(arrays["radius"])[0])
    return float(inside.max() + step / 2) if inside.size else 0.0


def _place(point: np.ndarray) -> str:
    return ", ".join(f"{1e3 * value:g}" for value in point) + " mm"


def _image(folder: RunFolder, figure: Any, name: str, caption: str) -> Image:
    figure.suptitle(str(folder.config()["case"]["title"]), fontsize=SMALL + 1)
    return Figures(folder.path).image(f"heat-{name}", figure, caption, alt=caption)
