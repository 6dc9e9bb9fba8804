"""`pinav heat learn`: perfusion from probes, beside the best constant perfusion."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.cells import EstimateRow
from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case, Learn
from pinav.commands.heat.metrics import (
    HeldOutMetrics,
    LawMetrics,
    LearnMetrics,
)
from pinav.commands.heat.task import AbstractTask, TaskResult
from pinav.errors import InputError
from pinav.fitting import EvidenceFit
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.learned_perfusion import kernel_perfusion, neural_perfusion
from pinav.thermal.learning import (
    ProbeResiduals,
    learn,
    perfusion_curve,
    probe_residuals,
    visited_range,
)
from pinav.thermal.perfusion import AbstractPerfusion, ConstantPerfusion
from pinav.thermal.probes import ProbeData, load_probes, simulate_probes
from pinav.thermal.solve import Solution, solve

DEFAULT_RISE = 6.0
"""Range [K] of the law of a tissue without a probe."""


class LearnTask(AbstractTask):
    """Learn the perfusion of a case from probes.

    Without a data file the perfusion of the case is the truth of synthetic readings;
    with one its values at rest are where the fit starts.
    """

    def __init__(self, case: Case, source: Path) -> None:
        self.settings = case.learn or Learn()
        self.every = None if case.probes is None else case.probes.every
        self.data = None
        if self.settings.data is not None:
            self.data = load_probes(source.parent / self.settings.data)
        self.setup = build_case(case, source.parent)
        for name in law_names(self.setup, self.settings):
            _value_at_rest(self.setup, name)
        if not self.setup.protocol.largest > 0:
            raise InputError(
                "field.amplitudes: expected one > 0 A/m, got none; tissue that is not "
                "heated tells nothing of its perfusion"
            )
        if self.data is not None:
            # refuses readings outside the grid or after the end of the protocol
            probe_residuals(
                self.setup.model,
                self.setup.protocol,
                self.data,
                stepper=self.setup.stepper,
                start=self.setup.start,
            )
        elif not len(self.setup.points):
            raise InputError(
                "learn: expected data, a CSV file, or probes whose readings are "
                "simulated"
            )

    def run(self) -> TaskResult:
        setup, settings = self.setup, self.settings
        data = self._synthetic_readings() if self.data is None else self.data
        fit = _fit(setup, settings, data)
        constant = _fit_constant(setup, settings, data)
        residuals = probe_residuals(
            fit.model,
            setup.protocol,
            data,
            stepper=setup.stepper,
            start=setup.start,
        )
        arrays = {
            "data_times": data.times,
            "data_values": data.values,
            "points": data.points,
            "predicted": _predict(fit.model, residuals, data),
        }
        held_out = settings.held_out if self.data is None else ()
        noise = fit.hyperparameters.noise
        metrics = LearnMetrics(
            outcome=str(fit.outcome),
            iterations=fit.iterations,
            residual=_rms(residuals(fit.model)),
            noise=float(noise),
            log_evidence=fit.hyperparameters.log_evidence,
            constants={n: EstimateRow.of(one) for n, one in fit.constants.items()},
            laws=_curves(setup, settings, fit, arrays),
            constant_residual=_rms(residuals(constant.model)),
            held_out=tuple(
                _held_out(setup, fit.model, constant.model, power) for power in held_out
            ),
        )
        return TaskResult(metrics, arrays, data if self.data is None else None)

    def _synthetic_readings(self) -> ProbeData:
        assert self.every is not None
        return simulate_probes(
            self.setup.model,
            self.setup.protocol,
            self.setup.points,
            every=self.every,
            noise=self.settings.noise,
            key=jax.random.key(self.settings.seed),
            stepper=self.setup.stepper,
            start=self.setup.start,
        )


def law_names(setup: CaseModel, settings: Learn) -> tuple[str, ...]:
    """Tissues whose perfusion is learned: all of a case that names none.

    Raises:
        InputError: there is no such tissue.
    """
    names = tuple(setup.body.laws) if settings.laws is None else settings.laws
    for name in names:
        if name not in setup.body.laws:
            raise InputError(
                f"learn.laws: expected names of tissues, {', '.join(setup.body.laws)}; "
                f"got {name!r}"
            )
    return names


def _fit(setup: CaseModel, settings: Learn, data: ProbeData) -> EvidenceFit:
    laws = tuple(setup.body.laws[name] for name in law_names(setup, settings))
    return learn(
        _initial_model(setup, settings, data),
        setup.protocol,
        data,
        laws=lambda m: tuple(law(m) for law in laws),
        constants=_power_scale(settings),
        stepper=setup.stepper,
        start=setup.start,
    )


def _fit_constant(setup: CaseModel, settings: Learn, data: ProbeData) -> EvidenceFit:
    """The baseline: a perfusion of each tissue that does not depend on temperature."""
    laws = tuple(setup.body.laws[name] for name in law_names(setup, settings))
    start = setup.model
    for name, law in zip(law_names(setup, settings), laws, strict=True):
        rest = ConstantPerfusion(jnp.asarray(_value_at_rest(setup, name)))
        start = eqx.tree_at(law, start, rest)
    scale = _power_scale(settings)
    return learn(
        start,
        setup.protocol,
        data,
        constants=lambda m: (tuple(law(m).value for law in laws), scale(m)),
        stepper=setup.stepper,
        start=setup.start,
    )


def _power_scale(settings: Learn) -> Callable[[Any], Any]:
    """Picks the scale of the power, if that is learned too."""
    if settings.power_scale:
        return lambda model: model.sources[0].scale
    return lambda model: ()


def _value_at_rest(setup: CaseModel, name: str) -> float:
    """Perfusion of a tissue at the arterial temperature [kg m⁻³ s⁻¹]."""
    law: AbstractPerfusion = setup.body.laws[name](setup.model)
    value = float(law(jnp.asarray([float(setup.model.blood.arterial)]))[0])
    if not value > 0:
        raise InputError(
            f"perfusion of the {name}: expected > 0 where a fit starts, got {value:g}; "
            "give a small value, or leave the tissue out of learn.laws"
        )
    return value


def _initial_model(setup: CaseModel, settings: Learn, data: ProbeData) -> Bioheat:
    """The model with constant laws, at the perfusion at rest.

    Each may vary up to the hottest reading of its own tissue.
    """
    model, arterial = setup.model, float(setup.model.blood.arterial)
    weights = np.asarray(model.grid.interpolation(data.points))
    weights = weights.reshape(len(weights), -1)
    for index, name in enumerate(law_names(setup, settings)):
        law, share = setup.body.laws[name], np.asarray(setup.body.shares[name])
        readings = data.values[:, weights @ share.reshape(-1) > 0.5]
        rest = _value_at_rest(setup, name)
        top = float(np.nanmax(readings)) if readings.size else arterial + DEFAULT_RISE
        span = (arterial, max(top, arterial + 1.0))
        key = jax.random.fold_in(jax.random.key(settings.seed), index)
        learned = (
            neural_perfusion(rest, span, key=key)
            if settings.kind == "network"
            else kernel_perfusion(rest, span)
        )
        model = eqx.tree_at(law, model, learned)
    return model


def _predict(
    model: Bioheat, residuals: ProbeResiduals, data: ProbeData
) -> Float[np.ndarray, "time probe"]:
    """Predicted temperatures where there are readings."""
    values = np.full(data.values.size, np.nan)
    values[np.asarray(residuals.index)] = np.asarray(
        residuals(model) + residuals.values
    )
    return values.reshape(data.values.shape)


def _rms(values: Float[Array, "..."]) -> float:
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))


def _curves(
    setup: CaseModel, settings: Learn, fit: EvidenceFit, arrays: dict[str, np.ndarray]
) -> dict[str, LawMetrics]:
    """Each learned law with its band and, if known, its truth, added to the arrays."""
    metrics = {}
    for name in law_names(setup, settings):
        visited = visited_range(
            fit.model, setup.protocol, setup.body.shares[name], setup.start
        )
        at = np.linspace(float(setup.model.blood.arterial), visited[1] + 1.0, 61)
        curve = perfusion_curve(fit.posterior, setup.body.laws[name], at, visited)
        low, high = curve.band
        stored = {"temperatures": at, "values": curve.values, "low": low, "high": high}
        stored["visited"] = curve.inside
        covered = None
        if settings.data is None:
            true = np.asarray(setup.body.laws[name](setup.model)(jnp.asarray(at)))
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
