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
from pinav.evaluation import normal_quantile
from pinav.fitting import EvidenceFit
from pinav.fitting.bayes.parameters import derive
from pinav.fitting.engine.posterior import Posterior
from pinav.fitting.engine.problem import ShortenedStep
from pinav.fitting.least_squares import fit_regression
from pinav.forces import IsotropicPrior
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.perfusion import AbstractLearnedPerfusion
from pinav.thermal.protocols import AbstractProtocol, Schedule, plan_steps
from pinav.thermal.quantities import Field, Number, Numbers
from pinav.thermal.readings import Readings
from pinav.thermal.solve import Observe, default_stepper, probes_at, run, solve
from pinav.thermal.starts import AT_REST, AbstractStart
from pinav.thermal.steppers import AbstractStepper, refuse_jumps

Temperatures = Float[Array, "time place"]
"""Temperatures of the places that are read [°C], or differences of them [K]."""

Laws = Callable[[Any], tuple[AbstractLearnedPerfusion, ...]]
"""Picks the laws to be learned from a model."""


class Voxels(eqx.Module):
    """Temperatures of some cells, as an `observe`."""

    cells: Int[Array, " voxel"]

    def __call__(self, temperature: Field) -> Float[Array, " voxel"]:
        return temperature.reshape(-1)[self.cells]


class Residuals(eqx.Module):
    r"""Predicted less read temperatures over their noise, as a function of the model.

    The shift of the proton resonance gives a phase, and so a temperature up to whole
    turns; the field of the magnet drifts, which adds to every frame a phase that is
    smooth in space. Turns are removed beside the prediction, and what a drift could
    explain is projected out of the residuals of each frame, so that it costs no
    parameters:

    $$r_f \to r_f - B (B^\top B)^{-1} B^\top r_f,\qquad B = W_f P,$$

    with $W_f$ one over the noise of each voxel, zero where it is lost, and $P$ the
    constant and the coordinates: the same as a flat prior on the coefficients of every
    frame. Probes have neither turns nor drift.

    Attributes:
        schedule: time steps, which end at the readings.
        observe: temperatures of the places that are read.
        values: readings [°C] of these at each time, zero where lost.
        weights: one over the noise [K⁻¹], zero where lost.
        basis: of the drift at these places.
        roots: of the normal matrix of each frame, lower triangular.
        index: places of the readings among all times and places.
        turn: of the phase [K].
        start: where the run begins; a steady state follows the model.

    References:
        Rieke and Butts Pauly, J. Magn. Reson. Imaging 27, 376 (2008).
    """

    protocol: AbstractProtocol
    schedule: Schedule
    stepper: AbstractStepper
    observe: Observe
    values: Temperatures
    weights: Temperatures
    basis: Float[Array, "place term"]
    roots: Float[Array, "time term term"]
    index: Int[Array, " reading"]
    turn: Number | None
    start: AbstractStart

    def __call__(self, model: Bioheat) -> Float[Array, " reading"]:
        scaled = self.offsets(self.predict(model)) * self.weights
        return (scaled - self.weights * self.drift(scaled)).reshape(-1)[self.index]

    def predict(self, model: Bioheat) -> Temperatures:
        """Temperatures of the places that are read [°C]."""
        solution = run(
            model,
            self.protocol,
            self.schedule,
            stepper=self.stepper,
            observe=self.observe,
            start=self.start,
        )
        return solution.observed

    def offsets(self, predicted: Temperatures) -> Temperatures:
        """Predicted less read [K], turns of the phase taken off.

        Next to the mean of each frame, on the circle: a drift may be more than a turn.
        """
        offsets = predicted - self.values
        if self.turn is None:
            return offsets
        angles = 2 * np.pi / self.turn * jax.lax.stop_gradient(offsets)
        read = self.weights > 0
        mean = jnp.arctan2(
            jnp.sum(jnp.where(read, jnp.sin(angles), 0.0), axis=1),
            jnp.sum(jnp.where(read, jnp.cos(angles), 0.0), axis=1),
        )
        return offsets - self.turn * jnp.round((angles - mean[:, None]) / (2 * np.pi))

    def drift(self, scaled: Temperatures) -> Temperatures:
        """The drift [K] that explains weighted residuals best."""
        if not self.basis.shape[1]:
            return jnp.zeros_like(scaled)

        def solve_frame(root: Array, moment: Array) -> Array:
            return jax.scipy.linalg.cho_solve((root, True), moment)

        moments = (scaled * self.weights) @ self.basis
        return jax.vmap(solve_frame)(self.roots, moments) @ self.basis.T

    @property
    def num_projected(self) -> int:
        """Residuals that the drifts of all frames take away."""
        return self.roots.shape[0] * self.basis.shape[1]

    @eqx.filter_jit
    def correct(self, model: Bioheat) -> tuple[Array, Array]:
        """Predicted temperatures, and readings without turns and drift [°C].

        NaN where a reading was lost.
        """
        predicted = self.predict(model)
        offsets = self.offsets(predicted)
        offsets = offsets - self.drift(offsets * self.weights)
        return predicted, jnp.where(self.weights > 0, predicted - offsets, jnp.nan)


def read_residuals(
    model: Bioheat,
    protocol: AbstractProtocol,
    data: Readings,
    *,
    stepper: AbstractStepper,
    start: AbstractStart = AT_REST,
) -> Residuals:
    """The residuals of models like `model`."""
    grid, count = model.grid, len(data.times)
    if data.points is None:
        if data.sd.shape != grid.shape:
            raise InputError(
                f"thermometry: expected frames of shape {grid.shape}, that of the "
                f"grid, got {data.sd.shape}"
            )
        places = np.flatnonzero(data.observed.any(axis=0))
        observe = Voxels(jnp.asarray(places))
    else:
        axes, columns = len(grid.shape), data.points.shape[1]
        if columns != axes:
            names = "t, r, T" if axes == 1 else ", ".join(("t", *"xyz"[:axes], "T"))
            raise InputError(
                f"readings: expected places with {axes} coordinates (columns {names}) "
                f"for this grid, got {columns}"
            )
        places, observe = np.arange(len(data.points)), probes_at(model, data.points)
    read = data.observed.reshape(count, -1)[:, places]
    noise = np.where(np.isfinite(data.sd), data.sd, 1.0).reshape(-1)[places]
    weights = np.where(read, 1 / noise, 0.0)
    basis = _drift_basis(data.drift, data.sd.shape)[places]
    longest = stepper.longest_step(model)
    return Residuals(
        protocol=protocol,
        schedule=plan_steps(protocol, longest, save_at=data.times.tolist()),
        stepper=stepper,
        observe=observe,
        values=jnp.asarray(
            np.where(read, data.values.reshape(count, -1)[:, places], 0.0)
        ),
        weights=jnp.asarray(weights),
        basis=jnp.asarray(basis),
        roots=jnp.asarray(_roots(weights, basis)),
        index=jnp.asarray(np.flatnonzero(read)),
        turn=data.turn,
        start=start,
    )


def _drift_basis(drift: str, shape: tuple[int, ...]) -> Float[np.ndarray, "place term"]:
    """One, and the coordinates from -1 to 1."""
    count = int(np.prod(shape))
    if drift == "none":
        return np.zeros((count, 0))
    terms = [np.ones(shape)]
    if drift == "linear":
        lines = [np.linspace(-1.0, 1.0, n) for n in shape]
        terms += np.meshgrid(*lines, indexing="ij")
    return np.stack([term.reshape(-1) for term in terms], axis=1)


def _roots(weights: np.ndarray, basis: np.ndarray) -> np.ndarray:
    normal = np.einsum("fv,vi,vj->fij", weights**2, basis, basis, optimize=True)
    try:
        return np.linalg.cholesky(normal)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "thermometry: expected voxels in every frame that tell its drift, got a "
            "frame without them; leave the frame out, or take a drift of fewer terms"
        ) from error


def learn(
    model: Bioheat,
    protocol: AbstractProtocol,
    data: Readings,
    *,
    laws: Laws = lambda _: (),
    constants: Callable[[Any], PyTree] = lambda _: (),
    stepper: AbstractStepper | None = None,
    start: AbstractStart = AT_REST,
) -> EvidenceFit:
    """Fit laws of perfusion, and constants, to readings of probes or of voxels.

    Args:
        model: where the fit starts; what is not picked stays as it is.
        protocol: the field while the readings were taken, best with steps of power:
            at steady state a scale of the power cannot be told from perfusion.
        laws: picks learned perfusions, such as `lambda m: m.perfusion.laws`.
        constants: picks numbers to learn, such as `lambda m: m.sources[0].scale`.

    Raises:
        InputError: nothing is picked, the data do not fit the grid or the protocol, or
            a law of perfusion jumps.
        FitError: the fit did not converge.
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
        # nats of log evidence: half of one moves a law by little of its band
        tolerance=0.5 if count else 1e-2,
        max_iterations=40,
        num_projected=residuals.num_projected,
        # so many voxels leave little doubt where to step, and a run costs a tenth of a
        # Jacobian
        step_rule=ShortenedStep(corrections=6) if data.points is None else None,
    )


class PerfusionCurve(eqx.Module):
    """A learned law with its band, and where it was visited.

    Attributes:
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
        half = normal_quantile() * self.sd
        return self.values * np.exp(np.stack([-half, half]))

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
    """A learned law at temperatures, by the delta method on its logarithm."""
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
    """Lowest and highest temperature [°C] of the cells that a mask holds mostly."""
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
