"""The findings of `pinav design`: the same blocks on a terminal and in a report."""

from collections.abc import Callable

import numpy as np

from pinav.figures.images import Picture
from pinav.figures.navigation import bounds_figure, recordings_figure
from pinav.navigation import Suggestion
from pinav.navigation.design.result import CampaignSummary, DesignResult
from pinav.report import AbstractBlock, Cell, Paragraph, Section, Table

CAPTION = (
    "Finished: the force along the way was known well enough by the belief; "
    "trajectories: median until then, a dash where more than half were given up; until "
    "truly known: median until the true error was below the accuracy for the first "
    "time; right when finished: campaigns whose true error was then below it."
)


def sections(result: DesignResult) -> list[Section]:
    """The outcome, and what was recorded."""
    outcome: list[AbstractBlock] = [*map(Paragraph, sentences(result))]
    if result.designs:
        outcome += [design_table(result), _bounds(result)]
    if result.next is not None:
        outcome.append(_programme(result.next))
    return [Section("Outcome", outcome), Section("Recordings", [_map(result)])]


def sentences(result: DesignResult) -> list[str]:
    """The findings in words."""
    if "recorded" in result.paths:
        return [_next_sentence(result)]
    lines = [
        f"System {result.system} (synthetic): trajectories until the force along the "
        f"planned way is known to {100 * result.accuracy:g} % with a probability of "
        "95 %, by the belief."
    ]
    informed = result.designs.get("informed")
    if informed is None or _known(informed.trajectories) is None:
        return lines
    for name, row in result.designs.items():
        if name == "informed" or not informed.trajectories:
            continue
        if _known(row.trajectories) is None:
            lines.append(f"Most {name} campaigns were given up.")
        else:
            ratio = informed.trajectories / row.trajectories
            lines.append(
                f"The informed design took {100 * ratio:.0f} % of the trajectories "
                f"of the {name} one (medians)."
            )
    return lines


def _known(value: float) -> float | None:
    """A number, or none where it is not finite."""
    return value if np.isfinite(value) else None


def design_table(result: DesignResult) -> Table:
    """One row for each design."""
    columns: dict[str, Callable[[tuple[str, CampaignSummary]], Cell]] = {
        "design": lambda one: one[0],
        "campaigns": lambda one: one[1].campaigns,
        "finished": lambda one: one[1].finished,
        "trajectories": lambda one: _known(one[1].trajectories),
        "fewest": lambda one: one[1].fewest,
        "largest": lambda one: one[1].largest,
        "until truly known": lambda one: _known(one[1].reached),
        "right when finished": lambda one: one[1].right,
        "true error at the end": lambda one: _known(one[1].error),
    }
    return Table.of(result.designs.items(), columns, CAPTION)


def _next_sentence(result: DesignResult) -> str:
    count, decision = len(result.paths["recorded"]), result.decision
    advice, accuracy = result.next, result.accuracy
    known = (
        f"After {count} trajectories the force along the planned way "
        f"is known to {100 * decision.error:.2g} % with a probability of 95 %"
    )
    if decision.certain(accuracy):
        return f"{known}; nothing further need be recorded for {100 * accuracy:g} %."
    if not decision.arrives:
        known = (
            f"After {count} trajectories no plan reaches the goal on the learned force"
        )
    if advice is None:
        return f"{known}; no candidate trajectory stays inside of the arena."
    x, y = advice.start
    return (
        f"{known}. Record next the trajectory in next.csv, released at ({x:.4g}, "
        f"{y:.4g}): the standard deviation of the force along the way, now "
        f"{advice.sd:.3g}, should then be {advice.sd_after:.3g}."
    )


def _programme(advice: Suggestion) -> Table:
    """The commands of the trajectory to record next."""
    series = advice.times, advice.frequency, advice.heading
    rows = list(zip(*(values.tolist() for values in series), strict=True))
    caption = "Commands of the trajectory to record next; linear between the times."
    return Table(("t", "frequency", "heading"), rows, caption, "next")


def _bounds(result: DesignResult) -> Picture:
    return Picture(
        "design-bounds",
        lambda: bounds_figure(result.bounds, result.accuracy),
        "Bound of the relative error of the force along the planned way (95 %), after "
        "each trajectory of each campaign.",
        width=0.8,
    )


def _map(result: DesignResult) -> Picture:
    design = next((name for name, paths in result.paths.items() if paths), "")
    what = {"recorded": "the recordings", "": "no trajectory"}.get(
        design, f"the first campaign of the {design} design"
    )
    return Picture(
        "design-recordings",
        lambda: recordings_figure(
            result.course,
            result.maps,
            result.paths.get(design, ()),
            way=result.decision.way,
            thrust=result.thrust,
        ),
        f"Standard deviation of the force after {what}, its trajectories, and the way "
        "that is planned then.",
        width=0.7,
    )
