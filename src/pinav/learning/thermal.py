"""The fit of thermal motion: its choices, and what a run keeps of it."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.evaluation import line_through
from pinav.fitting import (
    ConstantDiffusion,
    DiffusionField,
    Estimate,
    EvidenceFit,
    KernelDiffusion,
    LangevinChecks,
    LearnedObservation,
    ReferencePath,
    SlowReference,
    ThermalResult,
    fit_langevin,
    judge_increments,
    profile_environment,
    slow_reference,
    warp_at_slow_end,
)
from pinav.forces import KernelAxis, KernelProfile
from pinav.learning.recipes import Langevin
from pinav.settings import split_period
from pinav.systems import Observation, System
from pinav.trajectories import Trajectories

ACROSS = {1: 24, 2: 8}
"""Kernels across the data along each of so many coordinates."""


@dataclasses.dataclass(frozen=True)
class ThermalChoice:
    """Quantities of thermal motion that a fit may learn.

    Attributes:
        diffusion: what it may be; None for one number.
        observation: what is known of the camera; None counts positions as exact.
        reference: the coordinate that drifts, if one does.
        einstein: True if the mobility follows from the diffusion.
    """

    axes: tuple[KernelAxis, ...]
    diffusion: ConstantDiffusion | KernelDiffusion | None
    observation: Observation | LearnedObservation | None
    reference: SlowReference | None
    einstein: bool

    @classmethod
    def of(
        cls, recipe: Langevin, system: System, data: Trajectories
    ) -> "ThermalChoice":
        """The choice of a recipe; InputError where it contradicts the system."""
        axes = _axes(recipe, system, data)
        varies = recipe.diffusion != "constant"
        diffusion = None
        if varies:
            diffusion = _fields(recipe, axes, system)
        elif recipe.period:
            diffusion = ConstantDiffusion()  # where increments find the short way round
        reference = None
        if recipe.reference is not None:
            reference = _reference(recipe, system, axes, data)
        heat = system.thermal_energy
        return cls(
            axes=axes,
            diffusion=diffusion,
            observation=_observation(recipe, system),
            reference=reference,
            einstein=varies and heat is not None and float(heat) > 0,
        )

    def profile(self, data: Trajectories) -> KernelProfile:
        """The untrained force along the coordinates, on which alone it depends."""
        across = ACROSS.get(len(self.axes), min(ACROSS.values()))
        return profile_environment(data, self.axes, across=across)


def _axes(
    recipe: Langevin, system: System, data: Trajectories
) -> tuple[KernelAxis, ...]:
    channels = system.position_channels
    periods: dict[str, float] = {}
    for text in recipe.period:
        name, period = split_period(text)
        if name in periods:
            raise InputError(
                f"--period: expected one for each coordinate, {name} twice"
            )
        periods[name] = period
    named = recipe.coordinates or channels
    for option, names in (
        ("coordinates", named),
        ("period", periods),
        ("warp", recipe.warp),
    ):
        _check_names(option, tuple(names), system)
        if outside := [name for name in names if name not in named]:
            raise InputError(
                f"--{option} {outside[0]}: fields depend on {', '.join(named)} alone; "
                "name it in --coordinates, too"
            )
    if both := sorted(set(periods) & set(recipe.warp)):
        raise InputError(
            f"--warp {both[0]}: a coordinate that repeats has no slow end; drop its "
            "--period or its --warp"
        )
    axes = []
    for name in (one for one in channels if one in named):
        index = channels.index(name)
        warp = warp_at_slow_end(data, index) if name in recipe.warp else None
        axes.append(KernelAxis(index, periods.get(name), warp))
    return tuple(axes)


def _check_names(option: str, names: tuple[str, ...], system: System) -> None:
    channels = system.position_channels
    for name in names:
        if name not in channels:
            raise InputError(
                f"--{option}: expected coordinates of system {system.name}, "
                f"{', '.join(channels)}; got {name}"
            )
    if len(set(names)) < len(names):
        raise InputError(f"--{option}: expected each coordinate once, got {names}")


def _fields(
    recipe: Langevin, axes: tuple[KernelAxis, ...], system: System
) -> KernelDiffusion:
    """One field of log D, or one along each coordinate and one along all others."""
    if len(axes) not in ACROSS:
        raise InputError(
            f"--diffusion {recipe.diffusion}: expected one or two coordinates on "
            f"which it depends, got {', '.join(system.position_channels)}; name them, "
            "such as --coordinates z"
        )
    groups = None
    if recipe.diffusion == "tensor":
        named = [axis.index for axis in axes]
        others = tuple(index for index in range(system.dim) if index not in named)
        groups = (*((others,) if others else ()), *((index,) for index in named))
        if len(groups) < 2:
            raise InputError(
                "--diffusion tensor: one coordinate has no directions; choose "
                "--diffusion field"
            )
    return KernelDiffusion(axes, groups, ACROSS[len(axes)])


def _observation(
    recipe: Langevin, system: System
) -> Observation | LearnedObservation | None:
    if recipe.observation == "learn":
        return LearnedObservation()
    if recipe.observation == "exact":
        return None
    stated = system.observation
    if stated.noise == 0 and stated.exposure == 0:
        raise InputError(
            f"--observation known: system {system.name} states neither noise nor "
            "exposure; state them in [observation], or choose --observation learn"
        )
    return stated


def _reference(
    recipe: Langevin, system: System, axes: tuple[KernelAxis, ...], data: Trajectories
) -> SlowReference:
    name = str(recipe.reference)
    _check_names("reference", (name,), system)
    index = system.position_channels.index(name)
    if index not in [axis.index for axis in axes]:
        raise InputError(
            f"--reference {name}: force and diffusion do not depend on {name}, so that "
            "nothing shows its drift; name it in --coordinates, too"
        )
    return slow_reference(data, index)


@dataclasses.dataclass(frozen=True)
class ObservedDiffusion:
    r"""Diffusion and camera along some channels, as a fit found them.

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
    """The diffusion along each axis [L² T⁻¹], on a line through the data."""

    places: Float[np.ndarray, " place"]
    values: Float[np.ndarray, "place axis"]
    sd: Float[np.ndarray, "place axis"]


@dataclasses.dataclass(frozen=True)
class ThermalFindings:
    """Diffusion and camera of thermal motion, and its checks.

    Attributes:
        lines: diffusion along lines through the data, by the coordinate; none where it
            is the same everywhere.
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
        cls, fit: ThermalResult, chosen: ThermalChoice, data: Trajectories
    ) -> "ThermalFindings":
        """The findings of a fit of which more than one number is asked."""
        assert fit.checks is not None  # made wherever positions are not exact
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
    fit: ThermalResult, data: Trajectories
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
    fit: ThermalResult, data: Trajectories
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
) -> tuple[EvidenceFit, ThermalFindings]:
    """The fit of thermal motion, and what else it says.

    The residuals are those of steps, whatever the observation is, so that the noise of
    the fit is that of a step in unit time.
    """
    if chosen.einstein:
        model = system.with_noise_of(model)
    fit = fit_langevin(
        model,
        data,
        diffusion=chosen.diffusion,
        observation=chosen.observation,
        einstein=chosen.einstein,
        reference=chosen.reference,
    )
    findings = ThermalFindings.of(fit.thermal, chosen, data)
    mean = _mean_diffusion(findings)
    numbers = dataclasses.replace(
        fit.hyperparameters, noise=float(np.sqrt(2 * mean.value))
    )
    constants = fit.constants | {"diffusion": mean}
    fit = dataclasses.replace(fit, hyperparameters=numbers, constants=constants)
    return fit, findings


def _mean_diffusion(findings: ThermalFindings) -> Estimate:
    rows = [(len(one.channels), one.diffusion) for one in findings.observed]
    total = sum(count for count, _ in rows)
    value = sum(count * row.value for count, row in rows) / total
    variance = sum((count * row.sd / total) ** 2 for count, row in rows)
    return Estimate(value, float(np.sqrt(variance)))


def _diffusion_lines(
    fit: ThermalResult, chosen: ThermalChoice, data: Trajectories
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
    """Remarks on increments where a thermal fit counts positions as exact."""
    if chosen is None or chosen.observation is not None:
        return ()
    verdict = judge_increments(data)
    if verdict.is_exact or not verdict.is_thermal:
        return ()
    return (f"{verdict.statement} Add --observation learn.",)
