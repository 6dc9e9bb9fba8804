"""Sections of the report of a fit: its errors, its constants, the learned force."""

from collections.abc import Mapping

import numpy as np

from pinav.commands.fit.metrics import FitMetrics, support_sentence
from pinav.commands.fit.structure import StructureRow
from pinav.commands.fit.thermal import FIELDS_FILE, ThermalRow
from pinav.commands.fitted_run import DATA_FILE
from pinav.commands.force_units import units_of
from pinav.commands.matching import read_losses
from pinav.commands.system_choice import read_system_of
from pinav.evaluation import FieldMap, default_regions, normal_interval
from pinav.figures import force_comparison, loss_curve, observed_paths, save_figure
from pinav.figures.bands import (
    band,
    diffusion_bands,
    profile_band,
)
from pinav.figures.observations import positions_over_time
from pinav.figures.palette import TRUTH
from pinav.figures.style import new_figure, with_unit
from pinav.report import (
    Cell,
    Image,
    Paragraph,
    Section,
    Table,
    heading,
    quantity,
)
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories, load


def fit_sections(folder: RunFolder) -> list[Section]:
    """The sections of the report of a fit."""
    metrics = folder.read_metrics("metrics.json", FitMetrics)
    data = load(folder.path / DATA_FILE)
    arrays = folder.read_arrays("results.npz")
    supported = () if metrics.support is None else (support_sentence(metrics.support),)
    content = [
        *map(Paragraph, (*supported, *metrics.remarks)),
        *_tables(metrics),
        _paths(folder, data, arrays),
    ]
    sections = [Section(f"The fit: {metrics.model}, {metrics.recipe}", content)]
    if metrics.structure is not None:
        shown = _structure(folder, data, arrays, metrics.structure)
        sections.append(Section("The structure of the force", shown))
    if metrics.thermal is not None:
        content = [*_checks(metrics.thermal), *_thermal_fields(folder, data)]
        sections.append(Section("The thermal motion", content))
    if "field/learned" in arrays:
        force = _learned_force(folder, data, arrays, metrics)
        sections.append(Section("The learned force", force))
    if lines := _lines(folder, data, arrays):
        sections.append(Section("The learned force", [*lines]))
    return sections


def _tables(metrics: FitMetrics) -> list[Table]:
    """Errors, choices of the evidence, loss and constants, as far as there are any."""
    tables = [_errors(metrics)]
    if metrics.log_evidence is not None:
        chosen = {
            metrics.name_of_noise: metrics.noise,
            "log evidence": metrics.log_evidence,
            "iterations": metrics.iterations,
            "outcome": metrics.outcome,
        }
        tables.append(_one_row(chosen, "What the evidence chose."))
    if metrics.loss is not None:
        loss = {"start": metrics.loss.start, "end": metrics.loss.end}
        tables.append(_one_row(loss, "Training loss."))
    rows = [(name, one.value, one.sd) for name, one in metrics.learned.items()]
    if rows:
        header = ("constant", "value", "standard deviation")
        tables.append(Table(header, rows, "Constants learned."))
    return tables


def _errors(metrics: FitMetrics) -> Table:
    """Errors by the length of rollouts for a recording, else those of whole ones."""
    units, restarts = metrics.units, metrics.restarts
    length, time = units.get("x", "1"), units.get("t", "1")
    if restarts is None:
        whole = {"position": length, **units}
        rmse = {
            heading(name, whole.get(name, "1")): error
            for name, error in metrics.rmse.items()
        }
        return _one_row(rmse, "Root-mean-square errors of rollouts.")
    note = (
        f"Median end-point error of {restarts.rollouts} rollouts from observed "
        "positions, by their length. A rollout of the whole film adds up all that "
        "wanders; its error is in metrics.json."
    )
    errors = {
        heading(f"after {quantity(float(after), time)}", length): error
        for after, error in restarts.errors.items()
    }
    return _one_row(errors, note)


def _checks(thermal: ThermalRow) -> list[Paragraph | Image | Table]:
    """Whether the fit explains the increments, and what the observation does."""
    lags = range(1, 1 + max(map(len, thermal.correlations.values())))
    ratios = [
        (f"{name} along {', '.join(one.channels)}", value)
        for one in thermal.observed
        for name, value in (
            ("diffusion, mean over the data,", one.diffusion),
            ("exposure as a share of the interval,", one.exposure),
            ("error of a position, in steps by diffusion,", one.error),
        )
        if value is not None
    ]
    ratios += [
        (
            f"diffusion of every {one.every} samples over that of all, along "
            f"{', '.join(one.channels)}",
            one.ratio,
        )
        for one in thermal.thinned
    ]
    return [
        Paragraph(thermal.statement),
        Table(
            ("channel", *(f"{lag} apart" for lag in lags)),
            [(name, *values) for name, values in thermal.correlations.items()],
            "Correlations of innovations so many samples apart; those of independent "
            f"ones lie within {thermal.limit:.3f} (two standard deviations).",
        ),
        Table(
            ("quantity", "value", "standard deviation"),
            [(name, one.value, one.sd) for name, one in ratios],
            "Diffusion, blur and error of the positions, and the diffusion of thinned "
            "data.",
        ),
    ]


def _thermal_fields(folder: RunFolder, data: Trajectories) -> list[Image]:
    """Diffusion along lines through the data, and the path of a reference."""
    if not folder.has(FIELDS_FILE):
        return []
    arrays = folder.read_arrays(FIELDS_FILE)
    length, time = data.units.get(data.channels[0], "1"), data.units.get("t", "1")
    images = []
    for name in data.channels:
        if f"diffusion/{name}/places" not in arrays:
            continue
        parts = ("places", "values", "sd")
        figure = new_figure(4.2, 2.6)
        diffusion_bands(
            *(arrays[f"diffusion/{name}/{part}"] for part in parts),
            coordinate=name,
            channels=data.channels,
            units=(length, time),
            ax=figure.add_subplot(),
        )
        files = save_figure(figure, folder.path / "figures", f"diffusion-{name}")
        caption = f"Diffusion along {name} through the middle of the data, 95 % bands."
        images.append(Image(files.svg, f"Diffusion over {name}", caption))
    if "reference/times" in arrays:
        figure = new_figure(4.2, 2.6)
        times, values, sd = (
            arrays[f"reference/{part}"] for part in ("times", "values", "sd")
        )
        band(
            times,
            values,
            normal_interval(values, sd),
            labels=(with_unit("time", time), with_unit("reference", length)),
            ax=figure.add_subplot(),
        )
        files = save_figure(figure, folder.path / "figures", "reference")
        caption = "Path of the frame of reference, about its mean, with its 95 % band."
        images.append(Image(files.svg, "Path of the reference", caption))
    return images


def _lines(
    folder: RunFolder, data: Trajectories, arrays: dict[str, np.ndarray]
) -> list[Image]:
    """The force along lines through data that are not planar."""
    images = []
    units = units_of(data, read_system_of(folder))
    for name in data.channels:
        if f"line/{name}/places" not in arrays:
            continue
        places, force = (arrays[f"line/{name}/{part}"] for part in ("places", "force"))
        figure = new_figure(4.2, 2.6)
        axes = profile_band(
            places,
            force,
            arrays.get(f"line/{name}/sd", np.zeros_like(force)),
            coordinate=name,
            units=(data.units.get(name, "1"), units.get("force", "?")),
            ax=figure.add_subplot(),
        )
        caption = f"The force along {name} through the middle of the data"
        if f"line/{name}/true" in arrays:
            axes.plot(places, arrays[f"line/{name}/true"], color=TRUTH, lw=1.0, ls="--")
            caption += "; dashed: the truth"
        files = save_figure(figure, folder.path / "figures", f"force-{name}")
        images.append(Image(files.svg, f"Force over {name}", f"{caption}."))
    return images


def _paths(
    folder: RunFolder, data: Trajectories, arrays: dict[str, np.ndarray]
) -> Image:
    """All trajectories, and the loss where the recipe has one."""
    with_loss = folder.has("losses-model.npz")
    figure = new_figure(7.5 if with_loss else 4.2, 3.4)
    axes = figure.subplots(1, 2) if with_loss else [figure.subplots()]
    observed = [np.where(p.observed[:, :2], p.states[:, :2], np.nan) for p in data]
    rollouts = [ys[:n, :2] for ys, n in zip(arrays["ys"], data.lengths, strict=True)]
    if data.dim == 1:
        name = data.channels[0]
        positions_over_time(
            [p.times for p in data],
            [one[:, 0] for one in observed],
            [one[:, 0] for one in rollouts],
            labels=(
                with_unit("time", data.units.get("t", "1")),
                with_unit(name, data.units.get(name, "1")),
            ),
            ax=axes[0],
        )
    else:
        observed_paths(observed, rollouts, units=data.units, ax=axes[0])
    caption = "Observed positions and rollouts of the fitted model."
    if with_loss:
        losses = read_losses("model", folder)
        loss_curve(losses.values, losses.phases, ax=axes[1])
        caption += " Right: training loss."
    files = save_figure(figure, folder.path / "figures", "fit")
    return Image(files.svg, "Observed trajectories and rollouts of the model", caption)


def _structure(
    folder: RunFolder,
    data: Trajectories,
    arrays: dict[str, np.ndarray],
    structure: StructureRow,
) -> list[Paragraph | Image | Table]:
    """What the search came to, and each profile with its band."""
    content: list[Paragraph | Image | Table] = []
    content += map(Paragraph, structure.text().splitlines())
    for index, term in enumerate(structure.terms):
        name = f"structure/{index}"
        if name not in arrays:
            continue
        figure = new_figure(4.2, 2.6)
        length = data.units.get("x", "1")
        force = "1" if length == "1" else "?"
        coordinate = "along the normal" if term.kind in STRAIGHT else "distance"
        profile_band(
            *arrays[name],
            coordinate=coordinate,
            units=(length, force),
            ax=figure.add_subplot(),
        )
        files = save_figure(figure, folder.path / "figures", f"profile-{index}")
        caption = f"The force of the term '{term.kind}' with its band of 95 %."
        content.append(Image(files.svg, f"Profile of the term {term.kind}", caption))
    return content


STRAIGHT = ("wall", "shear layer")
"""Terms whose coordinate is no distance."""


def _learned_force(
    folder: RunFolder,
    data: Trajectories,
    arrays: dict[str, np.ndarray],
    metrics: FitMetrics,
) -> list[Paragraph | Image | Table]:
    """Maps of the force, with what is known of its truth and of its uncertainty."""
    regions = default_regions(data)
    true = "field/true" in arrays
    figure = force_comparison(
        FieldMap.of_arrays(arrays, "learned", regions),
        true=FieldMap.of_arrays(arrays, "true", regions) if true else None,
        sd=arrays.get("field/sd"),
        path=_join_tracks(data),
        units=units_of(data, read_system_of(folder)),
    )
    unit = data.units.get("x", "1")
    files = save_figure(figure, folder.path / "figures", "force")
    content: list[Paragraph | Image | Table] = [
        Image(
            files.svg,
            "Maps of the learned force and of how well it is known",
            "The force of the environment on a swimmer at rest. Hatched: unvisited, an "
            f"extrapolation ({regions.definition(unit)}).",
        )
    ]
    if metrics.force_error is not None:
        errors = {
            f"{region} (%)": None if error is None else 100 * error
            for region, error in metrics.force_error.items()
        }
        content.append(
            _one_row(
                errors,
                "Relative L2 error of the force against the system's truth, on visited "
                "and near grid points, and on the whole grid.",
            )
        )
    return content


def _join_tracks(data: Trajectories) -> np.ndarray:
    """All observed paths in one array, a row of NaN between two."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate(
        [
            part
            for p in data
            for part in (np.where(p.observed[:, :2], p.states[:, :2], np.nan), gap)
        ]
    )


def _one_row(values: Mapping[str, Cell], caption: str) -> Table:
    return Table(tuple(values), [tuple(values.values())], caption)
