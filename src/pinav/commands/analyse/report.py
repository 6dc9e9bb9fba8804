"""Sections of the report on what `pinav analyse` found, from its saved results."""

from typing import Any

import numpy as np

from pinav.analysis import HelmholtzSplit, LyapunovMap, SobolIndices
from pinav.commands.analyse.job import ANALYSIS_FILE, ARRAYS_FILE
from pinav.evaluation import FieldMap, default_regions
from pinav.figures import (
    constants_figure,
    helmholtz_figure,
    influence_figure,
    lyapunov_figure,
    potential_map,
    save_figure,
    sobol_figure,
    trust_map,
)
from pinav.figures.style import new_figure, title_panel
from pinav.report import Image, Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories, load

Content = list[Paragraph | Image | Table]


def analysis_sections(folder: RunFolder) -> list[Section]:
    """What was learned, and what it depends on; nothing without an analysis."""
    if not folder.has(ANALYSIS_FILE):
        return []
    found = folder.read_json(ANALYSIS_FILE)
    arrays = folder.read_arrays(ARRAYS_FILE)
    data = load(folder.path / "data.npz")
    x, y, force, distance = (arrays[n] for n in ("x", "y", "force", "distance"))
    field = FieldMap(x, y, force, distance, default_regions(data))
    pages = _Pages(folder, found, arrays, data, field)
    sections = [Section("What was learned", pages.learned())]
    if "influence" in arrays:
        sections.append(Section("What the force depends on", pages.influence()))
    sections.append(Section("What a rollout depends on", pages.rollout()))
    if found["left_out"]:
        lines = [Paragraph(line) for line in found["left_out"]]
        sections.append(Section("Left out of the analysis", lines))
    return sections


class _Pages:
    """Figures and tables of one analysis."""

    def __init__(
        self,
        folder: RunFolder,
        found: dict[str, Any],
        arrays: dict[str, np.ndarray],
        data: Trajectories,
        field: FieldMap,
    ):
        self.folder, self.found, self.arrays = folder, found, arrays
        self.data, self.field = data, field
        self.paths = [
            np.where(p.observed[:, :2], p.states[:, :2], np.nan) for p in data
        ]

    def learned(self) -> Content:
        """Parts, potential and trust."""
        parts = self.found["helmholtz"]
        split = HelmholtzSplit(
            **{
                name: self.arrays[f"split/{name}"]
                for name in ("gradient", "rotational", "potential", "stream", "ground")
            },
            rotational_fraction=parts["rotational"],
            least_fraction=parts["least"],
            greatest_fraction=parts["greatest"],
            misfit=parts["misfit"],
        )
        options = {"path": self.joined, "units": self.data.units}
        figure = helmholtz_figure(split, self.field, spread=parts.get("sd"), **options)
        return [
            self._image(
                figure,
                "helmholtz",
                "Gradient part and rotational part of the learned force",
                "Helmholtz split of the learned force, by least squares on the ground "
                f"within {parts['reach']:g} of the data. Fractions are of the squared "
                "force there. Harmonic fields are both; they are shared equally.",
            ),
            Table(
                ("part", "fraction (%)", "least (%)", "greatest (%)", "sd (%)"),
                [_fractions(parts)],
                "Least: harmonic fields all count as gradients, so that this is what "
                "no potential explains. Greatest: they all count as rotational. sd: "
                "over posterior samples.",
            ),
            *self._trust(options),
        ]

    def _trust(self, options) -> list[Image]:
        figure = new_figure(7.5 if "sd" in self.arrays else 3.8, 4.6)
        axes = np.ravel(figure.subplots(1, 2 if "sd" in self.arrays else 1))
        potential_map(self.arrays["potential"], self.field, ax=axes[0], **options)
        title_panel(axes[0], f"(a) potential, {self.found['potential']}")
        caption = "Potential up to a constant."
        if "sd" in self.arrays:
            trust_map(self.field, self.arrays["sd"], ax=axes[1], **options)
            title_panel(axes[1], "(b) signal to noise")
            caption += (
                " Right: size of the force over its standard deviation; within the "
                "marked line it may as well be zero."
            )
        alt = "Potential, and where the force is known"
        return [self._image(figure, "potential", alt, caption)]

    def influence(self) -> Content:
        """Trajectories and constants."""
        units = self.data.units
        figure = influence_figure(
            self.arrays["influence"], self.field, self.paths, units=units
        )
        content: Content = [
            self._image(
                figure,
                "influence",
                "Change of the force where one trajectory is left out",
                "Change of the learned force where the trajectory that is drawn is "
                "left out of the fit, to first order, the hyperparameters held.",
            ),
            self._table("influence", INFLUENCE_CAPTION),
        ]
        slopes = {
            name.removeprefix("constant/"): values
            for name, values in self.arrays.items()
            if name.startswith("constant/")
        }
        if slopes:
            options = {"path": self.joined, "units": units}
            content.append(
                self._image(
                    constants_figure(slopes, self.field, **options),
                    "constants",
                    "Change of the force with known constants",
                    "Change of the learned force where a constant is one percent "
                    "larger and everything else is fitted anew.",
                )
            )
            content.append(self._table("constants", CONSTANTS_CAPTION))
        return content

    def rollout(self) -> Content:
        """Start and global sensitivity."""
        index = self.found["settings"]["reference"]
        names = ("x", "y", "separation", "final")
        stretch = LyapunovMap(
            *(self.arrays[f"lyapunov/{name}"] for name in names),
            horizon=self.found["stretch"]["horizon"],
        )
        units = self.data.units
        content: Content = [
            self._image(
                lyapunov_figure(stretch, path=self.paths[index], units=units),
                "stretch",
                "Stretch of the final position over starts",
                "By how much two rollouts of the model part that start side by side, "
                f"with the velocity of trajectory {index} at its start. Ridges "
                "separate starts with different fates.",
            )
        ]
        if "sobol" in self.found:
            indices = _indices(self.found["sobol"])
            content += [
                self._image(
                    sobol_figure(indices),
                    "sobol",
                    "Sobol' indices of the outcome of a rollout",
                    _sobol_caption(self.found),
                ),
                self._table("sobol", "Sobol' indices with 95 % bootstrap intervals."),
            ]
        return content

    @property
    def joined(self) -> np.ndarray:
        gap = np.full((1, 2), np.nan)
        return np.concatenate([part for own in self.paths for part in (own, gap)])

    def _image(self, figure, name: str, alt: str, caption: str) -> Image:
        place = self.folder.path / "figures"
        return Image(save_figure(figure, place, f"analysis-{name}").svg, alt, caption)

    def _table(self, name: str, caption: str) -> Table:
        rows = self.found[name]
        cells = [
            tuple(
                "–" if v is None else str(v) if isinstance(v, bool) else v
                for v in row.values()
            )
            for row in rows
        ]
        return Table(tuple(key.replace("_", " ") for key in rows[0]), cells, caption)


INFLUENCE_CAPTION = (
    "Each trajectory: leverage, the number of parameters that it determines; Cook's "
    "distance; root-mean-square change of the force near the data without it, relative "
    "to that of the force; change of the final position of the reference rollout."
)
CONSTANTS_CAPTION = (
    "Each constant one percent larger: root-mean-square change of the force near the "
    "data, relative to that of the force, and change of the final position of the "
    "reference rollout."
)


def _fractions(parts: dict[str, Any]) -> tuple:
    values = [100 * parts[name] for name in ("rotational", "least", "greatest")]
    return ("rotational", *values, 100 * parts["sd"] if "sd" in parts else "–")


def _sobol_caption(found: dict[str, Any]) -> str:
    settings = found["settings"]
    landmark = ", ".join(f"{value:.3g}" for value in found["landmark"])
    return (
        f"Rollouts of trajectory {settings['reference']} with strengths varied by "
        f"± {settings['relative']:.0%} and the start by ± {settings['shift']:g}, "
        "uniformly and independently. Displacement is from the nominal final position, "
        "arrival means that it is at most 0.35, and the least distance is to the "
        f"highest point of the potential near the data, ({landmark})."
    )


def _indices(rows: list[dict[str, Any]]) -> SobolIndices:
    outcomes = list(dict.fromkeys(row["outcome"] for row in rows))
    factors = list(dict.fromkeys(row["factor"] for row in rows))
    shape = len(outcomes), len(factors)

    def column(name: str) -> np.ndarray:
        values = [np.nan if row[name] is None else row[name] for row in rows]
        return np.array(values, float).reshape(shape)

    def interval(name: str) -> np.ndarray:
        return np.stack([column(f"{name}_{end}") for end in ("low", "high")], axis=-1)

    return SobolIndices(
        factors=tuple(factors),
        outcomes=tuple(outcomes),
        first=column("first"),
        first_interval=interval("first"),
        total=column("total"),
        total_interval=interval("total"),
        confidence=0.95,
        variance=column("variance")[:, 0],
    )
