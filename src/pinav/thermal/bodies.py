"""The body of a case: a ball in tissue, or voxels by their labels, and maps of both.

Everything that a file may have wrong is refused here, before a folder is made: its
shape, its place, its unit, labels without a tissue, and numbers that no tissue has.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool
from scipy.ndimage import center_of_mass

from pinav.errors import InputError
from pinav.thermal import quantities
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.case import Case, FromFile
from pinav.thermal.case_geometry import Box, Meshed, Voxels
from pinav.thermal.case_matter import (
    LARGEST_LABEL,
    PROPERTIES,
    Absorption,
    Heating,
    Medium,
)
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.images import NEGLIGIBLE, Image, check_place, read_image
from pinav.thermal.perfusion import (
    AbstractPerfusion,
    ConstantPerfusion,
    RegionalPerfusion,
    mass_perfusion,
    perfusion_factor,
)
from pinav.thermal.tissues import Blood, Tissue, mix

KINDS = {
    "conductivity": quantities.Conductivity,
    "density": quantities.Density,
    "specific_heat": quantities.SpecificHeat,
    "metabolic": quantities.Metabolic,
    "perfusion": quantities.Magnitude,
    "concentration": quantities.Concentration,
    "absorption": quantities.PowerDensity,
}
"""Numbers that a map may hold, of the same ranges as those of a table."""


class Body(eqx.Module):
    """The tissues of a case, and where its target is.

    Attributes:
        fractions: volume fraction of each tissue in each cell, in the order of the laws
            of perfusion.
        target: volume fraction of the target in each cell.
        middle: middle of the target [m]; none on grids whose target is in the middle.
        radius: radius of a target that is a ball [m].
        image: labels, where the cells are voxels.
    """

    fractions: dict[str, quantities.Field]
    target: quantities.Field
    middle: tuple[float, ...] | None = None
    radius: float | None = None
    image: Image | None = None

    def law(self, name: str) -> Callable[[Any], Any]:
        """What picks the perfusion of a tissue from a model."""
        index = list(self.fractions).index(name)
        return lambda model: model.perfusion.laws[index]


def build_body(case: Case, folder: Path) -> tuple[Bioheat, Body]:
    """The tissues and target of a case, and the model of them without sources."""
    if isinstance(case.grid, Voxels):
        return _voxel_body(case, case.grid, folder)
    return _ball_body(case, case.grid)


def _ball_body(case: Case, grid: Meshed) -> tuple[Bioheat, Body]:
    cells, blood, (medium, tumour) = grid.build(), case.blood, case.ball
    target = cells.ball(tumour.radius, center=tumour.center)
    fractions = {"tumour": target, "tissue": 1 - target}
    media = tumour.tissue, medium
    shares, tissues = tuple(fractions.values()), [one.properties() for one in media]
    laws = [one.perfusion.law(blood, t) for one, t in zip(media, tissues, strict=True)]
    perfusion = RegionalPerfusion.on_masks(shares, tuple(laws))
    model = _join(case, cells, tissues, perfusion)
    return model, Body(fractions, target, tumour.center, tumour.radius)


def _voxel_body(case: Case, grid: Voxels, folder: Path) -> tuple[Bioheat, Body]:
    image = read_image(folder / grid.labels)
    box = _box(grid, image)
    if image.spacing is None:
        image = Image(image.path, image.values, box.sizes)
    cells = box.build()
    try:
        case.check_extent(cells)
    except ValueError as error:
        raise InputError(f"{image.path}: {error}") from error
    masks, files = _masks(case, image), _Files(folder, image)
    media = [(medium, masks[name]) for name, medium in case.tissues.items()]
    tissues = [_properties(medium, mask, files) for medium, mask in media]
    laws = [
        _law(medium, case.blood, tissue, mask, files)
        for (medium, mask), tissue in zip(media, tissues, strict=True)
    ]
    target = _target(case, masks, files)
    fractions = {name: jnp.asarray(masks[name], float) for name in case.tissues}
    perfusion = RegionalPerfusion(tuple(fractions.values()), tuple(laws))
    model = _join(case, cells, tissues, perfusion)
    places = zip(center_of_mass(target), box.sizes, strict=True)
    middle = tuple(float((place + 0.5) * size) for place, size in places)
    return model, Body(fractions, jnp.asarray(target), middle, image=image)


def _join(
    case: Case,
    grid: AbstractGrid,
    tissues: Sequence[Tissue],
    perfusion: RegionalPerfusion,
) -> Bioheat:
    tissue = mix(perfusion.fractions, tissues)
    sides = case.boundaries(len(grid.shape))
    return Bioheat(grid, tissue, case.blood, perfusion, (), sides)


def read_heating(heating: Heating, path: Path, body: Body) -> np.ndarray:
    """SAR [W/kg] or concentration [kg/m³] of each voxel."""
    assert body.image is not None
    kind = "absorption" if isinstance(heating, Absorption) else "concentration"
    everywhere = np.ones(body.target.shape, bool)
    values = _Files(path.parent, body.image).read(path.name, kind, everywhere)
    if not values.max() > 0:
        raise InputError(
            f"{path}: expected a voxel > 0, got zeros alone; save numbers with "
            "decimals, or set field.amplitudes to 0 for a run without heat"
        )
    return values


class _Files:
    """Maps in a folder, each read once."""

    def __init__(self, folder: Path, labels: Image) -> None:
        self.folder, self.labels = folder, labels
        self.images: dict[str, Image] = {}

    def read(self, name: str, kind: str, mask: Bool[np.ndarray, "..."]) -> np.ndarray:
        """The numbers of a map, checked where a mask is, and 0 elsewhere."""
        if name not in self.images:
            image = read_image(self.folder / name)
            check_place(image, self.labels)
            if image.values.ndim != self.labels.values.ndim:
                raise InputError(
                    f"{image.path}: expected one value for each voxel, got frames; "
                    "take one of them"
                )
            self.images[name] = image
        values = np.where(mask, self.images[name].values, 0.0)
        self._check_range(name, kind, values, mask)
        return values

    def _check_range(
        self, name: str, kind: str, values: np.ndarray, mask: Bool[np.ndarray, "..."]
    ) -> None:
        path = self.folder / name
        finite = np.isfinite(values)
        if not finite.all():
            raise InputError(
                f"{path}: expected finite numbers, got {(~finite).sum()} voxels "
                "without one; fill them, or give them another label"
            )
        inside = values[mask]
        for extreme in (inside.min(), inside.max()) if inside.size else ():
            try:
                quantities.within(kind, KINDS[kind], float(extreme))
            except ValueError as error:
                words = str(error).removeprefix(f"{kind}: ")
                raise InputError(f"{path}: {words}") from error


def _box(grid: Voxels, image: Image) -> Box:
    path, shape = image.path, image.values.shape
    if image.values.ndim not in (2, 3) or min(shape) < 3:
        raise InputError(
            f"{path}: expected labels along two or three axes with three voxels or "
            f"more, got shape {shape}"
        )
    if grid.size is not None and len(grid.size) != len(shape):
        raise InputError(
            f"grid.size: expected {len(shape)} numbers, one for each axis of "
            f"{path.name}, got {len(grid.size)}"
        )
    sizes = image.spacing or grid.size
    if sizes is None:
        raise InputError(
            f"{path}: expected voxels with a unit, mm or m, or grid.size in the case, "
            "got neither; give grid.size in metres"
        )
    given = grid.size or sizes
    if np.abs(np.array(given) / np.array(sizes) - 1).max() > NEGLIGIBLE:
        raise InputError(
            f"grid.size: expected that of {path.name}, {list(sizes)} m, got "
            f"{list(given)} m; leave it out, or correct the unit of the file"
        )
    return Box(shape, tuple(sizes))


def _masks(case: Case, image: Image) -> dict[str, Bool[np.ndarray, "..."]]:
    values, path = image.values, image.path
    whole = np.isfinite(values) & (values == np.round(values))
    if not np.all(whole & (np.abs(values) <= LARGEST_LABEL)):
        raise InputError(
            f"{path}: expected labels, whole numbers up to {LARGEST_LABEL}, got "
            "others; save integers"
        )
    known = {medium.label: name for name, medium in case.tissues.items()}
    labels, counts = np.unique(values.astype(int), return_counts=True)
    for label, count in zip(labels.tolist(), counts.tolist(), strict=True):
        if label not in known:
            raise InputError(
                f"{path}: expected labels of tissues, {', '.join(map(str, known))}; "
                f"got {label} in {count} voxels; add a table of tissues with it"
            )
    for label, name in known.items():
        if label not in labels:
            raise InputError(
                f"tissues.{name}: expected a label that {path.name} has, "
                f"{labels.tolist()}, got {label}; correct or remove it"
            )
    return {known[label]: values == label for label in known}


def _properties(medium: Medium, mask: Bool[np.ndarray, "..."], files: _Files) -> Tissue:
    """Properties of a tissue; outside it those of its mean, which nothing takes."""
    maps = {}
    for name in PROPERTIES:
        value = getattr(medium, name)
        if isinstance(value, str):
            values = files.read(value, name, mask)
            maps[name] = np.where(mask, values, values[mask].mean())
    return medium.properties(maps)


def _law(
    medium: Medium,
    blood: Blood,
    tissue: Tissue,
    mask: Bool[np.ndarray, "..."],
    files: _Files,
) -> AbstractPerfusion:
    flow = medium.perfusion
    if flow.file is None:
        return flow.law(blood, tissue)
    assert flow.unit is not None
    values = files.read(flow.file, "perfusion", mask)
    # a unit is judged by the mean: single voxels of a map may have almost no blood
    typical = Tissue(1.0, float(np.mean(tissue.density)), 1.0)
    mass_perfusion(
        float(values[mask].mean()), unit=flow.unit, blood=blood, tissue=typical
    )
    factor = perfusion_factor(flow.unit, blood=blood, tissue=tissue)
    return ConstantPerfusion(jnp.asarray(values * factor))


def _target(
    case: Case, masks: dict[str, Bool[np.ndarray, "..."]], files: _Files
) -> np.ndarray:
    """Share of each voxel that the target has."""
    if not isinstance(case.target, FromFile):
        return np.any([masks[name] for name in case.target or ()], axis=0).astype(float)
    image = read_image(files.folder / case.target.file)
    check_place(image, files.labels)
    fraction = image.values
    if fraction.shape != files.labels.values.shape or not np.all(
        (fraction >= 0) & (fraction <= 1)
    ):
        raise InputError(
            f"{image.path}: expected the share of the target in each voxel, 0 to 1, "
            "got other numbers, or frames"
        )
    if not np.any(fraction > 0.5):
        raise InputError(
            f"{image.path}: expected a target, got no voxel with half of one or more"
        )
    return fraction
