"""Figures and sections of `pinav heat`."""

from typing import Any

import msgspec
import numpy as np

from pinav.commands.heat.metrics import (
    HeatMetrics,
    LearnMetrics,
    OptimumMetrics,
    RunMetrics,
)
from pinav.commands.heat.tables import constraint_table, fit_table, run_table
from pinav.commands.heat.task import RESULTS
from pinav.figures.heat import (
    DOSES,
    ISOTHERMS,
    dose_profile,
    perfusion_figure,
    plane_map,
    probe_curves,
    profiles,
    protocol_figure,
)
from pinav.figures.style import new_figure
from pinav.report import Image, Paragraph, Section
from pinav.report.images import Figures
from pinav.runs import RunFolder

Arrays = dict[str, np.ndarray]

NUM_PROFILES = 7
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
        sections.insert(1, Section("Constraints", [constraint_table(metrics)]))
    if "probes" in arrays:
        curves = probe_curves(
            arrays["times"], arrays["probes"], _names(arrays["probes"].shape[1])
        )
        image = _image(folder, curves.figure, "probes", "Temperature of each probe.")
        sections.append(Section("Probes", [image]))
    return sections


def _learned_sections(
    folder: RunFolder, metrics: LearnMetrics, arrays: Arrays
) -> list[Section]:
    laws: dict[str, Arrays] = {}
    for key, values in arrays.items():
        if key.startswith("law/"):
            _, name, field = key.split("/")
            laws.setdefault(name, {})[field] = values
    curves = probe_curves(
        arrays["data_times"],
        arrays["predicted"],
        [_place(point) for point in arrays["points"]],
        readings=(arrays["data_times"], arrays["data_values"]),
    )
    perfusion = _image(
        folder,
        perfusion_figure(laws),
        "perfusion",
        "Perfusion over temperature with its 95 % band. Dotted: temperatures that the "
        "tissue did not reach, where the law is extrapolated. Near the arterial "
        "temperature the data do not determine perfusion.",
    )
    probes = _image(folder, curves.figure, "probes", "Readings and the fitted model.")
    return [
        Section("The fit", [Paragraph(CAUTION), fit_table(metrics)]),
        Section("Learned perfusion", [perfusion]),
        Section("Probes", [probes]),
    ]


def _protocol(folder: RunFolder, arrays: Arrays, bound: float | None) -> Image:
    figure = protocol_figure(
        arrays["edges"].tolist(),
        arrays["starts"],
        arrays["ends"],
        (arrays["times"], arrays["hottest"]),
        bound=bound,
    )
    caption = "Peak amplitude of the field, and the hottest cell."
    return _image(folder, figure, "protocol", caption)


def _fields(folder: RunFolder, arrays: Arrays) -> Image:
    temperature, dose = arrays["temperature"], arrays["dose"]
    figure = new_figure(7.5, 3.4)
    left, right = figure.subplots(1, 2)
    if temperature.ndim == 1:
        edge = _edge(arrays)
        steps = np.linspace(0, len(arrays["times"]) - 1, NUM_PROFILES + 1).astype(int)
        times = arrays["times"].tolist()
        lines = {_minutes(times[i]): arrays["field"][i] for i in steps[1:]}
        profiles(arrays["radius"], lines, edge=edge, ax=left)
        dose_profile(arrays["radius"], dose, edge=edge, ax=right)
        caption = "Temperature over the radius, and dose; the tumour's edge is dashed."
        return _image(folder, figure, "fields", caption)
    where = "in the plane"
    if temperature.ndim == 3:
        # the section through the largest dose: the middle one may miss the tumour
        section = int(np.unravel_index(np.argmax(dose), dose.shape)[2])
        height = 1e3 * arrays["spacing"][2] * (section + 0.5)
        where = f"in the section z = {height:.3g} mm, that of the largest dose"
        temperature, dose = temperature[..., section], dose[..., section]
    spacing = tuple(arrays["spacing"][:2].tolist())
    plane_map(temperature, spacing, levels=ISOTHERMS, label="temperature [°C]", ax=left)
    plane_map(
        dose, spacing, levels=DOSES, label="CEM43 [min]", logarithmic=True, ax=right
    )
    return _image(
        folder, figure, "fields", f"Temperature at the end, and dose, {where}."
    )


def _minutes(seconds: float) -> str:
    """A time for a legend, with enough digits to tell the profiles apart."""
    return f"{seconds / 60:.3g} min"


def _edge(arrays: Arrays) -> float:
    """Radius of the tumour, where the volume fraction passes one half."""
    inside = arrays["radius"][arrays["target"] > 0.5]
    step = float(np.diff(arrays["radius"])[0])
    return float(inside.max() + step / 2) if inside.size else 0.0


def _names(count: int) -> list[str]:
    return [f"probe {index + 1}" for index in range(count)]


def _place(point: np.ndarray) -> str:
    return ", ".join(f"{1e3 * value:g}" for value in point) + " mm"


def _image(folder: RunFolder, figure: Any, name: str, caption: str) -> Image:
    return Figures(folder.path).image(f"heat-{name}", figure, caption, alt=caption)
