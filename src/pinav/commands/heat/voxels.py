"""Cases of voxels: tissues by their labels in an image, and maps of their properties.

Everything that a file may have wrong is refused here, before a folder is made: its
shape, its place, its unit, labels without a tissue, and numbers that no tissue has.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Bool

from pinav.commands.heat.bodies import (
    PROPERTIES,
    Body,
    build_blood,
    build_grid,
    passive_properties,
    perfusion_law,
)
from pinav.commands.heat.bounds import (
    ADVICE,
    Concentration,
    Conductivity,
    Density,
    Magnitude,
    PowerDensity,
    SpecificHeat,
)
from pinav.commands.heat.case import Case, TargetFile
from pinav.commands.heat.geometry import Box, Voxels
from pinav.commands.heat.matter import (
    LARGEST_LABEL,
    Absorption,
    Heating,
    Medium,
    Metabolic,
)
from pinav.errors import InputError
from pinav.thermal.images import NEGLIGIBLE, Image, check_place, read_image
from pinav.thermal.perfusion import (
    AbstractPerfusion,
    ConstantPerfusion,
    RegionalPerfusion,
    mass_perfusion,
    perfusion_factor,
)
from pinav.thermal.tissues import Blood, Tissue

KINDS = {
    "conductivity": Conductivity,
    "density": Density,
    "specific_heat": SpecificHeat,
    "metabolic": Metabolic,
    "perfusion": Magnitude,
    "concentration": Concentration,
    "absorption": PowerDensity,
}
"""Numbers that a map may hold, of the same ranges as those of a table."""


def voxel_body(case: Case, grid: Voxels, folder: Path) -> Body:
    """Tissues and target of a case whose grid is an image.

    Raises:
        InputError: a file cannot be read, is not of these voxels, or holds what no
            tissue has.
    """
    image = read_image(folder / grid.labels)
    box = _box(grid, image)
    if image.spacing is None:
        image = Image(image.path, image.values, box.sizes)
    try:
        case.check_extent(box)
    except ValueError as error:
        raise InputError(f"{image.path}: {error}") from error
    masks = _masks(case, image)
    blood, files = build_blood(case.blood), _Files(folder, image)
    media = {
        name: _properties(medium, masks[name], files)
        for name, medium in case.tissues.items()
    }
    laws = {
        name: _law(medium, blood, media[name], masks[name], files)
        for name, medium in case.tissues.items()
    }
    target = _target(case, masks, files)
    cells = build_grid(box)
    return Body(
        grid=cells,
        tissue=_join(media, masks),
        blood=blood,
        perfusion=RegionalPerfusion(
            tuple(jnp.asarray(masks[name], float) for name in laws),
            tuple(laws.values()),
        ),
        fractions={name: jnp.asarray(mask, float) for name, mask in masks.items()},
        laws={name: _pick(index) for index, name in enumerate(laws)},
        target=jnp.asarray(target),
        middle=_centroid(target, box.sizes),
        image=image,
    )


def read_heating(heating: Heating, path: Path, body: Body) -> np.ndarray:
    """SAR [W/kg] or concentration [kg/m³] of each voxel.

    Raises:
        InputError: the file cannot be read, is not of these voxels, or holds no such
            numbers.
    """
    assert body.image is not None
    kind = "absorption" if isinstance(heating, Absorption) else "concentration"
    everywhere = np.ones(body.grid.shape, bool)
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
        within = values[mask]
        for extreme in (within.min(), within.max()) if within.size else ():
            try:
                msgspec.convert(float(extreme), KINDS[kind])
            except msgspec.ValidationError as error:
                words = str(error).replace("Expected `float`", "expected a number")
                advice = f"; {ADVICE[kind]}" if kind in ADVICE else ""
                raise InputError(f"{path}: {words}, got {extreme:g}{advice}") from error


def _box(grid: Voxels, image: Image) -> Box:
    """The cells of an image."""
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
    """The voxels of each tissue."""
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
    return passive_properties(medium, maps)


def _law(
    medium: Medium,
    blood: Blood,
    tissue: Tissue,
    mask: Bool[np.ndarray, "..."],
    files: _Files,
) -> AbstractPerfusion:
    flow = medium.perfusion
    if flow.file is None:
        return perfusion_law(medium, blood, tissue)
    assert flow.unit is not None
    values = files.read(flow.file, "perfusion", mask)
    # a unit is judged by the mean: single voxels of a map may have almost no blood
    typical = Tissue(1.0, float(np.mean(tissue.density)), 1.0)
    mass_perfusion(
        float(values[mask].mean()), unit=flow.unit, blood=blood, tissue=typical
    )
    factor = perfusion_factor(flow.unit, blood=blood, tissue=tissue)
    return ConstantPerfusion(jnp.asarray(values * factor))


def _join(
    media: dict[str, Tissue], masks: dict[str, Bool[np.ndarray, "..."]]
) -> Tissue:
    """Properties of each voxel."""
    joined = {}
    for name in PROPERTIES:
        parts = [
            np.where(masks[key], np.asarray(getattr(medium, name)), 0.0)
            for key, medium in media.items()
        ]
        joined[name] = jnp.asarray(np.sum(parts, axis=0))
    return Tissue(**joined)


def _target(
    case: Case, masks: dict[str, Bool[np.ndarray, "..."]], files: _Files
) -> np.ndarray:
    """Share of each voxel that the target has."""
    if not isinstance(case.target, TargetFile):
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


def _centroid(target: np.ndarray, sizes: tuple[float, ...]) -> tuple[float, ...]:
    places = np.indices(target.shape) + 0.5
    means = [float((target * axis).sum() / target.sum()) for axis in places]
    return tuple(mean * size for mean, size in zip(means, sizes, strict=True))


def _pick(index: int) -> Callable[[Any], AbstractPerfusion]:
    return lambda model: model.perfusion.laws[index]
