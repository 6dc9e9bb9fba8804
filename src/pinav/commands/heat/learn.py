"""`pinav heat learn`: perfusion and power from probes or from MR thermometry."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.cells import EstimateRow
from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case
from pinav.commands.heat.fitting import (
    Quantities,
    describe_constant,
    fit_case,
    fit_constant,
    followed_curves,
    forecast,
    law_names,
    mean_perfusion,
)
from pinav.commands.heat.learning_case import LearningCase, residuals_of
from pinav.commands.heat.metrics import (
    ForecastMetrics,
    HeldOutMetrics,
    LawMetrics,
    LearnMetrics,
    QuantityMetrics,
)
from pinav.commands.heat.readings import Readings
from pinav.commands.heat.simulate import spacing
from pinav.commands.heat.task import AbstractTask, TaskResult
from pinav.errors import InputError
from pinav.fitting import EvidenceFit
from pinav.fitting.bayes.derived import derive
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.learning import (
    ProbeResiduals,
    perfusion_curve,
    visited_range,
)
from pinav.thermal.probes import ProbeData, simulate_probes
from pinav.thermal.solve import Solution, solve
from pinav.thermal.thermometry import Thermometry, ThermometryResiduals


class LearnTask(AbstractTask):
    """Learn the perfusion of a case, and more, from readings.

    Without data the perfusion of the case is the truth of synthetic readings of probes;
    with them its values at rest are where the fit starts.
    """

    def __init__(self, case: Case, source: Path) -> None:
        setup = build_case(case, source.parent)
        self.probes = case.probes
        self.learning = LearningCase.of(case, setup, source.parent)
        if self.learning.fitted is None and not len(setup.points):
            raise InputError(
                "learn: expected data, a CSV file, or probes whose readings are "
                "simulated"
            )

    def run(self) -> TaskResult:
        learning = self.learning
        setup, settings = learning.setup, learning.settings
        data, synthetic = learning.fitted, None
        if data is None:
            data = synthetic = self._synthetic_readings()
        fit = fit_case(setup, settings, data)
        constant = (
            fit if settings.kind == "constant" else fit_constant(setup, settings, data)
        )
        residuals = residuals_of(setup, fit.model, data)
        comparison = Comparison.of(residuals, fit.model, data)
        by_constant = (
            comparison
            if constant is fit
            else Comparison.of(residuals, constant.model, data)
        )
        arrays = _fit_arrays(setup, residuals, data, comparison)
        held_out = settings.held_out if synthetic is not None else ()
        metrics = LearnMetrics(
            outcome=str(fit.outcome),
            iterations=fit.iterations,
            residual=comparison.residual,
            noise=float(fit.hyperparameters.noise),
            relative=isinstance(data, Thermometry),
            log_evidence=fit.hyperparameters.log_evidence,
            constants={
                describe_constant(name, setup): EstimateRow.of(one)
                for name, one in fit.constants.items()
            },
            quantities=_compare(learning, fit),
            laws={} if settings.kind == "constant" else _curves(learning, fit, arrays),
            constant_residual=by_constant.residual,
            held_out=tuple(
                _held_out(setup, fit.model, constant.model, power) for power in held_out
            ),
            forecast=_forecast(learning, fit, arrays),
        )
        return TaskResult(metrics, arrays, synthetic, setup.body.image)

    def _synthetic_readings(self) -> ProbeData:
        assert self.probes is not None
        learning, setup = self.learning, self.learning.setup
        return simulate_probes(
            setup.model,
            setup.protocol,
            setup.points,
            every=self.probes.every,
            noise=learning.settings.noise,
            key=jax.random.key(learning.settings.seed),
            stepper=setup.stepper,
            start=setup.start,
        )


def _compare(learning: LearningCase, fit: EvidenceFit) -> tuple[QuantityMetrics, ...]:
    """Numbers that were learned, beside the truth where there is one."""
    quantities = Quantities.of(learning.setup, learning.settings)
    names = quantities.names(len(learning.setup.model.grid.shape))
    true: list[float | None] = [None] * len(names)
    if learning.truth is not None and names:
        true = np.asarray(quantities(learning.truth.model)).tolist()
    estimates = derive(fit.posterior, quantities) if names else []
    return tuple(
        QuantityMetrics(name, one.value, one.sd, truth)
        for name, one, truth in zip(names, estimates, true, strict=True)
    )


@dataclasses.dataclass(frozen=True)
class Comparison:
    """What a model predicts, beside the readings.

    Attributes:
        predicted: temperatures at the readings' times and places [°C].
        readings: without turns and drift [°C], NaN where there are none.
        scaled: predicted less read, of voxels over their noise.
    """

    predicted: Float[np.ndarray, "time place"]
    readings: Float[np.ndarray, "time place"]
    scaled: Float[np.ndarray, "time place"]

    @classmethod
    def of(
        cls,
        residuals: ProbeResiduals | ThermometryResiduals,
        model: Bioheat,
        data: Readings,
    ) -> "Comparison":
        """That of a model."""
        if isinstance(residuals, ThermometryResiduals):
            predicted, readings = map(np.asarray, _correct(residuals, model))
            scaled = (predicted - readings) * np.asarray(residuals.weights)
            return cls(predicted, readings, scaled)
        misfits = np.full(data.values.size, np.nan)
        misfits[np.asarray(residuals.index)] = np.asarray(residuals(model))
        misfits = misfits.reshape(data.values.shape)
        return cls(data.values + misfits, data.values, misfits)

    @property
    def residual(self) -> float:
        """Root mean square of the scaled residuals."""
        return _rms(self.scaled)


def _fit_arrays(
    setup: CaseModel,
    residuals: ProbeResiduals | ThermometryResiduals,
    data: Readings,
    comparison: Comparison,
) -> dict[str, np.ndarray]:
    """Readings and what the fit makes of them, for the figures."""
    if isinstance(residuals, ThermometryResiduals):
        return _frame_arrays(setup, residuals, comparison)
    assert isinstance(data, ProbeData)
    return {
        "data_times": data.times,
        "data_values": data.values,
        "points": data.points,
        "predicted": comparison.predicted,
    }


def _frame_arrays(
    setup: CaseModel, residuals: ThermometryResiduals, comparison: Comparison
) -> dict[str, np.ndarray]:
    """Readings without turns and drift, and the fit: the last frame, and means."""
    predicted, corrected = comparison.predicted, comparison.readings
    shape, cells = setup.model.grid.shape, np.asarray(residuals.cells)

    def image(values: np.ndarray) -> np.ndarray:
        full = np.full(int(np.prod(shape)), np.nan)
        full[cells] = values
        return full.reshape(shape)

    means = {}
    for name, fraction in setup.body.fractions.items():
        inside = np.asarray(fraction).reshape(-1)[cells] > 0.5
        if inside.any():
            means[name] = (
                np.nanmean(corrected[:, inside], axis=1),
                predicted[:, inside].mean(axis=1),
            )
    return {
        "data_times": residuals.schedule.times,
        "frame/reading": image(corrected[-1]),
        "frame/fit": image(predicted[-1]),
        "target": np.asarray(setup.target),
        "spacing": spacing(setup.model.grid),
        **{f"mean/{name}/reading": one for name, (one, _) in means.items()},
        **{f"mean/{name}/fit": one for name, (_, one) in means.items()},
    }


@eqx.filter_jit
def _correct(residuals: ThermometryResiduals, model: Bioheat) -> tuple[Array, Array]:
    """Predicted temperatures, and readings without turns and drift, NaN where lost."""
    predicted = residuals.predict(model)
    offsets = residuals.offsets(predicted)
    drift = residuals.drifts(offsets * residuals.weights) @ residuals.basis.T
    read = residuals.weights > 0
    return predicted, jnp.where(read, predicted - (offsets - drift), jnp.nan)


def _forecast(
    learning: LearningCase, fit: EvidenceFit, arrays: dict[str, np.ndarray]
) -> ForecastMetrics | None:
    """Predictions after the readings that were fitted, beside the later ones."""
    setup, fitted, every = learning.setup, learning.fitted, learning.every
    if fitted is None or every is None or fitted.times[-1] >= setup.protocol.duration:
        return None
    predicted = forecast(setup, fit.posterior)
    later = predicted.times > fitted.times[-1]
    arrays["forecast/times"] = predicted.times
    arrays["forecast/from"] = fitted.times[-1:]
    arrays["forecast/values"], arrays["forecast/sd"] = predicted.values, predicted.sd
    error = covered = None
    if learning.truth is not None:
        truth = learning.truth
        true = followed_curves(setup, truth.model, predicted.times)
        arrays["forecast/true"] = true
        apart = np.abs(predicted.values - true)[later]
        error = float(apart.max())
        covered = float((apart <= 1.96 * predicted.sd[later]).mean())
    residual = None
    if len(every.times) > len(fitted.times):
        whole = Comparison.of(residuals_of(setup, fit.model, every), fit.model, every)
        residual = _rms(whole.scaled[len(fitted.times) :])
    return ForecastMetrics(
        fitted_until=float(fitted.times[-1]),
        residual=residual,
        sd=float(predicted.sd[later].max()),
        error=error,
        covered=covered,
    )


def _rms(values: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _curves(
    learning: LearningCase, fit: EvidenceFit, arrays: dict[str, np.ndarray]
) -> dict[str, LawMetrics]:
    """Each learned law with its band and, if known, its truth, added to the arrays."""
    setup, settings, metrics = learning.setup, learning.settings, {}
    for name in law_names(setup, settings):
        visited = visited_range(
            fit.model, setup.protocol, setup.body.fractions[name], setup.start
        )
        at = np.linspace(float(setup.model.blood.arterial), visited[1] + 1.0, 61)
        curve = perfusion_curve(fit.posterior, setup.body.laws[name], at, visited)
        low, high = curve.band
        stored = {"temperatures": at, "values": curve.values, "low": low, "high": high}
        stored["visited"] = curve.inside
        covered = None
        truth = learning.setup if settings.is_synthetic else learning.truth
        if truth is not None:
            true = np.array([mean_perfusion(truth, name, one) for one in at])
            inside = ((true >= low) & (true <= high))[curve.inside]
            covered, stored["true"] = float(inside.mean()), true
        for key, values in stored.items():
            arrays[f"law/{name}/{key}"] = values
        metrics[name] = LawMetrics(visited, covered)
    return metrics


def _held_out(
    setup: CaseModel, learned: Bioheat, constant: Bioheat, power: float
) -> HeldOutMetrics:
    """Errors of the temperature, and doses, at another power."""
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

    truth = solution(setup.model)
    by_law, by_constant = solution(learned), solution(constant)

    def error(prediction: Solution) -> float:
        return float(jnp.abs(truth.observed - prediction.observed).max())

    return HeldOutMetrics(
        power=float(power),
        learned=error(by_law),
        constant=error(by_constant),
        true_dose=float(truth.final.dose.max()),
        learned_dose=float(by_law.final.dose.max()),
        constant_dose=float(by_constant.final.dose.max()),
    )
