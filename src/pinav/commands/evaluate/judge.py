"""Residuals, constants and bands: the judgement of the one model of a fit."""

from operator import attrgetter
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from pinav.commands.cells import Cell, as_cell
from pinav.commands.evaluate.metrics import (
    CalibrationRow,
    ConstantRow,
    ResidualRow,
)
from pinav.commands.evaluate.setting import Setting, predict_rollouts, read_scored
from pinav.commands.recording_settings import RecordingSettings
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.evaluation import (
    Bands,
    ParameterRecovery,
    Whiteness,
    calibrate,
    distances,
    estimated_start_bands,
    exact_start_bands,
    first_samples,
    force_coverage,
    increment_residuals,
    predict,
    rollout_coverage,
    trajectory_scores,
    whiteness,
    without_first,
)
from pinav.learning.learned import Learned
from pinav.systems import System
from pinav.trajectories import Trajectories

BANDED = 16
"""Number of clean held-out trajectories with bands, which take their time."""

Coverage = dict[str, float]


def residual_whiteness(setting: Setting) -> Whiteness | None:
    """Whiteness of the residuals on the training data.

    Observed less fitted states in units of the noise; for stochastic paths their
    increments, less the drift of the model, in units of the diffusion. None beside a
    wandering velocity, which a fit integrates out, so that it has no fitted states.
    """
    run, training = setting.run, setting.run.data
    if run.wandering is not None:
        return None
    if setting.diffusion is not None:
        residuals, observed = increment_residuals(
            run.model, training, setting.diffusion
        )
        return whiteness(residuals, observed, training.channels)
    if run.evidence is None:
        fitted, noise = predict(run.model, training)[0], 1.0
    else:
        fitted, noise = run.evidence.states, run.noise
    residuals = (training.states - fitted) / noise
    return whiteness(residuals, training.observed, training.channels)


def residual_rows(test: Whiteness) -> dict[str, ResidualRow]:
    """The test by channel, for those with residuals."""
    return {
        name: ResidualRow(
            residuals=test.counts[i],
            statistic=as_cell(test.statistic[i]),
            p_value=as_cell(test.p_value[i]),
            autocorrelation=tuple(map(as_cell, test.autocorrelation[i])),
        )
        for i, name in enumerate(test.channels)
        if test.counts[i]
    }


def recovered_constants(setting: Setting) -> tuple[ConstantRow, ...]:
    """True and learned value of each learned constant, where the truth is known."""
    if setting.truth is None:
        return ()
    rows = []
    for name, path in setting.run.choice.paths().items():
        true = _constant(path, setting.truth)
        value, sd = _learned_constant(name, path, setting.run)
        if true is not None and value is not None:
            pair = ParameterRecovery(name, true, value, sd)
            error = as_cell(pair.relative_error)
            rows.append(ConstantRow(name, true, value, sd, error, pair.z))
    return tuple(rows)


def _constant(path: str, truth: System) -> float | None:
    """Its value in the truth; None where the truth has no such number."""
    try:
        return float(attrgetter(path)(truth.true_swimmer))
    except (AttributeError, TypeError):
        return None


def _learned_constant(
    name: str, path: str, run: Learned
) -> tuple[float | None, float | None]:
    """Value and standard deviation of a learned constant."""
    if run.evidence is not None and name in run.evidence.constants:
        estimate = run.evidence.constants[name]
        return estimate.value, estimate.sd
    try:
        return float(attrgetter(path)(run.model)), None
    except (AttributeError, TypeError):
        return None, None


def coverage_rows(
    setting: Setting, clean: Trajectories | None
) -> dict[str, dict[str, Cell]] | None:
    """Fraction inside the nominal 95 % bands, by region; None without a posterior.

    Rollouts of stochastic paths have no band: a band of the mean says nothing of one
    realisation.
    """
    run, rows = setting.run, {}
    if run.posterior is None:
        return None
    if setting.diffusion is None:
        bands, observed = _bands(setting, setting.data)
        regions = _sample_regions(observed, setting)
        rows["observations of the data"] = rollout_coverage(
            bands, observed, run.noise, regions
        )
        if clean is not None:
            rows["rollouts from clean starts"] = _clean_coverage(setting, clean)
    model = run.model
    known = setting.truth is not None and setting.planar
    if known and isinstance(model, Swimmer | OverdampedSwimmer):
        learned, true = setting.force_fields(model)
        sd = run.force_sd(true)
        masks = setting.regions.masks(true.distance)
        rows["force"] = force_coverage(learned, true, sd, masks)
    return {
        what: {region: as_cell(value) for region, value in row.items()}
        for what, row in rows.items()
    }


def _clean_coverage(setting: Setting, clean: Trajectories) -> Coverage:
    """Coverage of the truth; the start itself, which is exact, does not count."""
    assert setting.run.posterior is not None
    elapsed = clean.times[0] - clean.times[0, 0]
    samples = int((elapsed <= setting.run.horizon * (1 + 1e-9)).sum())
    chosen = first_samples(clean.select(range(min(BANDED, len(clean)))), samples)
    bands = exact_start_bands(
        setting.run.posterior, chosen, wandering=setting.run.wandering
    )
    scored = without_first(chosen, 1)
    return rollout_coverage(bands, scored, 0.0, _sample_regions(scored, setting))


def _bands(setting: Setting, data: Trajectories) -> tuple[Bands, Trajectories]:
    """Bands of what follows the estimated starts, or of unit width without any."""
    run = setting.run
    prediction = predict_rollouts(run.model, data, estimate=setting.estimate)
    if run.posterior is None or prediction.starts is None:
        unit = np.ones_like(prediction.ys)
        return Bands(prediction.ys, unit), prediction.observed
    bands = estimated_start_bands(
        run.posterior, data, prediction.starts, run.noise, wandering=run.wandering
    )
    return bands, prediction.observed


def _sample_regions(
    data: Trajectories, setting: Setting
) -> dict[str, Bool[np.ndarray, "trajectory time"]]:
    """Region of each sample, by its distance to the training data."""
    flat = data.positions.reshape(-1, data.dim)
    distance = distances(flat, setting.run.data)
    return setting.regions.masks(distance.reshape(data.positions.shape[:-1]))


def calibrate_band(
    setting: Setting, path: Path, recording: RecordingSettings
) -> CalibrationRow:
    """A conformal radius from the trajectories of a file, and how it fares.

    Raises:
        InputError: the run has several models, the file cannot be read, or holds
            training data.
    """
    if len(setting.run.models) != 1:
        raise InputError("--calibrate: expected a run of pinav fit, with one model")
    held, _ = read_scored(path, setting.run, recording)
    if setting.run.is_training_data(held):
        raise InputError(
            f"--calibrate {path}: expected trajectories that no fit has seen, got "
            "training data of the run; give others"
        )
    radius = calibrate(trajectory_scores(*_prediction_bands(setting, held)))
    covers = radius.covers(*_prediction_bands(setting, setting.data))
    return CalibrationRow(
        file=path.name,
        radius=as_cell(radius.radius),
        unit="standard deviations of the band"
        if setting.run.posterior is not None
        else "the unit of each channel",
        count=radius.count,
        says=str(radius),
        covered=float(covers.mean()),
    )


def _prediction_bands(
    setting: Setting, data: Trajectories
) -> tuple[
    Trajectories,
    Float[np.ndarray, "trajectory time state"],
    Float[np.ndarray, "trajectory time state"],
]:
    """What was observed, predictions and their standard deviations."""
    bands, observed = _bands(setting, data)
    return observed, bands.ys, bands.observable_sd(setting.run.noise)
