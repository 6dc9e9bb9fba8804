"""What readings say of a case: perfusion and power, how well, and what comes next."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.evaluation import normal_quantile
from pinav.fitting import EvidenceFit, Outcome
from pinav.fitting.bayes.parameters import derive
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.thermal import learning
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.heated_run import FOLLOWED, AbstractHeatResult, Watched
from pinav.thermal.protocols import plan_steps
from pinav.thermal.readings import Readings, place_names
from pinav.thermal.setup import Setup
from pinav.thermal.solve import Solution, run, solve
from pinav.thermal.tissue_fit import (
    TissueFit,
    describe_constant,
    mean_perfusion,
    quantities_of,
)


class Forecast(eqx.Module):
    """Predicted temperatures of the target, over the whole protocol.

    Attributes:
        values: temperatures by `FOLLOWED`, at each time [°C].
        true: the same temperatures of the truth, where it is known [°C].
        residual: root mean square residual of the later readings, as that of the fit;
            none where there are none.
    """

    DERIVED = ("largest_sd", "error", "covered")

    times: Float[np.ndarray, " time"]
    values: Float[np.ndarray, "time quantity"]
    sd: Float[np.ndarray, "time quantity"]
    fitted_until: float
    true: Float[np.ndarray, "time quantity"] | None = None
    residual: float | None = None

    @property
    def largest_sd(self) -> float:
        """Largest standard deviation after the readings that were fitted [K]."""
        return float(self.sd[self._later].max())

    @property
    def error(self) -> float | None:
        """Largest error after these readings, where the truth is known [K]."""
        return None if self.true is None else float(self._errors.max())

    @property
    def covered(self) -> float | None:
        """Fraction of later temperatures with the truth in the band of 95 %."""
        if self.true is None:
            return None
        return float((self._errors <= normal_quantile() * self.sd[self._later]).mean())

    @property
    def _later(self) -> np.ndarray:
        return self.times > self.fitted_until

    @property
    def _errors(self) -> np.ndarray:
        return np.abs(self.values - self.true)[self._later]


MOMENTS = 30
"""Number of times of a forecast."""


def forecast(
    setup: Setup, posterior: Posterior, times: Float[np.ndarray, " time"]
) -> tuple[Float[np.ndarray, "time quantity"], Float[np.ndarray, "time quantity"]]:
    """Temperatures by `FOLLOWED` [°C] and their standard deviations [K].

    By the delta method, in forward mode: there are fewer parameters than temperatures.
    """
    follow = follow_target(setup, times)

    @eqx.filter_jit
    def curves_and_slopes(free: Any, theta: Array) -> tuple[Array, Array]:
        value, push = jax.linearize(lambda at: follow(free(at)), theta)
        return value, jnp.moveaxis(jax.lax.map(push, jnp.eye(len(theta))), 0, -1)

    with jax.enable_x64(new_val=True):
        theta = jnp.asarray(posterior.mean)
        values, slopes = map(np.asarray, curves_and_slopes(posterior.free, theta))
    variance = np.einsum("tqp,pr,tqr->tq", slopes, posterior.covariance, slopes)
    return values, np.sqrt(np.maximum(variance, 0.0))


def follow_target(
    setup: Setup, times: Float[np.ndarray, " time"]
) -> Callable[[Any], Array]:
    """Temperatures of the target at times, as a function of the model."""
    watched = Watched.of(setup, None)
    longest = setup.stepper.longest_step(setup.model)
    schedule = plan_steps(setup.protocol, longest, save_at=times)

    def follow(model: Any) -> Array:
        solution = run(
            model,
            setup.protocol,
            schedule,
            stepper=setup.stepper,
            observe=watched.temperatures,
            start=setup.start,
        )
        return jnp.stack([solution.observed[name] for name in FOLLOWED], axis=-1)

    return follow


class HeldOut(eqx.Module):
    """Largest errors of the temperature at a power that was not fitted.

    Attributes:
        power: relative to that of the fit.
        learned: error with the learned laws [K].
        constant: error with the best constant perfusion [K].
    """

    power: float
    learned: float
    constant: float


class FittedCurves(eqx.Module):
    """Readings over time, and the fit: of probes, or means over voxels of tissues.

    Attributes:
        names: names of the probes or tissues.
        read: temperatures without turns and drift [°C].
    """

    times: Float[np.ndarray, " time"]
    names: tuple[str, ...]
    read: Float[np.ndarray, "time place"]
    fitted: Float[np.ndarray, "time place"]


class FittedFrame(eqx.Module):
    """The last frame that was fitted, without turns and drift, and its fit.

    Attributes:
        time: of the frame [s].
        read: [°C]; NaN where no voxel is read.
    """

    time: float
    read: Float[np.ndarray, "*grid"]
    fitted: Float[np.ndarray, "*grid"]
    target: Float[np.ndarray, "*grid"]
    spacing: tuple[float, ...]


class LearnedTissue(AbstractHeatResult):
    """A fit of a case to readings of probes or voxels.

    Attributes:
        residual: root mean square of the residuals [K].
        noise: estimated standard deviation of a reading [K].
        relative: True if both are in units of a map of the noise instead.
        constants: other numbers learned, by name.
        quantities: numbers that can be compared with a truth, by name with its unit.
        true: their true values, where they are known.
        constant_residual: root mean square residual of the best constant perfusion [K].
    """

    title: str
    outcome: Outcome
    iterations: int
    residual: float
    noise: float
    relative: bool
    log_evidence: float | None
    constants: dict[str, Estimate]
    laws: dict[str, learning.PerfusionCurve]
    constant_residual: float
    held_out: tuple[HeldOut, ...]
    quantities: dict[str, Estimate]
    true: dict[str, float]
    forecast: Forecast | None
    curves: FittedCurves
    frame: FittedFrame | None


def learn_tissue(task: TissueFit, data: Readings) -> LearnedTissue:
    """Fit a case to readings, and compare it with constant perfusion and the truth.

    Raises:
        FitError: the fit did not converge.
    """
    setup, settings = task.setup, task.settings
    fit = task.learn(data)
    is_constant = settings.kind == "constant"
    constant = fit if is_constant else task.learn(data, "constant")
    residuals = task.residuals(data)
    comparison, by_constant = (
        _Comparison.of(residuals, one.model) for one in (fit, constant)
    )
    constants = fit.constants.items()
    held_out = settings.held_out if task.fitted is None else ()
    quantities, true = _compare(task, fit)
    in_frames, frame = data.points is None, None
    if data.points is not None:
        names = tuple(place_names(data.points))
        curves = FittedCurves(data.times, names, data.values, comparison.predicted)
    else:
        curves = _tissue_curves(setup, residuals, comparison)
        frame = _last_frame(setup, residuals, comparison)
    return LearnedTissue(
        title=setup.title,
        outcome=fit.outcome,
        iterations=fit.iterations,
        residual=_rms(comparison.scaled),
        noise=float(fit.hyperparameters.noise),
        relative=in_frames,
        log_evidence=fit.hyperparameters.log_evidence,
        constants={describe_constant(name, setup): one for name, one in constants},
        quantities=quantities,
        true=true,
        laws={} if is_constant else _laws(task, fit),
        constant_residual=_rms(by_constant.scaled),
        held_out=tuple(
            _held_out(setup, fit.model, constant.model, power) for power in held_out
        ),
        forecast=_forecast(task, fit),
        curves=curves,
        frame=frame,
    )


def _compare(
    task: TissueFit, fit: EvidenceFit
) -> tuple[dict[str, Estimate], dict[str, float]]:
    """Numbers that were learned, and the true ones where they are known."""
    names, quantities = quantities_of(task)
    if not names:
        return {}, {}
    learned = dict(zip(names, derive(fit.posterior, quantities), strict=True))
    if task.truth is None:
        return learned, {}
    true = np.asarray(quantities(task.truth.model)).tolist()
    return learned, dict(zip(names, true, strict=True))


class _Comparison(NamedTuple):
    """Predicted temperatures, readings without turns and drift, and residuals."""

    predicted: Float[np.ndarray, "time place"]
    read: Float[np.ndarray, "time place"]
    scaled: Float[np.ndarray, "time place"]

    @classmethod
    def of(cls, residuals: learning.Residuals, model: Bioheat) -> "_Comparison":
        predicted, read = map(np.asarray, residuals.correct(model))
        return cls(predicted, read, (predicted - read) * np.asarray(residuals.weights))


def _tissue_curves(
    setup: Setup, residuals: learning.Residuals, comparison: _Comparison
) -> FittedCurves:
    """Means over the voxels of each tissue that are read."""
    assert isinstance(residuals.observe, learning.Voxels)
    cells, means = np.asarray(residuals.observe.cells), {}
    for name, fraction in setup.body.fractions.items():
        inside = np.asarray(fraction).reshape(-1)[cells] > 0.5
        if inside.any():
            read = np.nanmean(comparison.read[:, inside], axis=1)
            means[name] = read, comparison.predicted[:, inside].mean(axis=1)
    read, fitted = (
        np.stack(curves, axis=1) for curves in zip(*means.values(), strict=True)
    )
    return FittedCurves(residuals.schedule.times, tuple(means), read, fitted)


def _last_frame(
    setup: Setup, residuals: learning.Residuals, comparison: _Comparison
) -> FittedFrame:
    assert isinstance(residuals.observe, learning.Voxels)
    grid, cells = setup.model.grid, np.asarray(residuals.observe.cells)

    def image(values: np.ndarray) -> np.ndarray:
        full = np.full(int(np.prod(grid.shape)), np.nan)
        full[cells] = values
        return full.reshape(grid.shape)

    return FittedFrame(
        time=float(residuals.schedule.times[-1]),
        read=image(comparison.read[-1]),
        fitted=image(comparison.predicted[-1]),
        target=np.asarray(setup.body.target),
        spacing=grid.cell_sizes,
    )


def _forecast(task: TissueFit, fit: EvidenceFit) -> Forecast | None:
    setup, fitted, every = task.setup, task.fitted, task.every
    if fitted is None or every is None or fitted.times[-1] >= setup.protocol.duration:
        return None
    times = np.linspace(0.0, setup.protocol.duration, MOMENTS + 1)[1:]
    values, sd = forecast(setup, fit.posterior, times)
    true = None if task.truth is None else follow_target(setup, times)(task.truth.model)
    residual = None
    if len(every.times) > len(fitted.times):
        whole = _Comparison.of(task.residuals(every), fit.model)
        residual = _rms(whole.scaled[len(fitted.times) :])
    return Forecast(
        times=times,
        values=values,
        sd=sd,
        fitted_until=float(fitted.times[-1]),
        true=None if true is None else np.asarray(true),
        residual=residual,
    )


def _rms(values: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _laws(task: TissueFit, fit: EvidenceFit) -> dict[str, learning.PerfusionCurve]:
    setup, curves = task.setup, {}
    truth = setup if task.settings.is_synthetic else task.truth
    for name in task.names:
        visited = learning.visited_range(
            fit.model, setup.protocol, setup.body.fractions[name], setup.start
        )
        at = np.linspace(setup.arterial, visited[1] + 1.0, 61)
        true = None
        if truth is not None:
            true = np.array([mean_perfusion(truth, name, one) for one in at])
        curves[name] = learning.perfusion_curve(
            fit.posterior, setup.body.law(name), at, visited, true
        )
    return curves


def _held_out(
    setup: Setup, learned: Bioheat, constant: Bioheat, power: float
) -> HeldOut:
    protocol = eqx.tree_at(
        lambda p: (p.starts, p.ends),
        setup.protocol,
        replace_fn=lambda a: a * power**0.5,
    )

    def solution(model: Bioheat) -> Solution:
        every = protocol.duration / 60
        return solve(
            model, protocol, stepper=setup.stepper, save_every=every, start=setup.start
        )

    truth = solution(setup.model).observed
    by_law, by_constant = (
        float(jnp.abs(truth - solution(model).observed).max())
        for model in (learned, constant)
    )
    return HeldOut(float(power), by_law, by_constant)
