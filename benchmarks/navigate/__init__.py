"""Learned models against baselines in closed loop, on the tasks of navigation.

Run with `python -m benchmarks navigate`. Each task is fitted from several draws of 8
noisy trajectories by the default recipe; every controller runs with the same noise. All
data are synthetic.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from benchmarks._options import begin
from benchmarks.navigate.contest import CONTROLLERS, Contest, contest
from benchmarks.navigate.strategies import compare_strategies
from benchmarks.navigate.tables import (
    outcome_table,
    successes_and_regrets,
    text,
    tracking_table,
)
from pinav.commands.settings import Settings
from pinav.errors import InputError
from pinav.figures import save_figure
from pinav.figures.navigation import outcome_bars
from pinav.navigation.task.catalogue import TASKS
from pinav.runs import RunFolder


class Options(Settings, frozen=True):
    """Closed loops of six controllers on the tasks of navigation.

    A killed benchmark goes on where it was: what --out holds is not done again.
    """

    out: Annotated[Path, tyro.conf.arg(help="Folder of fits and results.")] = Path(
        "runs/bench-navigate"
    )
    tasks: Annotated[
        tuple[str, ...], tyro.conf.arg(help="Names of tasks; all unless given.")
    ] = ()
    fits: Annotated[int, tyro.conf.arg(help="Draws of the training data.")] = 5
    seeds: Annotated[int, tyro.conf.arg(help="Runs for each of them.")] = 20
    learn_online: Annotated[
        bool,
        tyro.conf.arg(
            help="Strategies that learn on the way, from no data, instead of fits."
        ),
    ] = False
    samples: Annotated[
        int, tyro.conf.arg(help="Models drawn from each posterior, for the plan.")
    ] = 8

    def check_together(self) -> None:
        """Raise `InputError` where an option makes no sense."""
        for name in self.tasks:
            if name not in TASKS:
                known = ", ".join(TASKS)
                raise InputError(f"--tasks: {name!r} is none of {known}")
        if self.fits < 1 or self.seeds < 1:
            raise InputError(
                f"--fits, --seeds: expected 1 or more, got {self.fits}, {self.seeds}"
            )
        if self.samples < 0 or self.samples == 1:
            raise InputError(
                f"--samples: expected 0, or 2 and more, got {self.samples}"
            )


def main(argv: Sequence[str]) -> None:
    options = begin(Options, argv, "navigate")
    if options is None:
        return
    if options.learn_online:
        compare_strategies(options.out, options.tasks, options.seeds)
        return
    numbers = {name: getattr(options, name) for name in ("fits", "seeds", "samples")}
    config = {"run": {"command": "bench-navigate"}, **numbers}
    folder = RunFolder.resume(options.out, config)
    design = Contest(options.fits, options.seeds, options.samples)
    results = {}
    for name in options.tasks or TASKS:
        results[name] = contest(name, design, folder)
        print(text(name, results[name]), flush=True)
        if "arrival" in results[name]["controllers"]["oracle"]:
            figure = outcome_bars(*successes_and_regrets(results[name]))
            save_figure(figure, folder.path / "figures", f"outcome-{name}")
    folder.write_json("results.json", results)
    for table, file in ((outcome_table, "outcome"), (tracking_table, "tracking")):
        found = table(results)
        folder.write_table(f"{file}.csv", found.header, found.rows)


__all__ = ["CONTROLLERS", "Options", "main"]
