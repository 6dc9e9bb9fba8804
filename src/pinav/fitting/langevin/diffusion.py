r"""What a diffusion coefficient may be, and the thermal motion that a fit learns.

$\log D(x) = m_g + \sum_j w_{gj}\phi_j(x)$, one process for each group g of axes, with
the exposure and the error of the observation of these axes.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pinav.errors import InputError
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.langevin.increments import (
    Increments,
    LearnedObservation,
    ObservedAxes,
)
from pinav.forces import KernelAxis, KernelBasis, KernelTensor, check_groups
from pinav.systems import Observation

Groups = tuple[tuple[int, ...], ...]
"""The axes of each process."""


class ConstantDiffusion(eqx.Module):
    """Diffusion that is the same everywhere; a number for each group of axes.

    Attributes:
        groups: the axes that share a number, such as ((0, 1), (2,)); all unless given.

    Raises:
        InputError: an axis belongs to no group, or to two.
    """

    groups: Groups | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if self.groups is not None:
            check_groups("ConstantDiffusion.groups", self.groups)


class KernelDiffusion(eqx.Module):
    r"""Diffusion that varies: $\log D$ of each group of axes is a process of its own.

    Attributes:
        axes: the coordinates on which it depends, each with its period or warp.
        groups: the axes that share a process, such as ((0, 1), (2,)) above a wall; all
            unless given.
        across: kernels across the data along each of `axes`.

    Raises:
        InputError: there are no axes, or an axis belongs to no group, or to two.
    """

    axes: tuple[KernelAxis, ...]
    groups: Groups | None = eqx.field(static=True, default=None)
    across: int = eqx.field(static=True, default=24)

    def __check_init__(self) -> None:
        if not self.axes:
            raise InputError(
                "KernelDiffusion.axes: expected one or more KernelAxis, got none; for "
                "a diffusion that is the same everywhere take ConstantDiffusion"
            )
        if self.groups is not None:
            check_groups("KernelDiffusion.groups", self.groups)


class ThermalMotion(eqx.Module):
    r"""Diffusion and observation, as functions of numbers of order one.

    Attributes:
        log_odds: of the exposure as a share of the interval, for each group.
        log_errors: logarithm of the variance of the error over its unit.
        units: of the variances of errors: $D\tau$ at the start [L²].
    """

    diffusion: KernelTensor
    log_odds: Float[Array, " group"]
    log_errors: Float[Array, " group"]
    interval: float
    units: Float[Array, " group"]
    known: Observation | None = None

    @property
    def exposures(self) -> Float[Array, " group"]:
        """Exposure T of each group [T]."""
        if self.known is not None:
            return jnp.full_like(self.units, self.known.exposure)
        return self.interval * jax.nn.sigmoid(self.log_odds)

    @property
    def variances(self) -> Float[Array, " group"]:
        """Variance of the error of each group [L²]."""
        if self.known is not None:
            return jnp.full_like(self.units, self.known.noise**2)
        return self.units * jnp.exp(self.log_errors)


Diffusion = float | ConstantDiffusion | KernelDiffusion
"""A known number, or what is to be learned."""


def begin_motion(
    diffusion: Diffusion,
    observation: Observation | LearnedObservation | None,
    increments: Increments,
) -> ThermalMotion:
    r"""Thermal motion at the start of a fit: constant, from moments.

    $(\tfrac12\langle\Delta^2\rangle + \langle\Delta\Delta'\rangle)/\tau$ gives D
    whatever blur and error are.

    Args:
        observation: what is known of it; exact positions unless given.
    """
    dim = increments.steps.shape[1]
    groups = None if isinstance(diffusion, float | int) else diffusion.groups
    groups = (tuple(range(dim)),) if groups is None else groups
    if sum(map(len, groups)) != dim:
        raise InputError(
            f"diffusion groups: expected each of {dim} axes once, got {groups}"
        )
    basis = KernelBasis.constant()
    if isinstance(diffusion, KernelDiffusion):
        basis = KernelBasis.around(
            diffusion.axes, increments.positions, across=diffusion.across
        )
    moments = diffusion_moments(increments)
    levels = np.array([np.log(moments[list(axes)].mean()) for axes in groups])
    if isinstance(diffusion, float | int):
        levels = np.full(1, np.log(diffusion))
    interval = float(np.median(increments.intervals))
    learned = observation if isinstance(observation, LearnedObservation) else None
    error = np.log(1.0 if learned is None else learned.error)
    known = Observation() if observation is None else observation
    return ThermalMotion(
        diffusion=KernelTensor(
            jnp.asarray(levels),
            jnp.zeros((len(groups), len(basis.centers))),
            basis,
            groups,
        ),
        log_odds=jnp.zeros(len(groups)),
        log_errors=jnp.full(len(groups), error),
        interval=interval,
        units=jnp.asarray(np.exp(levels) * interval),
        known=known if isinstance(known, Observation) else None,
    )


def diffusion_moments(increments: Increments) -> Float[np.ndarray, " dim"]:
    """Diffusion of each axis from increments and their neighbours [L² T⁻¹]."""
    steps, total = increments.steps, increments.intervals.sum()
    last = np.cumsum(increments.counts) - 1
    follows = np.ones(len(steps), bool)
    follows[last[last >= 0]] = False
    pairs = (steps[:-1] * steps[1:])[follows[:-1]].sum(axis=0)
    plain = 0.5 * (steps**2).sum(axis=0)
    # Where errors outweigh the motion, chance makes the difference small or negative.
    return np.maximum(plain + pairs, 0.05 * plain) / total


class DiffusionField(eqx.Module):
    """A learned diffusion and its band.

    Attributes:
        tensor: D [L² T⁻¹], along the axes of each group.
        covariance: of the logarithm's level and weights, group after group: all
            levels, then all weights.
    """

    tensor: KernelTensor
    covariance: Float[np.ndarray, "parameter parameter"]

    def __call__(self, positions: ArrayLike) -> Float[np.ndarray, "point axis"]:
        """Diffusion along each axis [L² T⁻¹]."""
        with jax.enable_x64(new_val=True):
            points = jnp.asarray(positions, jnp.float64)
            return np.asarray(jax.vmap(self.tensor.diagonal)(points))

    def log_sd(self, positions: ArrayLike) -> Float[np.ndarray, "point axis"]:
        """Standard deviation of the logarithm: of D, relative to D."""
        with jax.enable_x64(new_val=True):
            points = jnp.asarray(positions, jnp.float64)
            values = np.asarray(jax.vmap(self.tensor.basis)(points))
        count, kernels = self.tensor.weights.shape
        columns = np.hstack([np.ones((len(values), 1)), values])
        spreads = []
        for group in range(count):
            first = count + group * kernels
            entries = np.array([group, *range(first, first + kernels)])
            block = self.covariance[np.ix_(entries, entries)]
            spreads.append(((columns @ block) * columns).sum(axis=1))
        sds = np.sqrt(np.maximum(np.stack(spreads, axis=1), 0.0))
        return sds[:, self.tensor.group_of_axis]

    def sd(self, positions: ArrayLike) -> Float[np.ndarray, "point axis"]:
        """Standard deviation of the diffusion along each axis [L² T⁻¹]."""
        return self(positions) * self.log_sd(positions)

    def samples(self, count: int, seed: int = 0) -> list[KernelTensor]:
        """Diffusions drawn from the posterior."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = np.random.default_rng(seed).normal(size=(count, len(root)))
        draws, tensor = normal @ root.T, self.tensor
        groups = len(tensor.levels)
        return [
            dataclasses.replace(
                tensor,
                levels=tensor.levels + draw[:groups],
                weights=tensor.weights + draw[groups:].reshape(tensor.weights.shape),
            )
            for draw in draws
        ]

    def estimates(self) -> tuple[Estimate, ...]:
        """The number of each group where diffusion is the same everywhere."""
        values = np.exp(np.asarray(self.tensor.levels))
        sds = np.sqrt(np.diag(self.covariance))[: len(values)] * values
        return tuple(
            Estimate(float(value), float(sd))
            for value, sd in zip(values, sds, strict=True)
        )


def observed_axes(
    motion: ThermalMotion,
    odds_sd: Float[np.ndarray, " group"],
    errors_sd: Float[np.ndarray, " group"],
) -> tuple[ObservedAxes, ...]:
    """The observation of each group with its deviations.

    Args:
        odds_sd: deviations of `log_odds`; zero where the observation is known.
        errors_sd: those of `log_errors`.
    """
    exposures, variances = np.asarray(motion.exposures), np.asarray(motion.variances)
    return tuple(
        ObservedAxes(
            axes=axes,
            exposure=Estimate(
                float(exposures[g]),
                float(odds_sd[g] * exposures[g] * (1 - exposures[g] / motion.interval)),
            ),
            error=Estimate(
                float(np.sqrt(variances[g])),
                float(0.5 * errors_sd[g] * np.sqrt(variances[g])),
            ),
            interval=motion.interval,
        )
        for g, axes in enumerate(motion.diffusion.groups)
    )
