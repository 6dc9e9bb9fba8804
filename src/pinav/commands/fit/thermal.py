"""The fit of thermal motion, and the checks that a run keeps of it."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from pinav.commands.cells import EstimateRow, Row
from pinav.commands.fit.plan import FitPlan
from pinav.commands.fit.thermal_choice import ThermalChoice
from pinav.evaluation import line_through
from pinav.fitting import (
    DiffusionField,
    Estimate,
    EvidenceFit,
    LangevinFit,
    fit_langevin,
    judge_increments,
)
from pinav.report import number
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories

CHECKS_FILE, FIELDS_FILE = "checks.json", "thermal.npz"


class ThinnedRow(Row, frozen=True):
    """Diffusion learned from every so many samples.

    Attributes:
        every: which samples were taken.
        channels: along which.
        ratio: to the diffusion of all samples.
    """

    every: int
    channels: tuple[str, ...]
    ratio: EstimateRow


class ObservedRow(msgspec.Struct, frozen=True):
    r"""What a fit says of diffusion and camera along some channels.

    Attributes:
        channels: that share them.
        diffusion: mean over the data [L² T⁻¹].
        range: of the diffusion, within which nine tenths of the data lie.
        exposure: share of the interval over which positions are averaged; None where
            positions are exact.
        error: of a position, relative to a step by diffusion, $\sqrt{2 D \tau}$.
    """

    channels: tuple[str, ...]
    diffusion: EstimateRow
    range: tuple[float, float]
    exposure: EstimateRow | None
    error: EstimateRow | None

    def lines(self, *, several: bool) -> list[str]:
        """Sentences for a terminal."""
        along = _along(self.channels, several=several)
        lines = []
        low, high = self.range
        if high > low:
            lines.append(
                f"diffusion{along}: {number(low, 3)} to {number(high, 3)} for nine "
                f"tenths of the data, mean {_words(self.diffusion)}"
            )
        if self.exposure is not None and self.error is not None:
            lines.append(
                f"exposure{along}: {_words(self.exposure)} of the interval; error: "
                f"{_words(self.error)} of a step"
            )
        return lines


class ReferenceRow(msgspec.Struct, frozen=True):
    """The path of a frame of reference.

    Attributes:
        channel: that drifts.
        knots: of the path.
        spread: standard deviation of the path [L].
        sd: standard deviation with which it is known, mean of the knots [L].
    """

    channel: str
    knots: int
    spread: float
    sd: float

    def text(self) -> str:
        """A sentence for a terminal."""
        return (
            f"the zero of {self.channel} drifts by {number(self.spread, 3)} (sd over "
            f"{self.knots} knots, each known to {number(self.sd, 2)})"
        )


class ThermalRow(msgspec.Struct, frozen=True):
    r"""What a run keeps of the checks of thermal motion.

    Attributes:
        correlations: of the innovations along each channel, 1, 2, ... samples apart.
        limit: $2/\sqrt N$, within which those of independent innovations lie.
        thinned: the diffusion of thinned data.
        observed: diffusion and camera along each group of channels.
        statement: whether the fit explains the increments.
        reference: the path of a reference that drifts.
        einstein: whether the mobility follows from the diffusion.
    """

    correlations: dict[str, tuple[float, ...]]
    limit: float
    thinned: tuple[ThinnedRow, ...]
    observed: tuple[ObservedRow, ...]
    statement: str
    reference: ReferenceRow | None = None
    einstein: bool = False

    @classmethod
    def of(cls, fit: LangevinFit, data: Trajectories) -> "ThermalRow | None":
        """The row of a fit; None where nothing was checked.

        Args:
            fit: of the data.
            data: their channels are the positions.
        """
        checks, channels = fit.checks, data.channels
        if checks is None:
            return None
        path = fit.reference
        return cls(
            correlations={
                name: tuple(map(float, column))
                for name, column in zip(channels, checks.correlations.T, strict=True)
            },
            limit=checks.band,
            thinned=tuple(
                ThinnedRow(
                    one.every, _channel_names(one.axes, data), EstimateRow.of(one.ratio)
                )
                for one in checks.thinned
            ),
            observed=observed_rows(fit, data),
            statement=checks.statement,
            reference=None
            if path is None
            else ReferenceRow(
                channels[path.axis],
                len(path.values),
                float(path.values.std()),
                float(path.sd.mean()),
            ),
            einstein=fit.thermal_energy is not None,
        )

    def text(self) -> str:
        """The checks for a terminal."""
        columns = "; ".join(
            f"{name} {' '.join(f'{value:+.3f}' for value in values)}"
            for name, values in self.correlations.items()
        )
        lags = len(next(iter(self.correlations.values())))
        several = len(self.observed) > 1
        lines = [
            *(line for one in self.observed for line in one.lines(several=several)),
            *([] if self.reference is None else [self.reference.text()]),
            f"innovations 1 to {lags} samples apart correlate by {columns} "
            f"(independent ones within {self.limit:.3f})",
            *(
                f"diffusion{_along(one.channels, several=several)} of every "
                f"{one.every} samples: {_words(one.ratio)} of that of all"
                for one in self.thinned
            ),
        ]
        return "\n".join([*lines, self.statement])


def observed_rows(fit: LangevinFit, data: Trajectories) -> tuple[ObservedRow, ...]:
    """Diffusion and camera along each group of channels."""
    places = diffusion_places(fit, data)
    if isinstance(fit.diffusion, DiffusionField):
        groups = fit.diffusion.tensor.groups
        values, draws = fit.diffusion(places), _draws(fit.diffusion, places)
    else:
        groups = (tuple(range(len(data.channels))),)
        values = np.full(places.shape, fit.diffusion.value)
        draws = np.random.default_rng(0).normal(
            fit.diffusion.value, fit.diffusion.sd, (DRAWS, len(data.channels))
        )
    rows = []
    for index, axes in enumerate(map(list, groups)):
        one = values[:, axes[0]]
        mean = EstimateRow(float(one.mean()), float(draws[:, axes[0]].std()))
        exposure = error = None
        if fit.observation:
            seen = fit.observation[index]
            step = float(np.sqrt(2 * one.mean() * seen.interval))
            exposure = _relative(seen.exposure, seen.interval)
            error = _relative(seen.error, step)
        low, high = np.quantile(one, [0.05, 0.95])
        names = tuple(data.channels[axis] for axis in axes)
        rows.append(
            ObservedRow(names, mean, (float(low), float(high)), exposure, error)
        )
    return tuple(rows)


DRAWS = 32
"""Diffusions drawn for the doubt of their mean."""

MOST_PLACES = 1000
"""Samples at most over which a mean is taken."""


def diffusion_places(
    fit: LangevinFit, data: Trajectories
) -> Float[np.ndarray, "place dim"]:
    """Observed positions, from the reference where it drifts; some of many."""
    parts = []
    for piece in data:
        observed = piece.observed.all(axis=1)
        positions = piece.states[observed].copy()
        if fit.reference is not None:
            positions[:, fit.reference.axis] -= fit.reference(piece.times[observed])
        parts.append(positions)
    places = np.concatenate(parts)
    return places[:: max(len(places) // MOST_PLACES, 1)]


def _draws(
    field: DiffusionField, places: Float[np.ndarray, "place dim"]
) -> Float[np.ndarray, "draw dim"]:
    """Mean diffusion over places, of draws from the posterior."""
    points = jnp.asarray(places)
    mean = eqx.filter_jit(lambda one: jax.vmap(one.diagonal)(points).mean(axis=0))
    return np.array([mean(one) for one in field.samples(DRAWS)])


def _channel_names(axes: Sequence[int], data: Trajectories) -> tuple[str, ...]:
    return tuple(data.channels[axis] for axis in axes)


def _along(channels: tuple[str, ...], *, several: bool) -> str:
    return f" along {', '.join(channels)}" if several else ""


def _relative(estimate: Estimate, unit: float) -> EstimateRow:
    return EstimateRow(estimate.value / unit, estimate.sd / unit)


def _words(row: EstimateRow) -> str:
    return f"{number(row.value, 3)} ± {number(row.sd, 2)} (sd)"


def fit_thermal(plan: FitPlan, model: Any, folder: RunFolder) -> EvidenceFit:
    """Fit thermal motion, and write its checks and fields where there are any.

    The residuals are those of steps, whatever the observation is, so that the noise of
    the run is that of a step in unit time.

    Args:
        plan: of the fit.
        model: untrained; its mobility is known unless it follows from the diffusion.
        folder: of the run.
    """
    chosen = plan.thermal
    assert chosen is not None  # planned for this recipe
    if chosen.is_plain:
        return fit_langevin(model, plan.data).regression
    if chosen.einstein:
        model = plan.system.with_noise_of(model)
    thermal = fit_langevin(
        model,
        plan.data,
        diffusion=chosen.diffusion,
        observation=chosen.observation,
        einstein=chosen.einstein,
        reference=chosen.reference,
    )
    checks = ThermalRow.of(thermal, plan.data)
    assert checks is not None  # made wherever positions are not exact
    folder.write_metrics(CHECKS_FILE, checks)
    folder.write_arrays(FIELDS_FILE, thermal_arrays(thermal, chosen, plan.data))
    regression = thermal.regression
    mean = _mean_diffusion(checks)
    chosen_numbers = dataclasses.replace(
        regression.hyperparameters, noise=float(np.sqrt(2 * mean.value))
    )
    return dataclasses.replace(
        regression,
        hyperparameters=chosen_numbers,
        constants=regression.constants | {"diffusion": mean},
    )


def _mean_diffusion(checks: ThermalRow) -> Estimate:
    """Diffusion over all data and axes."""
    rows = [(len(one.channels), one.diffusion) for one in checks.observed]
    total = sum(count for count, _ in rows)
    value = sum(count * float(row.value or 0) for count, row in rows) / total
    variance = sum((count * float(row.sd or 0) / total) ** 2 for count, row in rows)
    return Estimate(value, float(np.sqrt(variance)))


def thermal_arrays(
    fit: LangevinFit, chosen: ThermalChoice, data: Trajectories
) -> dict[str, np.ndarray]:
    """The path of a reference, and the diffusion along lines through the data."""
    arrays = {}
    if fit.reference is not None:
        path = fit.reference
        arrays |= {"reference/times": path.times, "reference/values": path.values}
        arrays["reference/sd"] = path.sd
    if isinstance(fit.diffusion, DiffusionField):
        places = diffusion_places(fit, data)
        for axis in chosen.axes:
            points = line_through(places, axis.index)
            name = f"diffusion/{data.channels[axis.index]}"
            arrays[f"{name}/places"] = points[:, axis.index]
            arrays[f"{name}/values"] = fit.diffusion(points)
            arrays[f"{name}/sd"] = fit.diffusion.sd(points)
    return arrays


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
    if plan.thermal is None or plan.thermal.observation is not None:
        return ()
    verdict = judge_increments(plan.data)
    if verdict.is_exact or not verdict.is_thermal:
        return ()
    return (f"{verdict.statement} Add --observation learn.",)
