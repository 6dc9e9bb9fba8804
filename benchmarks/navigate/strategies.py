"""Strategies that learn a force while they steer, compared on the tasks."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from pinav.codec import decode, encode
from pinav.commands.navigate.job import online_task
from pinav.commands.navigate.sections import online_table
from pinav.navigation import (
    AdaptiveController,
    Flight,
    FlightOutcome,
    fly_swimmer,
    judge_controllers,
    task,
)
from pinav.navigation.adaptive.flight import ORACLE
from pinav.navigation.adaptive.strategies import (
    MEAN_FORCE,
    ExplorationBonus,
)
from pinav.report import as_text
from pinav.runs import RunFolder

TASKS = ("barrier-weak", "keep-out", "many-barriers", "fibres", "vortex", "shear")
"""Tasks in a force, or a current, that is learned on the way."""

STRATEGIES: Mapping[str, ExplorationBonus] = {
    "mean force": MEAN_FORCE,
    "exploration bonus": ExplorationBonus(),
}
"""What is compared."""

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
            outcomes = _contest(name, range(seeds))
            document = {name: encode(one).document for name, one in outcomes.items()}
            folder.write_json(file, document)
        folder.manifest.check(file)
        rows = decode(dict[str, FlightOutcome], folder.read_json(file), {})
        table = online_table(rows)
        folder.write_table(f"learn-online-{name}.csv", table.header, table.rows)
        print(f"{name}\n{as_text(table)}", flush=True)


def _contest(name: str, seeds: Sequence[int]) -> dict[str, FlightOutcome]:
    """The outcome of the oracle and of each strategy on a task."""
    problem = online_task(name, position_noise=NOISE, delay=None)
    flights: dict[str, list[Flight]] = {}
    for label, strategy in STRATEGIES.items():
        steered = AdaptiveController.of(problem, strategy)
        swimmers = [
            fly_swimmer(steered, 0, number, visits=1, oracle=not flights)
            for number in tqdm(seeds, desc=label, unit="swimmer")
        ]
        if not flights:
            flights[ORACLE] = [one.flights[ORACLE] for one in swimmers]
        flights[label] = [one.flights["visit 1"] for one in swimmers]
    return judge_controllers(flights, task(name).time_limit)
