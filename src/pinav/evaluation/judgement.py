"""Residuals, constants and bands: the judgement of the one model of a fit."""

from operator import attrgetter

import equinox as eqx
import numpy as np
from jaxtyping import Bool

from pinav.dynamics import AbstractSwimmer
from pinav.errors import InputError
from pinav.evaluation.conformal import (
    Calibration,
    Samples,
    calibrate,
    trajectory_scores,
)
from pinav.evaluation.coverage import (
    Bands,
    force_coverage,
    rollout_bands,
    rollout_coverage,
)
from pinav.evaluation.force_fields import distances
from pinav.evaluation.scores import Whiteness, increment_residuals, predict, whiteness
from pinav.evaluation.setting import Setting, predict_rollouts, select_scored
from pinav.evaluation.starts import first_samples, without_first
from pinav.systems import System
from pinav.trajectories import Trajectories

BANDED = 16
"""Number of clean held-out trajectories with bands, which take their time."""

Coverage = dict[str, float]
"""Fraction inside the nominal 95 % bands, by region."""


class ParameterRecovery(eqx.Module):
    """A learned constant beside its truth, in one unit."""

    DERIVED = ("relative_error", "z")

    name: str
    true: float
    value: float
    sd: float | None
    unit: str = "?"

    @property
    def relative_error(self) -> float:
        """Learned value over the true one, less 1; NaN where the truth is zero."""
        return self.value / self.true - 1.0 if self.true else float("nan")

    @property
    def z(self) -> float | None:
        """Error in standard deviations; beyond 2 or 3 the interval is wrong."""
        return None if not self.sd else (self.value - self.true) / self.sd


class CalibratedBand(eqx.Module):
    """A conformal band from trajectories that no fit has seen, and how it fares.

    Attributes:
        has_posterior: the radius is in standard deviations of the band of the fit, not
            in the unit of each channel.
        covered: fraction of the scored trajectories inside.
    """

    DERIVED = ("says",)

    data: str
    band: Calibration
    has_posterior: bool
    covered: float

    @property
    def says(self) -> str:
        """The band in words."""
        return str(self.band)


def residual_whiteness(setting: Setting) -> Whiteness | None:
    """Whiteness of the residuals on the training data.

    Observed less fitted states in units of the noise; for stochastic paths their
    increments, less the drift of the model, in units of the diffusion. None beside a
    wandering velocity, which a fit integrates out, so that it has no fitted states.
    """
    fit, training = setting.fit, setting.fit.data
    if fit.wandering is not None:
        return None
    if setting.diffusion is not None:
        residuals, observed = increment_residuals(
            fit.model, training, setting.diffusion
        )
        return whiteness(residuals, observed, training.channels)
    if fit.evidence is None:
        states, noise = predict(fit.model, training)[0], 1.0
    else:
        states, noise = fit.evidence.states, fit.noise
    residuals = (training.states - states) / noise
    return whiteness(residuals, training.observed, training.channels)


def recovered_constants(setting: Setting) -> tuple[ParameterRecovery, ...]:
    """True and learned value of each learned constant, where the truth is known."""
    if setting.truth is None:
        return ()
    learned = setting.fit.constants
    recovered = []
    for name, path in setting.fit.choice.paths().items():
        true = _true_constant(path, setting.truth)
        if true is not None and name in learned:
            value, sd = learned[name].value, learned[name].sd
            known_sd = None if np.isnan(sd) else sd
            unit = learned[name].unit
            recovered.append(ParameterRecovery(name, true, value, known_sd, unit))
    return tuple(recovered)


def _true_constant(path: str, truth: System) -> float | None:
    """Its value in the truth; None where the truth has no such number."""
    try:
        return float(attrgetter(path)(truth.true_swimmer))
    except (AttributeError, TypeError):
        return None


def band_coverage(
    setting: Setting, clean: Trajectories | None
) -> dict[str, Coverage] | None:
    """Coverage of observations, rollouts and force; None without a posterior.

    Rollouts of stochastic paths have no band: a band of the mean says nothing of one
    realisation.
    """
    fit, model = setting.fit, setting.fit.model
    if fit.posterior is None:
        return None
    coverage: dict[str, Coverage] = {}
    if setting.diffusion is None:
        bands, observed = _bands(setting, setting.data)
        regions = _sample_regions(observed, setting)
        coverage["observations of the data"] = rollout_coverage(
            bands, observed, fit.noise, regions
        )
        if clean is not None:
            coverage["rollouts from clean starts"] = _clean_coverage(setting, clean)
    is_known = setting.truth is not None and setting.is_planar
    if is_known and isinstance(model, AbstractSwimmer):
        learned, true = setting.force_fields(model)
        sd = fit.posterior.force_sd(true.points).reshape(true.force.shape)
        masks = setting.regions.masks(true.distance)
        coverage["force"] = force_coverage(learned, true, sd, masks)
    return coverage


def _clean_coverage(setting: Setting, clean: Trajectories) -> Coverage:
    """Coverage of the truth; the start itself, which is exact, does not count."""
    fit = setting.fit
    assert fit.posterior is not None
    elapsed = clean.times[0] - clean.times[0, 0]
    samples = int((elapsed <= fit.horizon * (1 + 1e-9)).sum())
    chosen = first_samples(clean.select(range(min(BANDED, len(clean)))), samples)
    bands = rollout_bands(fit.posterior, chosen, wandering=fit.wandering)
    scored = without_first(chosen, 1)
    return rollout_coverage(bands, scored, 0.0, _sample_regions(scored, setting))


def _bands(setting: Setting, data: Trajectories) -> tuple[Bands, Trajectories]:
    """Bands of what follows the estimated starts, or of unit width without any."""
    fit = setting.fit
    prediction = predict_rollouts(fit.model, data, estimate=setting.estimates_starts)
    if fit.posterior is None or prediction.starts is None:
        unit = np.ones_like(prediction.ys)
        return Bands(prediction.ys, unit), prediction.observed
    bands = rollout_bands(
        fit.posterior,
        data,
        prediction.starts,
        noise=fit.noise,
        wandering=fit.wandering,
    )
    return bands, prediction.observed


def _sample_regions(
    data: Trajectories, setting: Setting
) -> dict[str, Bool[np.ndarray, "trajectory time"]]:
    flat = data.positions.reshape(-1, data.dim)
    distance = distances(flat, setting.fit.data)
    return setting.regions.masks(distance.reshape(data.positions.shape[:-1]))


def calibrate_band(
    setting: Setting, calibration: Trajectories, name: str
) -> CalibratedBand:
    """A conformal radius from further trajectories, and how it fares."""
    fit = setting.fit
    if len(fit.models) != 1:
        raise InputError("--calibrate: expected a run of pinav fit, with one model")
    held, _ = select_scored(calibration, fit)
    if fit.shared_trajectories(held):
        raise InputError(
            "--calibrate: expected trajectories that no fit has seen, got training "
            "data of the run; give others"
        )
    band = calibrate(trajectory_scores(*_prediction_bands(setting, held)))
    covers = band.covers(*_prediction_bands(setting, setting.data))
    return CalibratedBand(name, band, fit.posterior is not None, float(covers.mean()))


def _prediction_bands(
    setting: Setting, data: Trajectories
) -> tuple[Trajectories, Samples, Samples]:
    """Observations, predictions and standard deviations."""
    bands, observed = _bands(setting, data)
    return observed, bands.ys, bands.observable_sd(setting.fit.noise)
