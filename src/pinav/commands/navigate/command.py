"""The command that plans and steers: its options, and the call of its job."""

import json
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from pinav.commands.navigate.settings import NavigateSettings


class NavigateOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Go from a place to a place through the force that a run has learned.

    Plans on the learned force (from where the goal cannot be reached, and where the
    model is uncertain), steers by model-predictive control, and tries it in closed
    loop: in the true environment where the data are those of a scenario, else in
    environments drawn from the posterior. Physics alone and, where it is known, the
    same controller with the truth are tried beside it. The run also suggests the
    trajectory that would tell most about the force along the route. Writes
    metrics.json, report.html, figures and an animation. A negative number takes an
    equals sign: --from=-1,2.
    """

    run: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(help="Folder of pinav fit, of trajectories or of a recording."),
    ]
    settings: NavigateSettings
    out: Annotated[Path, tyro.conf.arg(help="Folder of the run.")]
    overwrite: Annotated[
        bool, tyro.conf.arg(help="Replace the results that --out already holds.")
    ] = False
    json: Annotated[
        bool,
        tyro.conf.arg(help="Print the metrics as JSON, for scripts, and nothing else."),
    ] = False


def navigate(options: NavigateOptions) -> None:
    """`pinav navigate`."""
    settings = options.settings
    settings.check()
    import jax

    jax.config.update("jax_enable_x64", val=True)
    from pinav.commands.navigate import job, setup, tables
    from pinav.commands.report.job import write_report
    from pinav.runs import RunFolder

    problem = setup.navigation_problem(settings, RunFolder.open(options.run))
    content = {k: v for k, v in msgspec.to_builtins(settings).items() if v is not None}
    content = {k: list(v) if isinstance(v, tuple) else v for k, v in content.items()}
    config = {"job": "navigate", "run": options.run.name, **content}
    folder = RunFolder.create(options.out, config, overwrite=options.overwrite)
    metrics = job.navigate(settings, problem, folder)
    page = write_report(folder)
    if options.json:
        json.dump(metrics, sys.stdout, indent=2)
        print()
        return
    print(tables.text(metrics))
    print(f"report: {page}")
