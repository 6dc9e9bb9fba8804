"""What readings say of a case: perfusion and power, how well, and what comes next."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.fitting import EvidenceFit, Outcome
from pinav.fitting.bayes.parameters import derive
from pinav.fitting.engine.posterior import Estimate
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.forecast import Forecast, follow_target, forecast, forecast_times
from pinav.thermal.heated_run import AbstractHeatResult
from pinav.thermal.learning import (
    PerfusionCurve,
    Residuals,
    Voxels,
    perfusion_curve,
    visited_range,
)
from pinav.thermal.readings import Readings
from pinav.thermal.setup import Setup
from pinav.thermal.solve import Solution, solve
from pinav.thermal.tissue_fit import (
    TissueFit,
    describe_constant,
    mean_perfusion,
    quantities_of,
)


class LearnedQuantity(eqx.Module):
    """A number that was learned, and its true value where that is known.

    Attributes:
        name: its name, with the unit.
    """

    name: str
    value: float
    sd: float
    true: float | None = None


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


class FittedProbes(eqx.Module):
    """Readings of probes, and what the fit predicts of them.

    Attributes:
        predicted: temperatures at their times and places [°C].
    """

    data: Readings
    predicted: Float[np.ndarray, "time probe"]


class MeanCurve(eqx.Module):
    """Mean temperature of the voxels of a tissue that are read."""

    read: Float[np.ndarray, " time"]
    fitted: Float[np.ndarray, " time"]


class FittedFrames(eqx.Module):
    """Readings of voxels without turns and drift, and the fit.

    Attributes:
        read: last frame [°C]; NaN where no voxel is read.
        fitted: fit of the last frame [°C].
    """

    times: Float[np.ndarray, " time"]
    read: Float[np.ndarray, "*grid"]
    fitted: Float[np.ndarray, "*grid"]
    target: Float[np.ndarray, "*grid"]
    spacing: tuple[float, ...]
    means: dict[str, MeanCurve]


class LearnedTissue(AbstractHeatResult):
    """A fit of a case to readings of probes or voxels.

    Attributes:
        residual: root mean square of the residuals [K].
        noise: estimated standard deviation of a reading [K].
        relative: True if both are in units of a map of the noise instead.
        constants: other numbers learned, by name.
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
    laws: dict[str, PerfusionCurve]
    constant_residual: float
    held_out: tuple[HeldOut, ...]
    quantities: tuple[LearnedQuantity, ...]
    forecast: Forecast | None
    probes: FittedProbes | None
    frames: FittedFrames | None


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
        TissueComparison.of(residuals, one.model) for one in (fit, constant)
    )
    constants = fit.constants.items()
    held_out = settings.held_out if task.fitted is None else ()
    in_frames = data.points is None
    return LearnedTissue(
        title=setup.title,
        outcome=fit.outcome,
        iterations=fit.iterations,
        residual=comparison.residual,
        noise=float(fit.hyperparameters.noise),
        relative=in_frames,
        log_evidence=fit.hyperparameters.log_evidence,
        constants={describe_constant(name, setup): one for name, one in constants},
        quantities=_compare(task, fit),
        laws={} if is_constant else _laws(task, fit),
        constant_residual=by_constant.residual,
        held_out=tuple(
            _held_out(setup, fit.model, constant.model, power) for power in held_out
        ),
        forecast=_forecast(task, fit),
        probes=None if in_frames else FittedProbes(data, comparison.predicted),
        frames=_frames(setup, residuals, comparison) if in_frames else None,
    )


def _compare(task: TissueFit, fit: EvidenceFit) -> tuple[LearnedQuantity, ...]:
    names, quantities = quantities_of(task)
    if not names:
        return ()
    true: list[float | None] = [None] * len(names)
    if task.truth is not None:
        true = np.asarray(quantities(task.truth.model)).tolist()
    estimates = derive(fit.posterior, quantities)
    return tuple(
        LearnedQuantity(name, one.value, one.sd, truth)
        for name, one, truth in zip(names, estimates, true, strict=True)
    )


class TissueComparison(eqx.Module):
    """What a model predicts, beside the readings.

    Attributes:
        predicted: temperatures at the readings' times and places [°C].
        readings: readings without turns and drift [°C], NaN where there are none.
        scaled: predicted less read, of voxels over their noise.
    """

    predicted: Float[np.ndarray, "time place"]
    readings: Float[np.ndarray, "time place"]
    scaled: Float[np.ndarray, "time place"]

    @classmethod
    def of(cls, residuals: Residuals, model: Bioheat) -> "TissueComparison":
        """The comparison of a model."""
        predicted, readings = map(np.asarray, residuals.correct(model))
        scaled = (predicted - readings) * np.asarray(residuals.weights)
        return cls(predicted, readings, scaled)

    @property
    def residual(self) -> float:
        """Root mean square of the scaled residuals."""
        return _rms(self.scaled)


def _frames(
    setup: Setup, residuals: Residuals, comparison: TissueComparison
) -> FittedFrames:
    predicted, corrected = comparison.predicted, comparison.readings
    assert isinstance(residuals.observe, Voxels)
    grid, cells = setup.model.grid, np.asarray(residuals.observe.cells)

    def image(values: np.ndarray) -> np.ndarray:
        full = np.full(int(np.prod(grid.shape)), np.nan)
        full[cells] = values
        return full.reshape(grid.shape)

    means = {}
    for name, fraction in setup.fractions.items():
        inside = np.asarray(fraction).reshape(-1)[cells] > 0.5
        if inside.any():
            read = np.nanmean(corrected[:, inside], axis=1)
            means[name] = MeanCurve(read, predicted[:, inside].mean(axis=1))
    return FittedFrames(
        times=residuals.schedule.times,
        read=image(corrected[-1]),
        fitted=image(predicted[-1]),
        target=np.asarray(setup.target),
        spacing=grid.cell_sizes,
        means=means,
    )


def _forecast(task: TissueFit, fit: EvidenceFit) -> Forecast | None:
    setup, fitted, every = task.setup, task.fitted, task.every
    if fitted is None or every is None or fitted.times[-1] >= setup.protocol.duration:
        return None
    times = forecast_times(setup)
    values, sd = forecast(setup, fit.posterior, times)
    true = None if task.truth is None else follow_target(setup, times)(task.truth.model)
    residual = None
    if len(every.times) > len(fitted.times):
        whole = TissueComparison.of(task.residuals(every), fit.model)
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


def _laws(task: TissueFit, fit: EvidenceFit) -> dict[str, PerfusionCurve]:
    setup, curves = task.setup, {}
    truth = setup if task.settings.is_synthetic else task.truth
    for name in task.names:
        visited = visited_range(
            fit.model, setup.protocol, setup.fractions[name], setup.start
        )
        at = np.linspace(setup.arterial, visited[1] + 1.0, 61)
        true = None
        if truth is not None:
            true = np.array([mean_perfusion(truth, name, one) for one in at])
        curves[name] = perfusion_curve(
            fit.posterior, setup.laws[name], at, visited, true
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
            model,
            protocol,
            stepper=setup.stepper,
            save_every=every,
            start=setup.start,
        )

    truth = solution(setup.model).observed
    by_law, by_constant = (
        float(jnp.abs(truth - solution(model).observed).max())
        for model in (learned, constant)
    )
    return HeldOut(float(power), by_law, by_constant)
