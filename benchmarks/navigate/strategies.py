"""Strategies that learn a force while they steer, compared on the tasks."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
from tqdm import tqdm

from pinav.commands.navigate.flights import ORACLE, fly_swimmer
from pinav.commands.navigate.online import (
    STRATEGIES,
    OnlineRow,
    online_task,
    rows_of,
)
from pinav.commands.navigate.online_tables import online_table
from pinav.navigation import task
from pinav.navigation.adaptive.scores import FlightRecord
from pinav.navigation.adaptive.steering import Adaptive
from pinav.report.text import as_text
from pinav.runs import RunFolder

TASKS = ("barrier-weak", "keep-out", "many-barriers", "fibres", "vortex", "shear")
"""Tasks in a force, or a current, that is learned on the way."""

NOISE = 0.02
"""Standard deviation of the observed positions [L]."""


def compare_strategies(out: Path, tasks: Sequence[str], seeds: int) -> None:
    """Fly every strategy on the tasks, and print and write a table of each.

    What the folder holds is not flown again.

    Args:
        out: folder of the results.
        tasks: their names; those of `TASKS` where there are none.
        seeds: flights of each strategy.
    """
    config = {"run": {"command": "bench-navigate-learn-online"}, "seeds": seeds}
    folder = RunFolder.resume(out, config)
    for name in tasks or TASKS:
        file = f"learn-online-{name}.json"
        if not (folder.path / file).exists():
            folder.write_json(file, _contest(name, range(seeds)))
        folder.check_file(file)
        rows = msgspec.convert(folder.read_json(file), dict[str, OnlineRow])
        table = online_table(rows)
        folder.write_table(f"learn-online-{name}.csv", table.header, table.rows)
        print(f"{name}\n{as_text(table)}", flush=True)


def _contest(name: str, seeds: Sequence[int]) -> dict[str, OnlineRow]:
    """The outcome of the oracle and of each strategy on a task."""
    problem = online_task(name, position_noise=NOISE, delay=None)
    flights: dict[str, list[FlightRecord]] = {}
    for label, strategy in STRATEGIES.items():
        steered = Adaptive.of(problem, strategy)
        swimmers = [
            fly_swimmer(steered, 0, number, visits=1, oracle=not flights)
            for number in tqdm(seeds, desc=label, unit="swimmer")
        ]
        if not flights:
            flights[ORACLE] = [one.records[ORACLE] for one in swimmers]
        flights[label] = [one.records["visit 1"] for one in swimmers]
    return rows_of(flights, task(name).time_limit)
