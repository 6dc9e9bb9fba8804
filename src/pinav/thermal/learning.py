r"""Learning perfusion, or what heats, from sparse noisy probes.

A universal differential equation: conduction, blood and field are known, a law is not.
Gauss-Newton steps, hyperparameters by the evidence and the Laplace posterior are those
of `pinav.fitting`; only the residuals are thermal.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from pinav.errors import InputError
from pinav.fitting import EvidenceFit
from pinav.fitting.bayes.parameters import derive
from pinav.fitting.engine.posterior import Posterior
from pinav.fitting.engine.problem import ShortenedStep
from pinav.fitting.least_squares import fit_regression
from pinav.forces import IsotropicPrior
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.learned_perfusion import AbstractLearnedPerfusion
from pinav.thermal.probes import ProbeData
from pinav.thermal.protocols import AbstractProtocol, Schedule, plan_steps
from pinav.thermal.quantities import Field, Number, Numbers
from pinav.thermal.rosenbrock import refuse_jumps
from pinav.thermal.solve import Observe, default_stepper, probes_at, run, solve
from pinav.thermal.starts import AT_REST, AbstractStart
from pinav.thermal.steppers import AbstractStepper
from pinav.thermal.thermometry import (
    Thermometry,
    ThermometryResiduals,
    thermometry_residuals,
)

Laws = Callable[[Any], tuple[AbstractLearnedPerfusion, ...]]
"""Picks the laws to be learned from a model."""


class ProbeResiduals(eqx.Module):
    """Predicted less read temperatures [K], as a function of the model.

    Attributes:
        protocol: the field.
        schedule: time steps, which end at the readings.
        stepper: how time advances.
        probes: where temperatures are read.
        values: the readings there are [°C].
        index: their places among all times and probes.
        start: where the run begins; a steady state follows the model.
        num_projected: none, for nothing is taken away.
    """

    protocol: AbstractProtocol
    schedule: Schedule
    stepper: AbstractStepper
    probes: Observe
    values: Float[Array, " reading"]
    index: Int[Array, " reading"]
    start: AbstractStart = AT_REST
    num_projected: int = 0

    def __call__(self, model: Bioheat) -> Float[Array, " reading"]:
        """The residuals of a model."""
        solution = run(
            model,
            self.protocol,
            self.schedule,
            stepper=self.stepper,
            observe=self.probes,
            start=self.start,
        )
        return solution.observed.reshape(-1)[self.index] - self.values


def probe_residuals(
    model: Bioheat,
    protocol: AbstractProtocol,
    data: ProbeData,
    *,
    stepper: AbstractStepper | None = None,
    start: AbstractStart = AT_REST,
) -> ProbeResiduals:
    """The residuals of models like `model`.

    Raises:
        InputError: a probe is outside the grid, or a reading after the protocol.
    """
    axes, columns = len(model.grid.shape), data.points.shape[1]
    if columns != axes:
        names = "t, r, T" if axes == 1 else ", ".join(("t", *"xyz"[:axes], "T"))
        raise InputError(
            f"readings: expected places with {axes} coordinates (columns {names}) for "
            f"this grid, got {columns}"
        )
    stepper = default_stepper(model) if stepper is None else stepper
    longest = stepper.longest_step(model)
    return ProbeResiduals(
        protocol=protocol,
        schedule=plan_steps(protocol, longest, save_at=data.times.tolist()),
        stepper=stepper,
        probes=probes_at(model, data.points),
        values=jnp.asarray(data.values[data.observed]),
        index=jnp.asarray(np.flatnonzero(data.observed)),
        start=start,
    )


def read_residuals(
    model: Bioheat,
    protocol: AbstractProtocol,
    data: ProbeData | Thermometry,
    *,
    stepper: AbstractStepper,
    start: AbstractStart = AT_REST,
) -> ProbeResiduals | ThermometryResiduals:
    """The residuals of models like `model`, whatever the thermometer.

    Raises:
        InputError: the readings do not fit the grid or the protocol.
    """
    options = {"stepper": stepper, "start": start}
    if isinstance(data, Thermometry):
        return thermometry_residuals(model, protocol, data, **options)
    return probe_residuals(model, protocol, data, **options)


def learn(
    model: Bioheat,
    protocol: AbstractProtocol,
    data: ProbeData | Thermometry,
    *,
    laws: Laws = lambda _: (),
    constants: Callable[[Any], PyTree] = lambda _: (),
    noise: Number | None = None,
    stepper: AbstractStepper | None = None,
    start: AbstractStart = AT_REST,
    max_iterations: int = 40,
    throw: bool = True,
) -> EvidenceFit:
    """Fit laws of perfusion, and constants, to readings of probes or of voxels.

    Args:
        model: where the fit starts; what is not picked stays as it is.
        protocol: the field while the readings were taken, best with steps of power:
            at steady state a scale of the power cannot be told from perfusion.
        data: the readings.
        laws: picks learned perfusions, such as `lambda m: (m.perfusion.outside,)`.
        constants: picks numbers to learn, such as `lambda m: m.sources[0].scale`.
        noise: standard deviation of a reading [K], of voxels in units of their map;
            estimated unless given.
        stepper: as of `solve`.
        start: as of `solve`.
        max_iterations: after which the fit counts as stalled.
        throw: raise where the fit did not converge.

    Raises:
        InputError: nothing is picked, the data do not fit the grid or the protocol, or
            a law of perfusion jumps.
        FitError: the fit did not converge, and `throw` is true.
    """

    def weights(candidate: Any) -> PyTree:
        return tuple(law.weights for law in laws(candidate))

    def flat(candidate: Any) -> PyTree:
        return tuple(law.log_level for law in laws(candidate)), constants(candidate)

    refuse_jumps(model)
    leaves = jax.tree.leaves(eqx.filter(weights(model), eqx.is_inexact_array))
    count = sum(leaf.size for leaf in leaves)
    stepper = default_stepper(model) if stepper is None else stepper
    residuals = read_residuals(model, protocol, data, stepper=stepper, start=start)
    return fit_regression(
        model,
        residuals,
        weights=weights,
        prior=IsotropicPrior(count) if count else None,
        constants=flat,
        scale=data.spread,
        noise=noise,
        # nats of log evidence: half of one moves a law by little of its band
        tolerance=0.5 if count else 1e-2,
        max_iterations=max_iterations,
        num_projected=residuals.num_projected,
        # so many voxels leave little doubt where to step, and a run costs a tenth of a
        # Jacobian
        step_rule=ShortenedStep(corrections=6)
        if isinstance(data, Thermometry)
        else None,
        throw=throw,
    )


class PerfusionCurve(eqx.Module):
    """A learned law with its band, and where it was visited.

    Attributes:
        temperatures: [°C].
        values: perfusion there [kg m⁻³ s⁻¹].
        sd: standard deviation of its logarithm.
        visited: lowest and highest temperature [°C] of its tissue during the fit.
        true: true law at these temperatures [kg m⁻³ s⁻¹], where it is known.
    """

    DERIVED = ("covered",)

    temperatures: Float[np.ndarray, " temperature"]
    values: Float[np.ndarray, " temperature"]
    sd: Float[np.ndarray, " temperature"]
    visited: tuple[float, float]
    true: Float[np.ndarray, " temperature"] | None = None

    @property
    def covered(self) -> float | None:
        """Fraction of the visited temperatures with the truth in the band."""
        if self.true is None:
            return None
        low, high = self.band
        return float(((self.true >= low) & (self.true <= high))[self.inside].mean())

    @property
    def band(self) -> Float[np.ndarray, "2 temperature"]:
        """Bounds between which the law lies with a nominal probability of 95 %."""
        return self.values * np.exp(1.96 * np.array([[-1.0], [1.0]]) * self.sd)

    @property
    def inside(self) -> np.ndarray:
        """Marks the temperatures that were visited; elsewhere nothing is known."""
        low, high = self.visited
        return (self.temperatures >= low) & (self.temperatures <= high)


def perfusion_curve(
    posterior: Posterior,
    law: Callable[[Any], AbstractLearnedPerfusion],
    temperatures: Numbers,
    visited: tuple[float, float],
    true: Float[np.ndarray, " temperature"] | None = None,
) -> PerfusionCurve:
    """A learned law at temperatures, by the delta method on its logarithm.

    Args:
        posterior: of the fit.
        law: picks it from the model.
        temperatures: [°C].
        visited: range [°C] that its tissue went through.
        true: true law at these temperatures, where it is known.
    """
    at = jnp.asarray(temperatures, float)
    estimates = derive(posterior, lambda model: jnp.log(law(model)(at)))
    return PerfusionCurve(
        temperatures=np.asarray(at),
        values=np.exp([estimate.value for estimate in estimates]),
        sd=np.array([estimate.sd for estimate in estimates]),
        visited=visited,
        true=true,
    )


def visited_range(
    model: Bioheat,
    protocol: AbstractProtocol,
    fraction: Field,
    start: AbstractStart = AT_REST,
) -> tuple[float, float]:
    """Lowest and highest temperature [°C] of the cells that a mask holds mostly.

    Args:
        model: run over the protocol.
        protocol: the field.
        fraction: volume fraction of the tissue in each cell.
        start: as of `solve`.
    """
    inside = np.asarray(fraction) > 0.5  # cells cut by the edge would mix two tissues
    hottest = solve(
        model,
        protocol,
        observe=lambda t: jnp.stack(
            [
                jnp.min(jnp.where(inside, t, jnp.inf)),
                jnp.max(jnp.where(inside, t, -jnp.inf)),
            ]
        ),
        save_every=protocol.duration / 180,
        start=start,
    ).observed
    low = min(float(model.blood.arterial), float(hottest[:, 0].min()))
    return low, float(hottest[:, 1].max())
