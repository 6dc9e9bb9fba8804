"""The fit of thermal motion, and the checks that a run keeps of it."""

import dataclasses
from typing import Any

import msgspec
import numpy as np

from pinav.commands.cells import EstimateRow, Row
from pinav.commands.fit.plan import FitPlan
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    LangevinFit,
    LearnedObservation,
    fit_langevin,
    judge_increments,
)
from pinav.report import number
from pinav.runs import RunFolder

CHECKS_FILE = "checks.json"


class ThinnedRow(Row, frozen=True):
    """Diffusion learned from every so many samples.

    Attributes:
        every: which samples were taken.
        ratio: to the diffusion of all samples.
    """

    every: int
    ratio: EstimateRow


class ThermalRow(msgspec.Struct, frozen=True):
    r"""What a run keeps of the checks of thermal motion.

    Attributes:
        correlations: of the innovations along each channel, 1, 2, ... samples apart.
        limit: $2/\sqrt N$, within which those of independent innovations lie.
        thinned: the diffusion of thinned data.
        exposure: share of the interval over which positions are averaged.
        error: of a position, relative to a step by diffusion, $\sqrt{2 D \tau}$.
        statement: whether the fit explains the increments.
    """

    correlations: dict[str, tuple[float, ...]]
    limit: float
    thinned: tuple[ThinnedRow, ...]
    exposure: EstimateRow
    error: EstimateRow
    statement: str

    @classmethod
    def of(cls, fit: LangevinFit, channels: tuple[str, ...]) -> "ThermalRow | None":
        """The row of a fit; None where positions count as exact.

        Args:
            fit: with one diffusion and one observation for all channels.
            channels: names of the positions.
        """
        checks = fit.checks
        if checks is None:
            return None
        (observed,) = fit.observation
        step = float(np.sqrt(2 * fit.constants["diffusion"].value * observed.interval))
        return cls(
            correlations={
                name: tuple(map(float, column))
                for name, column in zip(channels, checks.correlations.T, strict=True)
            },
            limit=checks.band,
            thinned=tuple(
                ThinnedRow(one.every, EstimateRow.of(one.ratio))
                for one in checks.thinned
            ),
            exposure=_relative(observed.exposure, observed.interval),
            error=_relative(observed.error, step),
            statement=checks.statement,
        )

    def text(self) -> str:
        """The checks for a terminal."""
        columns = "; ".join(
            f"{name} {' '.join(f'{value:+.3f}' for value in values)}"
            for name, values in self.correlations.items()
        )
        lags = len(next(iter(self.correlations.values())))
        lines = [
            f"exposure: {_words(self.exposure)} of the interval; error: "
            f"{_words(self.error)} of a step",
            f"innovations 1 to {lags} samples apart correlate by {columns} "
            f"(independent ones within {self.limit:.3f})",
            *(
                f"diffusion of every {one.every} samples: {_words(one.ratio)} of that "
                "of all"
                for one in self.thinned
            ),
        ]
        return "\n".join([*lines, self.statement])


def _relative(estimate: Estimate, unit: float) -> EstimateRow:
    return EstimateRow(estimate.value / unit, estimate.sd / unit)


def _words(row: EstimateRow) -> str:
    return f"{number(row.value, 3)} ± {number(row.sd, 2)} (sd)"


def fit_thermal(plan: FitPlan, model: Any, folder: RunFolder) -> EvidenceFit:
    """Fit thermal motion, and write its checks where there are any.

    The residuals are those of steps, whatever the observation is, so that the noise of
    the run is that of a step in unit time.

    Args:
        plan: of the fit.
        model: untrained, of the system's known mobility.
        folder: of the run.
    """
    if plan.settings.observation == "exact":
        return fit_langevin(model, plan.data).regression
    # The mobility of the system is known: the diffusion is a number beside it.
    observed = LearnedObservation()
    thermal = fit_langevin(model, plan.data, observation=observed, einstein=False)
    checks = ThermalRow.of(thermal, plan.data.channels)
    if checks is not None:
        folder.write_metrics(CHECKS_FILE, checks)
    regression = thermal.regression
    noise = float(np.sqrt(2 * regression.constants["diffusion"].value))
    chosen = dataclasses.replace(regression.hyperparameters, noise=noise)
    return dataclasses.replace(regression, hyperparameters=chosen)


def read_checks(folder: RunFolder) -> ThermalRow | None:
    """The checks of a thermal fit; None where it has none.

    Raises:
        InputError: the file is damaged.
    """
    if not folder.has(CHECKS_FILE):
        return None
    return folder.read_metrics(CHECKS_FILE, ThermalRow)


def thermal_remarks(plan: FitPlan) -> tuple[str, ...]:
    """What the increments say where a thermal fit counts positions as exact."""
    if plan.settings.recipe != "langevin" or plan.settings.observation == "learn":
        return ()
    verdict = judge_increments(plan.data)
    if verdict.is_exact or not verdict.is_thermal:
        return ()
    return (f"{verdict.statement} Add --observation learn.",)
