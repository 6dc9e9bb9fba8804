"""`pinav heat learn`: perfusion from probes, beside the best constant perfusion."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case, Learn
from pinav.errors import InputError
from pinav.fitting import EvidenceFit
from pinav.runs import RunFolder
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
from pinav.thermal.solve import solve

RESULTS = "results.npz"

LAWS: dict[str, Callable[[Any], Any]] = {
    "tumour": lambda m: m.perfusion.inside,
    "tissue": lambda m: m.perfusion.outside,
}
"""Where a model keeps the perfusion of each tissue."""


def learn_perfusion(case: Case, folder: RunFolder, source: Path) -> dict[str, Any]:
    """Learn the perfusion of a case from probes; write curves and residuals.

    Args:
        case: its own perfusion is the truth of synthetic readings; with a data file
            its values at rest are where the fit starts.
        folder: of the run.
        source: the file of the case; a data file is looked for beside it.

    Raises:
        InputError: the case says not what to learn, or has no probes.
        FitError: the fit did not converge.
    """
    own, settings = build_case(case), case.learn or Learn()
    data = _readings(own, case, settings, source)
    fit = _fit(own, settings, data)
    constant = _fit_constant(own, settings, data)
    residuals = probe_residuals(fit.model, own.protocol, data, stepper=own.stepper)
    arrays = {
        "data_times": data.times,
        "data_values": data.values,
        "points": data.points,
        "predicted": _predicted(fit.model, residuals, data),
    }
    metrics = {
        "task": "learn",
        **_fit_metrics(fit, residuals),
        "laws": _curves(own, settings, fit, arrays),
        "constant": {"residual": _rms(residuals(constant.model))},
    }
    if settings.data is None:
        metrics["held_out"] = [
            _held_out(own, fit.model, constant.model, power)
            for power in settings.held_out
        ]
    folder.write_arrays(RESULTS, arrays)
    folder.write_json("metrics.json", metrics)
    return metrics


def _fit(own: CaseModel, settings: Learn, data: ProbeData) -> EvidenceFit:
    start = _start(own, settings, data)
    laws = tuple(LAWS[name] for name in settings.laws)
    return learn(
        start,
        own.protocol,
        data,
        laws=lambda m: tuple(law(m) for law in laws),
        constants=_scale(settings),
        stepper=own.stepper,
    )


def _fit_constant(own: CaseModel, settings: Learn, data: ProbeData) -> EvidenceFit:
    """The baseline: a perfusion of each tissue that does not depend on temperature."""
    laws = tuple(LAWS[name] for name in settings.laws)
    start = own.model
    for law in laws:
        rest = ConstantPerfusion(jnp.asarray(_at_rest(own, law(start))))
        start = eqx.tree_at(law, start, rest)
    scale = _scale(settings)
    return learn(
        start,
        own.protocol,
        data,
        constants=lambda m: (tuple(law(m).value for law in laws), scale(m)),
        stepper=own.stepper,
    )


def _scale(settings: Learn):
    """Picks the scale of the power, where that is learned too."""
    if settings.power_scale:
        return lambda model: model.sources[0].scale
    return lambda model: ()


def _at_rest(own: CaseModel, law: AbstractPerfusion) -> float:
    arterial = jnp.full(own.model.grid.shape, float(own.model.blood.arterial))
    return float(law(arterial).reshape(-1)[0])


def _start(own: CaseModel, settings: Learn, data: ProbeData) -> Bioheat:
    """The model with laws without shape yet, at the perfusion at rest.

    Each may vary up to the hottest reading of its own tissue.
    """
    arterial, model = float(own.model.blood.arterial), own.model
    weights = np.asarray(model.grid.interpolation(data.points))
    share = weights.reshape(len(weights), -1) @ np.asarray(own.target).reshape(-1)
    probes = {"tumour": share > 0.5, "tissue": share <= 0.5}
    for index, name in enumerate(settings.laws):
        law, read = LAWS[name], data.values[:, probes[name]]
        rest = _at_rest(own, law(model))
        top = float(np.nanmax(read)) if read.size else arterial + DEFAULT_RISE
        span = (arterial, max(top, arterial + 1.0))
        key = jax.random.fold_in(jax.random.key(settings.seed), index)
        started = (
            neural_perfusion(rest, span, key=key)
            if settings.kind == "network"
            else kernel_perfusion(rest, span)
        )
        model = eqx.tree_at(law, model, started)
    return model


DEFAULT_RISE = 6.0
"""Range [K] of the law of a tissue without a probe."""


def _readings(own: CaseModel, case: Case, settings: Learn, source: Path) -> ProbeData:
    if settings.data is not None:
        return load_probes(source.parent / settings.data)
    if case.probes is None:
        raise InputError(
            "learn: expected data, a CSV file, or probes whose readings are simulated"
        )
    return simulate_probes(
        own.model,
        own.protocol,
        own.points,
        every=float(case.probes.every),
        noise=float(settings.noise),
        key=jax.random.key(settings.seed),
        stepper=own.stepper,
    )


def _fit_metrics(fit: EvidenceFit, residuals: ProbeResiduals) -> dict[str, Any]:
    return {
        "outcome": str(fit.outcome),
        "iterations": fit.iterations,
        "residual": _rms(residuals(fit.model)),
        "noise": fit.hyperparameters.noise,
        "log_evidence": fit.hyperparameters.log_evidence,
        "constants": {
            name: {"value": value.value, "sd": value.sd}
            for name, value in fit.constants.items()
        },
    }


def _predicted(model, residuals: ProbeResiduals, data: ProbeData) -> np.ndarray:
    values = np.full(data.values.shape, np.nan).reshape(-1)
    values[np.asarray(residuals.index)] = np.asarray(
        residuals(model) + residuals.values
    )
    return values.reshape(data.values.shape)


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))


def _curves(own: CaseModel, settings: Learn, fit, arrays) -> dict[str, Any]:
    """Each learned law at some temperatures, with its band and, if known, its truth."""
    found = {}
    shares = {"tumour": own.target, "tissue": 1 - own.target}
    for name in settings.laws:
        visited = visited_range(fit.model, own.protocol, shares[name])
        at = np.linspace(float(own.model.blood.arterial), visited[1] + 1.0, 61)
        curve = perfusion_curve(fit.posterior, LAWS[name], at, visited)
        low, high = curve.band
        rows: dict[str, Any] = {"visited": list(visited)}
        stored = {"temperatures": at, "values": curve.values, "low": low, "high": high}
        stored["visited"] = curve.inside
        if settings.data is None:
            true = np.asarray(LAWS[name](own.model)(jnp.asarray(at)))
            covered = ((true >= low) & (true <= high))[curve.inside]
            rows["covered"], stored["true"] = float(covered.mean()), true
        arrays |= {f"law/{name}/{key}": value for key, value in stored.items()}
        found[name] = rows
    return found


def _held_out(own: CaseModel, learned, constant, power: float) -> dict[str, float]:
    """Largest errors of the field, and doses, where the power is another."""
    protocol = eqx.tree_at(
        lambda p: (p.starts, p.ends), own.protocol, replace_fn=lambda a: a * power**0.5
    )

    def ran(model):
        every = protocol.duration / 60
        return solve(model, protocol, stepper=own.stepper, save_every=every)

    true = ran(own.model)
    found = {"power": float(power), "true_dose": float(true.final.dose.max())}
    for name, model in (("learned", learned), ("constant", constant)):
        other = ran(model)
        error = float(jnp.abs(true.observed - other.observed).max())
        found |= {name: error, f"{name}_dose": float(other.final.dose.max())}
    return found
