"""The fit of thermal motion, and what a run keeps of it."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.evaluation import line_through
from pinav.fitting import (
    DiffusionField,
    Estimate,
    EvidenceFit,
    LangevinChecks,
    LangevinFit,
    ReferencePath,
    fit_langevin,
    judge_increments,
)
from pinav.learning.thermal_choice import ThermalChoice
from pinav.systems import System
from pinav.trajectories import Trajectories


@dataclasses.dataclass(frozen=True)
class ObservedDiffusion:
    r"""What a fit says of diffusion and camera along some channels.

    Attributes:
        channels: that share them.
        diffusion: mean over the data [L² T⁻¹].
        low: diffusion below which a twentieth of the data lies.
        high: diffusion above which a twentieth of the data lies.
        exposure: share of the interval over which positions are averaged; None where
            positions are exact.
        error: of a position, relative to a step by diffusion, $\sqrt{2 D \tau}$.
    """

    channels: tuple[str, ...]
    diffusion: Estimate
    low: float
    high: float
    exposure: Estimate | None = None
    error: Estimate | None = None


@dataclasses.dataclass(frozen=True)
class DiffusionLine:
    """The diffusion along a line through the middle of the data.

    Attributes:
        places: along the coordinate axis [L].
        values: along each axis [L² T⁻¹].
        sd: their standard deviations.
    """

    places: Float[np.ndarray, " place"]
    values: Float[np.ndarray, "place axis"]
    sd: Float[np.ndarray, "place axis"]


@dataclasses.dataclass(frozen=True)
class ThermalFindings:
    """Diffusion and camera of thermal motion, and its checks.

    Attributes:
        channels: the coordinates.
        checks: of the innovations, and the diffusion of thinned data.
        observed: diffusion and camera along each group of channels.
        lines: diffusion along lines through the data, by the coordinate; none where it
            is the same everywhere.
        reference: the path of a reference that drifts.
        einstein: the mobility follows from the diffusion.
    """

    DERIVED = ("statement",)

    channels: tuple[str, ...]
    checks: LangevinChecks
    observed: tuple[ObservedDiffusion, ...]
    lines: dict[str, DiffusionLine]
    reference: ReferencePath | None = None
    einstein: bool = False

    @classmethod
    def of(
        cls, fit: LangevinFit, chosen: ThermalChoice, data: Trajectories
    ) -> "ThermalFindings | None":
        """Those of a fit; None where nothing was checked.

        Args:
            fit: of the data.
            chosen: what was learned.
            data: their channels are the positions.
        """
        if fit.checks is None:
            return None
        return cls(
            channels=data.channels,
            checks=fit.checks,
            observed=observed_diffusion(fit, data),
            lines=_diffusion_lines(fit, chosen, data),
            reference=fit.reference,
            einstein=fit.thermal_energy is not None,
        )

    @property
    def statement(self) -> str:
        """A sentence on whether the fit explains the increments."""
        return self.checks.statement

    def named(self, axes: tuple[int, ...]) -> tuple[str, ...]:
        """The channels of some axes."""
        return tuple(self.channels[axis] for axis in axes)


def observed_diffusion(
    fit: LangevinFit, data: Trajectories
) -> tuple[ObservedDiffusion, ...]:
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
        mean = Estimate(float(one.mean()), float(draws[:, axes[0]].std()))
        exposure = error = None
        if fit.observation:
            seen = fit.observation[index]
            step = float(np.sqrt(2 * one.mean() * seen.interval))
            exposure = _relative(seen.exposure, seen.interval)
            error = _relative(seen.error, step)
        low, high = np.quantile(one, [0.05, 0.95])
        names = tuple(data.channels[axis] for axis in axes)
        rows.append(
            ObservedDiffusion(names, mean, float(low), float(high), exposure, error)
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


def _relative(estimate: Estimate, unit: float) -> Estimate:
    return Estimate(estimate.value / unit, estimate.sd / unit)


def fit_thermal(
    chosen: ThermalChoice, model: Any, system: System, data: Trajectories
) -> tuple[EvidenceFit, ThermalFindings | None]:
    """The fit of thermal motion, and what else it says.

    The residuals are those of steps, whatever the observation is, so that the noise of
    the fit is that of a step in unit time.

    Args:
        chosen: what may be learned.
        model: untrained; its mobility is known unless it follows from the diffusion.
        system: the known physics.
        data: the trajectories.
    """
    if chosen.is_plain:
        return fit_langevin(model, data).regression, None
    if chosen.einstein:
        model = system.with_noise_of(model)
    thermal = fit_langevin(
        model,
        data,
        diffusion=chosen.diffusion,
        observation=chosen.observation,
        einstein=chosen.einstein,
        reference=chosen.reference,
    )
    findings = ThermalFindings.of(thermal, chosen, data)
    assert findings is not None  # made wherever positions are not exact
    regression = thermal.regression
    mean = _mean_diffusion(findings)
    numbers = dataclasses.replace(
        regression.hyperparameters, noise=float(np.sqrt(2 * mean.value))
    )
    fit = dataclasses.replace(
        regression,
        hyperparameters=numbers,
        constants=regression.constants | {"diffusion": mean},
    )
    return fit, findings


def _mean_diffusion(findings: ThermalFindings) -> Estimate:
    """Diffusion over all data and axes."""
    rows = [(len(one.channels), one.diffusion) for one in findings.observed]
    total = sum(count for count, _ in rows)
    value = sum(count * row.value for count, row in rows) / total
    variance = sum((count * row.sd / total) ** 2 for count, row in rows)
    return Estimate(value, float(np.sqrt(variance)))


def _diffusion_lines(
    fit: LangevinFit, chosen: ThermalChoice, data: Trajectories
) -> dict[str, DiffusionLine]:
    if not isinstance(fit.diffusion, DiffusionField):
        return {}
    places, lines = diffusion_places(fit, data), {}
    for axis in chosen.axes:
        points = line_through(places, axis.index)
        lines[data.channels[axis.index]] = DiffusionLine(
            points[:, axis.index], fit.diffusion(points), fit.diffusion.sd(points)
        )
    return lines


def thermal_remarks(
    chosen: ThermalChoice | None, data: Trajectories
) -> tuple[str, ...]:
    """What the increments say where a thermal fit counts positions as exact."""
    if chosen is None or chosen.observation is not None:
        return ()
    verdict = judge_increments(data)
    if verdict.is_exact or not verdict.is_thermal:
        return ()
    return (f"{verdict.statement} Add --observation learn.",)
