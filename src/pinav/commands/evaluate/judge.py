"""What only a run of `pinav fit` leaves to judge: residuals, constants, bands."""

from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from pinav.commands.cells import as_cell
from pinav.commands.evaluate.setting import (
    Setting,
    force_fields,
    prediction,
    read_data,
)
from pinav.commands.fitted_run import FittedRun
from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.evaluation import (
    Bands,
    FieldMap,
    ParameterRecovery,
    Whiteness,
    calibrate,
    distances,
    estimated_start_bands,
    exact_start_bands,
    first_samples,
    force_coverage,
    rollout_coverage,
    trajectory_scores,
    whiteness,
    without_first,
)
from pinav.runs import RunFolder
from pinav.systems import System
from pinav.trajectories import Trajectories

BANDED = 16
"""How many clean held-out trajectories get bands, which take their time."""


def judge_fit(setting: Setting, folder: RunFolder, clean, results) -> None:
    """What only `pinav fit` leaves behind: residuals, constants, a posterior."""
    metrics, arrays = results
    if "model" not in setting.subject.models:
        return
    found = _residuals(setting.subject, folder)
    metrics["whiteness"] = _whiteness(found)
    arrays["autocorrelation"] = found.autocorrelation
    arrays["counts"] = np.array(found.counts)
    arrays["channels"] = np.array(found.channels)
    metrics["constants"] = _constants(setting)
    if setting.subject.posterior is not None:
        metrics["coverage"] = _coverage(setting, clean)


def _residuals(subject: FittedRun, folder: RunFolder) -> Whiteness:
    """Residuals of the training data, in units of the noise found."""
    training = subject.data
    if subject.evidence is None:
        fitted, noise = folder.read_arrays("results.npz")["ys"], 1.0
    else:
        fitted, noise = subject.evidence.states, subject.noise
    residuals = (training.states - fitted) / noise
    return whiteness(residuals, training.observed, training.channels)


def _whiteness(found: Whiteness) -> dict[str, Any]:
    return {
        name: {
            "residuals": found.counts[i],
            "statistic": as_cell(found.statistic[i]),
            "p_value": as_cell(found.p_value[i]),
            "autocorrelation": [as_cell(r) for r in found.autocorrelation[i]],
        }
        for i, name in enumerate(found.channels)
        if found.counts[i]
    }


def _constants(setting: Setting) -> list[dict[str, Any]]:
    """True and recovered value of each learned constant."""
    subject, truth = setting.subject, setting.truth
    paths = subject.choice.paths()
    if not paths or truth is None:
        return []
    constants = subject.constants
    found = []
    for name, path in paths.items():
        value = _true_constant(path, truth)
        if value is not None:
            sd = constants[name].sd
            known = None if np.isnan(sd) else sd
            found.append(ParameterRecovery(name, value, constants[name].value, known))
    return [
        vars(one) | {"relative_error": as_cell(one.relative_error), "z": one.z}
        for one in found
    ]


def _true_constant(path: str, truth: System) -> float | None:
    """Its value in the truth; None where the truth has no such number."""
    try:
        return float(attrgetter(path)(truth.swimmer))
    except (AttributeError, TypeError):
        return None


def _coverage(setting: Setting, clean: Trajectories | None) -> dict[str, Any]:
    """Share inside the nominal 95 % bands, by region."""
    subject, noise = setting.subject, setting.subject.noise
    bands, observed = _bands(setting, setting.data)
    rows = {
        "observations of the data": rollout_coverage(
            bands, observed, noise, _sample_regions(observed, setting)
        )
    }
    model = next(iter(subject.models.values()))
    if clean is not None and subject.posterior is not None:
        rows["rollouts from clean starts"] = _clean_coverage(setting, clean)
        if isinstance(model, Swimmer):
            learned, true = force_fields(model, setting)
            sd = subject.posterior.force_sd(_grid(true)).reshape(true.force.shape)
            masks = setting.regions.masks(true.distance)
            rows["force"] = force_coverage(learned, true, sd, masks)
    return {
        what: {region: as_cell(value) for region, value in row.items()}
        for what, row in rows.items()
    }


def _clean_coverage(setting: Setting, clean: Trajectories) -> dict[str, float]:
    """Coverage of the truth; the start itself, which is exact, does not count."""
    assert setting.subject.posterior is not None
    elapsed = clean.times[0] - clean.times[0, 0]
    samples = int((elapsed <= setting.subject.horizon * (1 + 1e-9)).sum())
    chosen = first_samples(clean.select(range(min(BANDED, len(clean)))), samples)
    bands = exact_start_bands(setting.subject.posterior, chosen)
    scored = without_first(chosen, 1)
    return rollout_coverage(bands, scored, 0.0, _sample_regions(scored, setting))


def _grid(field: FieldMap) -> np.ndarray:
    return np.stack(np.meshgrid(field.x, field.y), axis=-1).reshape(-1, 2)


def _bands(setting: Setting, data: Trajectories) -> tuple[Bands, Trajectories]:
    """Bands of what follows the estimated starts, or of unit width without any."""
    subject = setting.subject
    (model,) = subject.models.values()
    found = prediction(model, data, estimate=setting.estimate)
    if subject.posterior is None or found.starts is None:
        return Bands(found.ys, np.ones_like(found.ys)), found.observed
    bands = estimated_start_bands(subject.posterior, data, found.starts, subject.noise)
    return bands, found.observed


def _sample_regions(data: Trajectories, setting: Setting) -> dict[str, np.ndarray]:
    """Region of each sample, by its distance to the training data."""
    positions = data.states[..., :2]
    seen = distances(positions.reshape(-1, 2), setting.subject.data)
    return setting.regions.masks(seen.reshape(positions.shape[:-1]))


def conformal(setting: Setting, path: Path) -> dict[str, Any]:
    """A radius from the trajectories of a file, and how it fares on the data."""
    if "model" not in setting.subject.models:
        raise InputError("--calibrate: expected a run of pinav fit, with one model")
    noise = setting.subject.noise

    def banded(data: Trajectories):
        bands, observed = _bands(setting, data)
        return observed, bands.ys, bands.observable_sd(noise)

    found = calibrate(trajectory_scores(*banded(read_data(path, setting.subject))))
    covers = found.covers(*banded(setting.data))
    return {
        "file": path.name,
        "radius": as_cell(found.radius),
        "unit": "standard deviations of the band"
        if setting.subject.posterior is not None
        else "the unit of each channel",
        "count": found.count,
        "says": str(found),
        "covered": float(covers.mean()),
    }
