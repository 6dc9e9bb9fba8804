"""Scores that say where a fit can be trusted, as one value.

Rollouts over time, from the data given and from clean starts that no fit has seen;
force by region; bands; residuals; learned constants.
"""

from collections.abc import Mapping

import equinox as eqx
import numpy as np

from pinav.dynamics import AbstractDynamics, AbstractSwimmer, Outcome
from pinav.evaluation.force_fields import Agreement, Regions, force_agreement
from pinav.evaluation.judgement import (
    CalibratedBand,
    Coverage,
    ParameterRecovery,
    band_coverage,
    calibrate_band,
    recovered_constants,
    residual_whiteness,
)
from pinav.evaluation.rollouts import (
    ErrorCurve,
    RolloutSummary,
    error_curve,
    position_errors,
    summarise,
)
from pinav.evaluation.scores import Whiteness, score
from pinav.evaluation.setting import Prediction, Setting, held_out, predict_rollouts
from pinav.fitting import AbstractLearned
from pinav.trajectories import Trajectories

EXTENSION = 2.0
"""Training horizons that clean held-out rollouts last."""

BASELINE = "physics-only"
"""Name of the known physics alone."""

WITHIN = "within the training horizon"
"""Name of the part of a rollout that is as long as the training data."""

BEYOND = "beyond it"
"""Name of the part after that."""

WORSE = 1.1
"""Error relative to that of the known physics above which a warning is due."""


class Evaluation(eqx.Module):
    """Scores of the models of a fit, and of the known physics alone.

    Attributes:
        has_estimated_starts: each start was estimated from the first samples with the
            model fixed, and only the samples after them are scored; else rollouts
            begin at the first sample.
        domain: extent of the training data [L]; rollouts that err by more diverged.
        rmse: root-mean-square errors by model and channel, and the number of rollouts
            that diverged.
        rollouts: errors by model, source of starts and part of the time.
        curves: errors over time by model and source of starts.
        force: agreement with the truth by model and region, where it is known and
            planar.
        num_training: number of scored trajectories that the fit has seen.
        units: of channels and time; "1" where dimensionless, "?" where not stated.
        whiteness: of the residuals; None of several models.
        coverage: fraction inside nominal 95 % bands, by what and region; None without
            a posterior.
        calibration: a conformal band; None where no trajectories were given for it.
        notes: sentences on what was left out, and why.
    """

    DERIVED = ("worse_than_physics",)

    data: str
    trajectories: int
    has_estimated_starts: bool
    regions: Regions
    domain: float
    horizon: float
    rmse: dict[str, dict[str, float]]
    rollouts: dict[str, dict[str, dict[str, RolloutSummary]]]
    curves: dict[str, dict[str, ErrorCurve]]
    force: dict[str, dict[str, Agreement]]
    num_training: int
    units: dict[str, str]
    whiteness: Whiteness | None = None
    constants: tuple[ParameterRecovery, ...] = ()
    coverage: dict[str, Coverage] | None = None
    calibration: CalibratedBand | None = None
    notes: tuple[str, ...] = ()

    def median_error(self, model: str) -> float:
        """Median position error within the training horizon [L]; NaN without one."""
        summary = self.rollouts[model]["data"].get(WITHIN)
        return np.nan if summary is None else summary.median

    @property
    def worse_than_physics(self) -> tuple[str, ...]:
        """Models whose rollouts err more than those of the known physics alone."""
        if not self.rollouts.get(BASELINE):
            return ()
        most = WORSE * self.median_error(BASELINE)
        return tuple(name for name in self.rollouts if self.median_error(name) > most)


def evaluate(
    fit: AbstractLearned,
    data: Trajectories,
    *,
    calibration: Trajectories | None = None,
    regions: Regions | None = None,
    names: tuple[str, str] = ("the data", "calibration"),
) -> Evaluation:
    """Score every model of a fit on trajectories.

    Args:
        data: trajectories to score: others than were fitted, or the scores are said to
            be training errors.
        calibration: further trajectories, from which conformal bands are calibrated.
        regions: lengths of the regions; chosen from the training data unless given.

    Raises:
        InputError: the data are not those of the fitted system, or `calibration` holds
            training data.
    """
    setting = Setting.of(fit, data, regions)
    clean = clean_trajectories(setting)
    baseline = {BASELINE: fit.system.swimmer.without_environment()}
    models = dict(fit.models) | baseline
    predictions = {
        model: _predictions(dynamics, setting, clean)
        for model, dynamics in models.items()
    }
    rollouts, curves = _rollouts(predictions, setting)
    is_single = len(fit.models) == 1
    return Evaluation(
        data=names[0],
        trajectories=len(setting.data),
        has_estimated_starts=setting.estimates_starts,
        regions=setting.regions,
        domain=setting.domain,
        horizon=fit.horizon,
        rmse={model: _errors(each["data"]) for model, each in predictions.items()},
        rollouts=rollouts,
        curves=curves,
        force=_forces(models, setting),
        num_training=fit.shared_trajectories(setting.data),
        units=dict(fit.data.units),
        whiteness=residual_whiteness(setting) if is_single else None,
        constants=recovered_constants(setting) if is_single else (),
        coverage=band_coverage(setting, clean) if is_single else None,
        calibration=None
        if calibration is None
        else calibrate_band(setting, calibration, names[1]),
        notes=setting.notes,
    )


def clean_trajectories(setting: Setting) -> Trajectories | None:
    """Held-out trajectories of the truth, beyond the training horizon."""
    if setting.truth is None or setting.truth.rule is None:
        return None
    return held_out(setting.truth, until=EXTENSION * setting.fit.horizon)


def _predictions(
    model: AbstractDynamics, setting: Setting, clean: Trajectories | None
) -> dict[str, Prediction]:
    estimate = setting.estimates_starts
    sources = {"data": predict_rollouts(model, setting.data, estimate=estimate)}
    if clean is not None:
        sources["clean starts"] = predict_rollouts(model, clean, estimate=False)
    return sources


def _errors(prediction: Prediction) -> dict[str, float]:
    scored = score(prediction.ys, prediction.outcomes, prediction.observed)
    diverged = sum(end is not Outcome.SUCCESS for end in prediction.outcomes)
    return scored.by_name() | {"diverged": diverged}


def _rollouts(
    predictions: Mapping[str, Mapping[str, Prediction]], setting: Setting
) -> tuple[
    dict[str, dict[str, dict[str, RolloutSummary]]], dict[str, dict[str, ErrorCurve]]
]:
    summaries, curves = {}, {}
    horizon = setting.fit.horizon * (1 + 1e-9)
    for model, sources in predictions.items():
        summaries[model], curves[model] = {}, {}
        for source, prediction in sources.items():
            errors = position_errors(
                prediction.ys, prediction.observed, domain=setting.domain
            )
            curves[model][source] = error_curve(errors)
            parts = {
                WITHIN: summarise(errors, until=horizon),
                BEYOND: summarise(errors, after=horizon),
            }
            summaries[model][source] = {
                part: summary for part, summary in parts.items() if summary.trajectories
            }
    return summaries, curves


def _forces(
    models: Mapping[str, AbstractDynamics], setting: Setting
) -> dict[str, dict[str, Agreement]]:
    if setting.truth is None or not setting.is_planar:
        return {}
    return {
        name: force_agreement(*setting.force_fields(model), setting.regions)
        for name, model in models.items()
        if isinstance(model, AbstractSwimmer)
    }
