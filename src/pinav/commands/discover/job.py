"""`pinav discover`: the law behind the learned force of a run."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pinav.analysis import Discovery
from pinav.analysis import discover as discover_law
from pinav.analysis.discovery.law_regression import law_force
from pinav.analysis.discovery.learned_fit import laplace_posterior
from pinav.commands.command import CommandResult
from pinav.commands.discover.metrics import (
    CentralRow,
    DiscoveryMetrics,
    LawRow,
)
from pinav.commands.discover.settings import DiscoverOptions
from pinav.commands.fitted_run import FittedRun
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import Posterior
from pinav.fitting.environments.choice import learned_part
from pinav.forces import as_learned_force
from pinav.identification import needs_kalman_filter
from pinav.report import Cell, Table
from pinav.report.text import as_text
from pinav.runs import RunFolder

LAWS_FILE, SAMPLE_FILE = "laws.json", "laws.npz"


def discover(run: Path, refits: int) -> DiscoveryMetrics:
    """Rank the laws of a run's learned force; write `laws.json` and its arrays.

    Args:
        run: folder of a fitted run.
        refits: number of laws refitted through the equations of motion.

    Raises:
        InputError: the run is no finished fit of a force.
        FitError: the learned force does not explain the trajectories.
    """
    fitted = FittedRun.open(run)
    discovery = discover_law(_posterior(fitted), fitted.data, refits=refits)
    metrics = _metrics(discovery)
    best, sample = discovery.best, discovery.sample
    values = np.array([constant.value for constant in best.constants])
    variances = np.maximum(np.diag(sample.covariance), 0.0)
    fitted.folder.write_arrays(
        SAMPLE_FILE,
        {
            "positions": sample.positions,
            "learned": sample.force,
            "sd": np.sqrt(variances).reshape(sample.force.shape),
            "law": law_force(best.law, values, sample.positions),
        },
    )
    fitted.folder.write_metrics(LAWS_FILE, metrics)
    return metrics


def _posterior(run: FittedRun) -> Posterior:
    """The posterior that the run stored, or one by Laplace about its model."""
    model, path = run.model, run.folder.path
    known = isinstance(model, Swimmer | OverdampedSwimmer)
    stochastic = run.system.thermal_energy is not None or "diffusion" in run.constants
    if not known or stochastic or needs_kalman_filter(run.system):
        raise InputError(
            f"{path}: laws are refitted to trajectories that follow from their starts; "
            "expected a swimmer without thermal noise, commands or wandering velocity, "
            f"got the model {run.choice.name} of system {run.system.name}"
        )
    if as_learned_force(model.environment) is None:
        raise InputError(
            f"{path}: its model has no learned force of the environment; fit a kernel "
            "or neural model"
        )
    if run.posterior is not None:
        return run.posterior
    return laplace_posterior(model, run.data, learned_part)


def _metrics(discovery: Discovery) -> DiscoveryMetrics:
    return DiscoveryMetrics.of(
        discovery,
        laws=tuple(
            LawRow.of(law, num_constants=len(law.constants), outcome=str(law.outcome))
            for law in discovery.candidates
        ),
        central=CentralRow.of(discovery.central),
        noise=discovery.learned_noise,
    )


def ranking(metrics: DiscoveryMetrics) -> Table:
    """The refitted laws, the best one first."""
    columns: dict[str, Callable[[LawRow], Cell]] = {
        "law": lambda law: law.name,
        "constants": lambda law: law.num_constants,
        "ΔBIC": lambda law: law.delta_bic,
        "noise": lambda law: law.noise,
        "refit": lambda law: law.outcome,
        "explains the data": lambda law: "yes" if law.fits else "no",
        "extends the best": lambda law: "yes" if law.extends_best else "no",
    }
    caption = (
        "Candidate laws refitted to the trajectories. A law that extends the best one "
        "has it as a special case, and is no rival of it."
    )
    return Table.of(metrics.laws, columns, caption)


def text(metrics: DiscoveryMetrics) -> str:
    """The ranking and the constants of the close laws, for a terminal."""
    lines = [as_text(ranking(metrics))]
    for law in metrics.close_laws:
        lines.append(f"\n{law.name}: force {law.sympy}")
        lines += [f"  {constant.text()}" for constant in law.constants]
    return "\n".join([*lines, "", *metrics.sentences()])


def run(options: DiscoverOptions) -> CommandResult:
    """Find laws as the command line does."""
    metrics = discover(options.run, options.refits)
    return CommandResult(metrics, text(metrics), RunFolder.open(options.run))
