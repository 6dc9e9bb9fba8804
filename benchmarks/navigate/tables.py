"""Results of the benchmark as tables."""

from typing import Any

from pinav.codec import decode
from pinav.commands.navigate.sections import controller_table
from pinav.navigation import Interval, Summary
from pinav.report import Table, as_text, number


def text(name: str, result: dict[str, Any]) -> str:
    """What was found on one task, for a terminal."""
    lines = [f"\n{name}", as_text(_controllers(result))]
    tracking = {
        title: row["tracking"]
        for title, row in result["controllers"].items()
        if row["tracking"] != "nan"
    }
    for title, value in tracking.items():
        lines.append(f"mean tracking error, {title}: {number(value, 3)}")
    for title, reason in result["refused"].items():
        lines.append(f"{title} refuses: {reason}")
    step = result["step"]
    lines.append(
        f"control step with the learned model: {1e3 * step['median']:.2g} ms, the "
        f"first {step['first']:.2g} s"
    )
    return "\n".join(lines)


def _controllers(result: dict[str, Any]) -> Table:
    return controller_table(_summaries(result), _regrets(result))


def _summaries(result: dict[str, Any]) -> dict[str, Summary]:
    """Metrics of each controller, without its failures."""
    return {
        name: decode(Summary, {k: v for k, v in row.items() if k != "failed"}, {})
        for name, row in result["controllers"].items()
    }


def _regrets(result: dict[str, Any]) -> dict[str, Interval]:
    return decode(dict[str, Interval], result["regret"], {})


def successes_and_regrets(
    result: dict[str, Any],
) -> tuple[dict[str, Interval], dict[str, Interval]]:
    """Intervals of the success and of the regret of each controller."""
    successes = {name: row.success for name, row in _summaries(result).items()}
    return successes, _regrets(result)


def outcome_table(results: dict[str, Any]) -> Table:
    """Success, violation, arrival and regret of every controller on every task."""
    header = [
        "task",
        "controller",
        "runs",
        "success",
        "success_low",
        "success_high",
        "violation",
        "arrival_5",
        "arrival_50",
        "arrival_95",
        "regret",
        "regret_low",
        "regret_high",
        "clearance",
        "effort",
    ]
    rows = []
    for name, result in results.items():
        for title, row in result["controllers"].items():
            ratio = result["regret"].get(title, {})
            rows.append(
                [
                    name,
                    title,
                    row["runs"],
                    *(row["success"][k] for k in ("value", "lower", "upper")),
                    row["violation"]["value"],
                    *(row["arrival"][k] for k in ("low", "median", "high")),
                    *(ratio.get(k) for k in ("value", "lower", "upper")),
                    row["clearance"],
                    row["effort"],
                ]
            )
    return Table(header, rows)


def tracking_table(results: dict[str, Any]) -> Table:
    """Tracking errors of every controller on every path."""
    rows = [
        [name, title, row["tracking"], row["tracking_rms"]]
        for name, result in results.items()
        for title, row in result["controllers"].items()
        if row["tracking"] != "nan"
    ]
    return Table(["task", "controller", "mean", "rms"], rows)
