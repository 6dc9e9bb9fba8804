"""Figures and sections of `pinav navigate`."""

from pinav.commands.navigate.tables import controller_table, sentences, where
from pinav.figures import save_figure
from pinav.figures.animation import Trails, save_animation
from pinav.figures.navigation import Course, closed_loop_figure, outcome_bars, plan_map
from pinav.figures.style import new_figure
from pinav.report import Image, Paragraph, Section
from pinav.runs import RunFolder

DRAWN = 8
"""Runs of each controller on a map."""


def navigation_sections(folder: RunFolder) -> list[Section]:
    """The sections of a finished run."""
    metrics = folder.read_json("metrics.json")
    arrays = folder.read_arrays("results.npz")
    units = metrics["units"]
    words = [Paragraph(line) for line in sentences(metrics)]
    bars = outcome_bars(metrics["controllers"], metrics["regret"])
    outcome = [
        *words,
        controller_table(metrics),
        _saved(folder, bars, "outcome", "Success and regret, with 95 % intervals."),
    ]
    return [
        Section("Outcome", outcome),
        Section("Plan", [_plan(folder, arrays, units)]),
        Section("Closed loop", [_loops(folder, arrays, metrics)]),
        Section("A run", [_animation(folder, arrays, metrics)]),
    ]


def _plan(folder, arrays, units) -> Image:
    figure = new_figure(4.6, 5.0)
    options = {"route": arrays["route"], "units": units, "ax": figure.add_subplot()}
    plan_map(arrays["plan/time"], Course(arrays), **options)
    caption = (
        "Time to the goal (cross) from rest, as planned on the learned force with the "
        "greatest thrust, and the planned way from the start (circle). Hatched: the "
        "goal cannot be reached within the time limit."
    )
    return _saved(folder, figure, "plan", caption, width=0.6)


def _loops(folder, arrays, metrics) -> Image:
    paths = {
        name: [
            states[: steps + 1, :2]
            for states, steps in zip(
                arrays[f"states/{name}"][:DRAWN],
                arrays[f"steps/{name}"][:DRAWN],
                strict=True,
            )
        ]
        for name in metrics["controllers"]
    }
    figure = closed_loop_figure(
        arrays, paths, thrust=metrics["thrust"], units=metrics["units"]
    )
    caption = (
        f"Paths of at most {DRAWN} runs of each controller, in {where(metrics)}. The "
        "controllers differ in the model with which they plan."
    )
    return _saved(folder, figure, "closed-loop", caption)


def _animation(folder, arrays, metrics) -> Image:
    paths = {n: arrays[f"states/{n}"][0, :, :2] for n in metrics["controllers"]}
    trails = Trails(paths, float(arrays["step"]))
    file = folder.path / "figures" / "navigate-run.gif"
    save_animation(arrays, trails, file, units=metrics["units"])
    caption = "One run of each controller with the same noise."
    return Image(file, caption, caption)


def _saved(folder, figure, name: str, caption: str, width: float = 1.0) -> Image:
    files = save_figure(figure, folder.path / "figures", f"navigate-{name}")
    return Image(files.svg, caption, caption, width)
