"""The findings of `pinav navigate --learn-online` as a table and in words."""

from collections.abc import Mapping

from pinav.commands.navigate.online import OnlineMetrics, OnlineRow
from pinav.figures.style import DIMENSIONLESS, with_unit
from pinav.report import Table, quantity
from pinav.report.text import as_text


def online_table(
    controllers: Mapping[str, OnlineRow], units: Mapping[str, str] = DIMENSIONLESS
) -> Table:
    """One row for each controller.

    Args:
        controllers: rows by their names.
        units: of each channel; "1" means dimensionless.
    """
    length, time = units.get("x", "1"), units.get("t", "1")
    columns = {
        "success": lambda row: row.success.percent(),
        "in time": lambda row: row.in_time.percent(),
        "violation": lambda row: row.violation.percent(),
        with_unit("arrival", time): lambda row: row.arrival.median,
        "5 %": lambda row: row.arrival.low,
        "95 %": lambda row: row.arrival.high,
        "regret": lambda row: "–" if row.regret is None else row.regret.ratio(),
        with_unit("least clearance", length): lambda row: row.clearance,
        "force error": lambda row: "–" if row.force_error is None else row.force_error,
        "cover": lambda row: "–" if row.cover is None else row.cover,
        "consistency": lambda row: row.consistency,
    }
    rows = [
        (name, *(column(row) for column in columns.values()))
        for name, row in controllers.items()
    ]
    runs = next(iter(controllers.values())).runs
    return Table(("flights", *columns), rows, f"{runs} flights each. {CAPTION}")


CAPTION = (
    "Success, violation and arrival within the task's own limit (in time) with "
    "Wilson's 95 % interval; arrival: median and quantiles of those that arrived; "
    "regret: median over pairs of the arrival time over that with the true force; "
    "force error: root sum of squared errors over the visited path, relative; cover: "
    "of nominal 95 % bands there; consistency: squared error of the position over its "
    "variance, 1 where the filter is right."
)


def sentences(metrics: OnlineMetrics) -> list[str]:
    """The findings in words."""
    last = list(metrics.controllers.values())[1]
    length, time = (metrics.units.get(channel, "1") for channel in ("x", "t"))
    known = "the fit alone" if metrics.prior else "nothing"
    return [
        f"Task {metrics.task} (synthetic), strategy {metrics.strategy}: {known} is "
        f"known of the force beforehand; positions with an error of "
        f"{quantity(metrics.position_noise, length)} are all that is observed, "
        f"commands come into force after {quantity(metrics.delay, time)}.",
        f"Flights were given up after {quantity(metrics.time_limit, time)}; the "
        f"task's own limit is {quantity(metrics.own_limit, time)}.",
        f"Learning from a frame takes at most {1e3 * (last.frame_time or 0):.2g} ms "
        f"(99 %), a command {1e3 * (last.command_time or 0):.2g} ms, a plan "
        f"{1e3 * (last.replan_time or 0):.2g} ms (medians); the belief takes "
        f"{last.memory / 1e6:.2g} MB. The safety filter changed {last.changed:.2g} "
        "commands in a flight.",
    ]


def text(metrics: OnlineMetrics) -> str:
    """The findings for a terminal."""
    table = online_table(metrics.controllers, metrics.units)
    return "\n".join([as_text(table), *sentences(metrics)])
