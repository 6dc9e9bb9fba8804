"""Figures and sections of `pinav heat`."""

from typing import Any

import numpy as np

from pinav.commands.heat.job import RESULTS
from pinav.commands.heat.tables import constraint_table, fit_table, outcome_table
from pinav.figures import save_figure
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
from pinav.runs import RunFolder

NUM_PROFILES = 7
"""Times at which temperature is drawn over the radius."""

CAUTION = (
    "Research code. The tissue, its readings and its perfusion are synthetic; nothing "
    "here is medical advice or treatment planning."
)


def heat_sections(folder: RunFolder) -> list[Section]:
    """The sections of a finished task."""
    metrics, arrays = folder.read_json("metrics.json"), folder.read_arrays(RESULTS)
    if metrics["task"] == "learn":
        return _learned(folder, metrics, arrays)
    doubts = [Paragraph(f"Doubtful: {line}.") for line in metrics["doubts"]]
    sections = [
        Section("Outcome", [Paragraph(CAUTION), outcome_table(metrics), *doubts]),
        Section("Field", [_protocol(folder, metrics, arrays)]),
        Section("Temperature and dose", [_fields(folder, arrays)]),
    ]
    if metrics["task"] == "optimise":
        sections.insert(1, Section("Constraints", [constraint_table(metrics)]))
    if "probes" in arrays:
        curves = probe_curves(
            arrays["times"], arrays["probes"], _names(arrays["probes"].shape[1])
        )
        image = _saved(folder, curves.figure, "probes", "Temperature of each probe.")
        sections.append(Section("Probes", [image]))
    return sections


def _learned(folder, metrics, arrays) -> list[Section]:
    laws: dict[str, Any] = {}
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
    return [
        Section("The fit", [Paragraph(CAUTION), fit_table(metrics)]),
        Section(
            "Learned perfusion",
            [
                _saved(
                    folder,
                    perfusion_figure(laws),
                    "perfusion",
                    "Perfusion over temperature with its 95 % band. Dotted: the "
                    "tissue was not that warm, and the law is an extrapolation. Near "
                    "the arterial temperature no data can tell it.",
                )
            ],
        ),
        Section(
            "Probes",
            [_saved(folder, curves.figure, "probes", "Readings and the fitted model.")],
        ),
    ]


def _protocol(folder, metrics, arrays) -> Image:
    figure = protocol_figure(
        arrays["edges"].tolist(),
        arrays["starts"],
        arrays["ends"],
        (arrays["times"], arrays["hottest"]),
        bound=metrics.get("max_temperature"),
    )
    caption = "Peak amplitude of the field, and the hottest cell."
    return _saved(folder, figure, "protocol", caption)


def _fields(folder, arrays) -> Image:
    temperature, dose = arrays["temperature"], arrays["dose"]
    figure = new_figure(7.5, 3.4)
    left, right = figure.subplots(1, 2)
    if temperature.ndim == 1:
        edge = _edge(arrays)
        picked = np.linspace(0, len(arrays["times"]) - 1, NUM_PROFILES + 1).astype(int)
        lines = {
            f"{arrays['times'][i] / 60:.0f} min": arrays["field"][i] for i in picked[1:]
        }
        profiles(arrays["radius"], lines, edge=edge, ax=left)
        dose_profile(arrays["radius"], dose, edge=edge, ax=right)
        caption = "Temperature over the radius, and dose; the tumour's edge is dashed."
        return _saved(folder, figure, "fields", caption)
    if temperature.ndim == 3:
        middle = temperature.shape[2] // 2
        temperature, dose = temperature[..., middle], dose[..., middle]
    spacing = tuple(arrays["spacing"][:2].tolist())
    plane_map(temperature, spacing, levels=ISOTHERMS, label="temperature [°C]", ax=left)
    plane_map(
        dose, spacing, levels=DOSES, label="CEM43 [min]", logarithmic=True, ax=right
    )
    caption = "Temperature at the end, and dose, in the plane or its middle section."
    return _saved(folder, figure, "fields", caption)


def _edge(arrays) -> float:
    """Radius of the tumour, where the share of the cells passes one half."""
    inside = arrays["radius"][arrays["target"] > 0.5]
    step = float(np.diff(arrays["radius"])[0])
    return float(inside.max() + step / 2) if inside.size else 0.0


def _names(count: int) -> list[str]:
    return [f"probe {index + 1}" for index in range(count)]


def _place(point) -> str:
    return ", ".join(f"{1e3 * value:g}" for value in point) + " mm"


def _saved(folder, figure, name: str, caption: str) -> Image:
    files = save_figure(figure, folder.path / "figures", f"heat-{name}")
    return Image(files.svg, caption, caption)
