"""One figure for each page of a method, drawn from runs of the command line."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from docs.figures.workshop import Workshop
from jaxtyping import Float
from matplotlib.figure import Figure

from pinav.analysis import Analysis, Discovery
from pinav.evaluation import BASELINE, ErrorCurve, Evaluation
from pinav.figures.analysis import growth_map, law_agreement, law_ranking
from pinav.figures.errors import error_over_time
from pinav.figures.heat import probe_curves
from pinav.figures.identification import errors_by_horizon, horizon_errors, speed_law
from pinav.figures.learned_tissue import perfusion_law
from pinav.figures.maps import ERROR, FORCE, largest_near, map_panel, trust_map
from pinav.figures.navigation import greatest_force, paths_map, spread_map
from pinav.figures.palette import GREY, TRUTH
from pinav.figures.style import (
    SMALL,
    THIN,
    add_legend,
    label_axes,
    new_figure,
    one_legend,
    prepare_axes,
    style_of,
    title_panel,
)
from pinav.identification import Identification
from pinav.identification.rollouts import HORIZONS
from pinav.learning.findings import ForceMaps
from pinav.learning.learn import open_run
from pinav.navigation import OnlineNavigation
from pinav.runs import RunFolder
from pinav.thermal.learned_tissue import LearnedTissue
from pinav.trajectories import load

WIDTH = 4.6
"""Of every figure [inch]: at 400 pixels its text can still be read."""

Arrays = Mapping[str, np.ndarray]


def read(folder: Path, name: str) -> Arrays:
    """The arrays of a file of a run."""
    with np.load(folder / name) as stored:
        return dict(stored)


def maps_of(folder: Path) -> ForceMaps:
    """The maps of the learned force of a run."""
    maps = open_run(folder).findings.force
    assert maps is not None  # data are planar
    return maps


def observed_paths(folder: Path) -> Float[np.ndarray, "_ 2"]:
    """The observed positions of a run, a row of NaN between two trajectories."""
    gap = np.full((1, 2), np.nan)
    pieces = [(piece.states[:, :2], gap) for piece in load(folder / "data.npz")]
    return np.concatenate([part for piece in pieces for part in piece])


def swirl(workshop: Workshop, model: str) -> Path:
    """A fit of a model to the scenario `swirl`, which has a rotational part."""
    workshop.run("swirl.npz", "simulate", "swirl", "--count", "6")
    words = ("fit", "swirl.npz", "--model", model, "--structure", "free")
    return workshop.run(f"swirl-{model}", *words)


def models(workshop: Workshop) -> Figure:
    """The true force of `swirl`, and the errors of three models of it."""
    names = ("kernel-potential", "kernel-force", "kernel-mixture")
    folders = [swirl(workshop, name) for name in names]
    forces = [maps_of(folder) for folder in folders]
    maps = [force.learned for force in forces]
    true, path = forces[0].truth, observed_paths(folders[0])
    assert true is not None  # the truth of a scenario is known
    figure = new_figure(WIDTH, 6.2)
    axes = np.ravel(figure.subplots(2, 2))
    map_panel(true, true.force, FORCE, shade=False, path=path, ax=axes[0])
    title_panel(axes[0], "(a) true force")
    for ax, letter, name, learned in zip(axes[1:], "bcd", names, maps, strict=True):
        map_panel(true, learned.force - true.force, ERROR, ax=ax)
        title_panel(ax, f"({letter}) error of {name.removeprefix('kernel-')}")
    one_legend(figure, axes[::-1])
    return figure


CORNER, GAIN, LAG = 4.0, 5.0, 3
"""Of the robot that is identified: Hz, um per turn, frames of a tenth of a second."""


def film_of_a_robot(path: Path) -> None:
    """Write a film of a rolling robot that loses grip above 4 Hz and drifts."""
    random = np.random.default_rng(1)
    commands: list[np.ndarray] = []
    rows: list[tuple[float, ...]] = []
    place, wandering, heading = np.zeros(2), np.zeros(2), 0.0
    for frame in range(3000):
        heading += random.normal(0.0, 0.25)
        frequency = 4.75 - 4.25 * np.cos(frame / 60)
        commands.append(frequency * np.array([np.cos(heading), np.sin(heading)]))
        seen = place + random.normal(0.0, 0.1, 2)
        rows.append((frame / 10, *seen, frequency, heading))
        acted = commands[max(frame - LAG, 0)]
        grip = 1.0 / np.sqrt(1 + (np.linalg.norm(acted) / CORNER) ** 2)
        wandering = 0.95 * wandering + random.normal(0.0, 0.4, 2)
        place = place + 0.1 * (GAIN * grip * acted + wandering + [0.5, -0.3])
    header = "t_s,x_um,y_um,freq_hz,alpha_rad"
    np.savetxt(path, rows, "%.6g", delimiter=",", header=header, comments="")


def identification(workshop: Workshop) -> Figure:
    """The response that was found to a simulated robot, and its errors by horizon."""
    film = workshop.file("robot.csv", film_of_a_robot)
    words = ("identify", film.name, "--reading", "heading_offset=0")
    folder = workshop.run("robot", *words)
    result = RunFolder.open(folder).load("metrics", Identification)
    law = result.tracks[0].law
    assert law is not None
    figure = new_figure(WIDTH, 5.2)
    above, below = figure.subplots(2, 1)
    places = law.places
    speed_law(law, ax=above)
    truth = GAIN * places / np.sqrt(1 + (places / CORNER) ** 2)
    above.plot(places, truth, color=TRUTH, lw=THIN, ls="--", label="truth")
    add_legend(above)
    horizon_errors(HORIZONS, errors_by_horizon(result), ax=below)
    below.set_ylim(bottom=0.01)
    add_legend(below, columns=2)
    title_panel(above, "(a) response to the frequency")
    title_panel(below, "(b) rollouts of the held-out part, median")
    return figure


def evaluation(workshop: Workshop) -> Figure:
    """Errors away from the data: of the force by distance, of rollouts by time."""
    runs = workshop.tutorial("wrong-force") / "runs"
    folders = {"network with time": runs / "ude", "kernel force": runs / "kernel"}
    figure = new_figure(WIDTH, 5.2)
    above, below = (prepare_axes(ax) for ax in figure.subplots(2, 1))
    curves: dict[str, ErrorCurve] = {}
    styles = dict(zip(folders, map(style_of, ("ude", "kernel-force")), strict=True))
    for name, folder in folders.items():
        edges, errors = error_by_distance(maps_of(folder))
        look = {"color": styles[name].color, "ls": styles[name].dash, "lw": 1.5}
        above.stairs(errors, edges, label=name, **look)
        scored = RunFolder.open(folder).load("evaluation", Evaluation)
        curves[name] = scored.curves["model"]["clean starts"]
        curves["physics only"] = scored.curves[BASELINE]["clean starts"]
    above.set(yscale="log")
    above.tick_params(which="both", labelsize=SMALL)
    for distance in (0.35, 1.0):
        above.axvline(distance, color=GREY, lw=0.8, ls=(0, (4, 2)), zorder=1)
    label_axes(above, "distance from the data", "relative error of the force")
    add_legend(above)
    error_over_time(curves, styles=styles, ax=below)
    title_panel(above, "(a) dashed: ends of visited and near ground")
    title_panel(below, "(b) rollouts from new starts, median and 90 %")
    return figure


def error_by_distance(
    maps: ForceMaps, count: int = 12
) -> tuple[Float[np.ndarray, " edge"], Float[np.ndarray, " bin"]]:
    """Relative L2 error of a force over the distance from the data."""
    learned, truth = maps.learned, maps.truth
    assert truth is not None  # the truth of a scenario is known
    distance = learned.distance
    error = np.sum((learned.force - truth.force) ** 2, axis=-1)
    size = np.sum(truth.force**2, axis=-1)
    edges = np.concatenate([[0.0, 0.35, 1.0], np.linspace(2.0, 7.0, count - 6)])
    sums = [
        np.histogram(distance, edges, weights=values)[0] for values in (error, size)
    ]
    return edges, np.sqrt(sums[0] / sums[1])


def analysis(workshop: Workshop) -> Figure:
    """Parts of the learned force of `swirl`, where it is known, and growth."""
    folder = swirl(workshop, "kernel-mixture")
    workshop.once(folder / "analysis.npz", "analyse", folder.name)
    found = RunFolder.open(folder).load("analysis", Analysis)
    field, split, path = found.field, found.split, observed_paths(folder)
    figure = new_figure(WIDTH, 6.2)
    axes = np.ravel(figure.subplots(2, 2))
    top = largest_near(np.linalg.norm(field.force, axis=-1), field)
    parts = {"(a) gradient": split.gradient, "(b) rotational": split.rotational}
    for ax, (title, part) in zip(axes, parts.items(), strict=False):
        map_panel(field, part, FORCE, limits=(0.0, top), path=path, ax=ax)
        title_panel(ax, f"{title} part")
    assert found.doubt is not None
    trust_map(field, found.doubt.sd, path=path, ax=axes[2])
    title_panel(axes[2], "(c) signal to noise")
    growth_map(found.lyapunov, ax=axes[3])
    title_panel(axes[3], "(d) growth of separations")
    one_legend(figure, axes[::-1])
    return figure


def discovery(workshop: Workshop) -> Figure:
    """Candidate laws behind the force of `barrier-crossings`, and the best one."""
    words = ("simulate", "barrier-crossings", "--positions-only")
    workshop.run("crossings.csv", *words)
    folder = workshop.run("crossings", "fit", "crossings.csv")
    workshop.once(folder / "laws.npz", "discover", folder.name)
    found = RunFolder.open(folder).load("laws", Discovery)
    figure = new_figure(WIDTH, 5.6)
    above, below = figure.subplots(2, 1)
    law_ranking(found, ax=above)
    law_agreement(found, ax=below)
    below.set(aspect="equal", adjustable="datalim", ylabel="learned force")
    title_panel(above, "(a) candidate laws")
    title_panel(below, f"(b) the law '{found.best.name}' at visited places")
    return figure


def adaptive(workshop: Workshop) -> Figure:
    """Three moments of a flight through a vortex of which nothing was known."""
    words = ("navigate", "--learn-online", "vortex", "--seeds", "1", "--visits", "1")
    result = RunFolder(workshop.run("vortex", *words)).load("metrics", OnlineNavigation)
    shown, course, path = result.shown, result.course, result.paths["visit 1"][0]
    times, limit = shown.times, greatest_force(shown.maps)
    chosen = np.linspace(1, len(times) - 1, 3).round().astype(int)
    figure = new_figure(WIDTH, 4.2)
    axes = figure.subplots(2, 3)
    for column, k in zip(axes.T, chosen, strict=True):
        field = dataclasses.replace(shown.maps.learned, force=shown.means[k])
        so_far = path[: round(float(times[k]) / result.step) + 1]
        paths_map(field, course, {"visit 1": [so_far]}, limit=limit, ax=column[0])
        spread_map(field, shown.sds[k], course, thrust=1.0, route=so_far, ax=column[1])
        title_panel(column[0], f"t = {float(times[k]):.2g}")
        if k != chosen[0]:
            for ax in column:
                ax.set_ylabel("")
    return figure


def thermal(workshop: Workshop) -> Figure:
    """Probes and their fit, and the perfusion of muscle that it took."""
    folder = workshop.tutorial("bioheat") / "runs" / "learn"
    found = RunFolder.open(folder).load("metrics", LearnedTissue)
    curves = found.curves
    figure = new_figure(WIDTH, 5.4)
    above, below = figure.subplots(2, 1)
    readings, shown = (curves.times, curves.read), (curves.fitted, curves.names)
    probe_curves(curves.times, *shown, readings=readings, ax=above)
    above.set_ylim(top=49.5)
    add_legend(above, columns=4, loc="upper left")
    perfusion_law(found.laws["tissue"], ax=below)
    add_legend(below)
    title_panel(above, "(a) seven probes along the radius, readings and fit")
    title_panel(below, "(b) perfusion of muscle; dotted: not reached")
    return figure
