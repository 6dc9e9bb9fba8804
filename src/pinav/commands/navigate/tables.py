"""Results of `pinav navigate` as tables and words."""

from collections.abc import Mapping

from pinav.commands.navigate.metrics import (
    ControllerRow,
    IntervalRow,
    NavigationMetrics,
    SuggestionRow,
)
from pinav.report import Table, quantity
from pinav.report.text import as_text
from pinav.units import force_unit, with_order


def controller_table(
    controllers: Mapping[str, ControllerRow], regret: Mapping[str, IntervalRow]
) -> Table:
    """One row for each controller."""
    rows = []
    for name, row in controllers.items():
        ratio = regret.get(name)
        rows.append(
            (
                name,
                row.success.percent(),
                row.violation.percent(),
                row.arrival.median,
                "–" if ratio is None else ratio.ratio(),
                row.efficiency,
                row.clearance,
            )
        )
    header = (
        "controller",
        "success",
        "violation",
        "arrival",
        "regret",
        "efficiency",
        "least clearance",
    )
    runs = next(iter(controllers.values())).runs
    return Table(header, rows, f"{runs} runs each. {CAPTION}")


CAPTION = (
    "Success and violation with Wilson's 95 % interval; arrival: median time of those "
    "that arrived; regret: median over paired runs of the arrival time over that with "
    "the truth; efficiency: straight distance over length of the path."
)


def sentences(metrics: NavigationMetrics) -> list[str]:
    """The findings in words."""
    plan, step, time = metrics.plan, metrics.step, metrics.units.get("t", "")
    reach = (
        f"from {100 * plan.unreachable:.2g} % of the arena the goal cannot be reached"
        if plan.unreachable
        else "from everywhere in the arena the goal can be reached"
    )
    lines = [
        f"The plan takes {quantity(plan.time, time)} from rest; {reach} in time.",
        f"Tried in {environment_words(metrics)}.",
        f"A control step takes {1e3 * step.median:.2g} ms, the first one "
        f"{step.first:.2g} s with its compilation.",
    ]
    if metrics.delay:
        lines.append(f"Commands act after {quantity(metrics.delay, time)}.")
    for name, reason in metrics.refused.items():
        lines.append(f"No run with the model {name}: {reason}.")
    if metrics.suggestion is not None:
        lines.append(_advice(metrics.suggestion, unit_of_field(metrics)))
    return lines


def environment_words(metrics: NavigationMetrics) -> str:
    """The environment of the closed loops, in words."""
    if metrics.truth is None:
        return (
            "environments drawn from the posterior, or the model itself where there is "
            "none: the true one is not known"
        )
    return f"the true environment of {metrics.truth} (synthetic)"


def unit_of_field(metrics: NavigationMetrics) -> str:
    """Unit of the learned field: of a velocity for a swimmer without inertia."""
    return force_unit(with_order(metrics.units, metrics.order, metrics.force))


def _advice(suggestion: SuggestionRow, unit: str) -> str:
    random = suggestion.sd_after_random
    other = "" if random is None else f", a random one to {quantity(random, unit, 2)}"
    return (
        "The next trajectory to record (suggestion.csv) should lower the standard "
        "deviation of the learned field along the route from "
        f"{quantity(suggestion.sd, unit, 2)} to "
        f"{quantity(suggestion.sd_after, unit, 2)}{other}."
    )


def text(metrics: NavigationMetrics) -> str:
    """The findings for a terminal."""
    return "\n".join(
        [
            as_text(controller_table(metrics.controllers, metrics.regret)),
            *sentences(metrics),
        ]
    )
