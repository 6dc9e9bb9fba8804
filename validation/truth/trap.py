"""Judging a bead in a trap, at rest or moving."""

import time

import numpy as np
from validation.truth.cases import Case, Recording
from validation.truth.known import TrapTruth, measured_lag, trap_truth
from validation.truth.metrics import BAND, Curve, Judgement, TruthRow, compare_estimates
from validation.truth.trap_fit import TrapFit, blur_factor, fit_trap

from pinav.fitting import Estimate

OF_TRUTH, OWN_SD, RATE, DRAGGED_SD = 0.03, 0.02, 0.05, 0.04
"""Bars: stiffness off its truth, its own error, rate off its truth, the error where the
trap moves; relative."""


def judge_trap(case: Case, recording: Recording) -> Judgement:
    """A trap at rest: stiffness and rate against variance and autocorrelation."""
    begun = time.perf_counter()
    times, positions = recording.times, recording.positions[:, 0]
    fit, heat = fit_trap(times, positions), _heat(case)
    truth = trap_truth(times, positions)
    learned, known = fit.stiffness(heat), truth.stiffness(heat)
    off = abs(learned.value / known.value - 1)
    naive = Estimate(heat / truth.recorded_variance, 0.0).value
    rows = (
        compare_estimates(
            "stiffness [pN/um]",
            known,
            learned,
            bar=f"within {OF_TRUTH:.0%}",
            met=off <= OF_TRUTH,
            naive=naive,
        ),
        _own_error("own sd of the stiffness [%]", learned, OWN_SD),
        compare_estimates(
            "relaxation rate [1/s]",
            truth.rate,
            fit.rate,
            bar=f"within {RATE:.0%}",
            met=abs(fit.rate.value / truth.rate.value - 1) <= RATE,
            naive=truth.naive_rate,
        ),
    )
    seconds = time.perf_counter() - begun
    return Judgement(rows, (_correlation(fit, truth),), _notes(fit, truth), seconds)


def judge_dragged_trap(case: Case, recording: Recording) -> Judgement:
    """A moving trap: stiffness against a known one and its halves, and the lag."""
    begun = time.perf_counter()
    drive = recording.drive
    assert drive is not None  # checked with the description
    times, positions, heat = recording.times, recording.positions[:, 0], _heat(case)
    truth = trap_truth(times, positions - drive)
    fit = fit_trap(times, positions, drive=drive)
    learned, constants = fit.stiffness(heat), case.description.constants
    known, bar = truth.stiffness(heat), "within 2 sd"
    if constants.stiffness_pN_um is not None:
        sd = constants.stiffness_error_pN_um or 0.0
        known = Estimate(constants.stiffness_pN_um, sd)
        bar = f"from {known.value - 2 * sd:.4g} to {known.value + 2 * sd:.4g}"
        inside = abs(learned.value - known.value) <= 2 * sd
    else:
        both = np.hypot(known.sd, learned.sd)
        inside = bool(abs(learned.value - known.value) <= 2 * both)
    middle = len(times) // 2
    first, second = (
        fit_trap(times[part], positions[part], drive=drive[part]).stiffness(heat)
        for part in (slice(middle), slice(-middle, None))
    )
    rows = (
        compare_estimates(
            "stiffness [pN/um]",
            known,
            learned,
            bar=bar,
            met=inside,
            naive=heat / truth.recorded_variance,
        ),
        _own_error("own sd of the stiffness [%]", learned, DRAGGED_SD),
        _halves(first, second),
        _lag(measured_lag(times, positions, drive), fit, truth),
    )
    seconds = time.perf_counter() - begun
    return Judgement(rows, (_correlation(fit, truth),), _notes(fit, truth), seconds)


def _heat(case: Case) -> float:
    heat = case.description.constants.heat
    assert heat is not None  # checked with the description
    return heat


def _own_error(quantity: str, learned: Estimate, most: float) -> TruthRow:
    part = learned.sd / learned.value
    return TruthRow(
        quantity=quantity,
        learned=100 * part,
        bar=f"at most {100 * most:g} %",
        met=part <= most,
    )


def _halves(first: Estimate, second: Estimate) -> TruthRow:
    apart = abs(first.value - second.value) / float(np.hypot(first.sd, second.sd))
    return TruthRow(
        quantity=f"stiffness of the halves, {first.value:.3f} and {second.value:.3f}: "
        "apart [sd]",
        truth=0.0,
        learned=apart,
        bar="at most 2 sd",
        met=apart <= 2,
    )


def _lag(measured: Estimate, fit: TrapFit, truth: TrapTruth) -> TruthRow:
    in_ms = [Estimate(1e3 * e.value, 1e3 * e.sd) for e in (measured, fit.relaxation)]
    apart = abs(in_ms[0].value - in_ms[1].value)
    met = apart <= 2 * float(np.hypot(in_ms[0].sd, in_ms[1].sd))
    naive = 1e3 / truth.naive_rate
    return compare_estimates(
        "lag over speed [ms]", *in_ms, bar="within 2 sd", met=met, naive=naive
    )


def _notes(fit: TrapFit, truth: TrapTruth) -> tuple[str, ...]:
    frames = fit.exposure.value / truth.interval
    error = BAND * fit.exposure.sd / truth.interval
    notes = [
        f"Effective exposure {frames:.2f} ± {error:.2f} frames (95 %), localisation "
        f"error {1e3 * fit.error.value:.1f} nm, D {fit.diffusion.value:.4f} ± "
        f"{BAND * fit.diffusion.sd:.4f} um²/s, relaxation "
        f"{1e3 * fit.relaxation.value:.1f} ms.",
        "Correlations of the innovations at lags 1 to 5: "
        + ", ".join(f"{part:.3f}" for part in fit.correlations)
        + ".",
    ]
    if fit.advantage is not None:
        words = f"A wandering trap has {fit.advantage:+.1f} nats of evidence"
        if fit.wander is not None and fit.memory is not None:
            words += (
                f": {1e3 * fit.wander.value:.0f} nm for {fit.memory.value:.2g} s; it "
                "is part of the fit"
            )
        notes.append(f"{words}.")
    return tuple(notes)


def _correlation(fit: TrapFit, truth: TrapTruth) -> Curve:
    """The autocovariance of the fitted trap beside the measured one."""
    lags = truth.interval * np.arange(len(truth.correlation))
    rate, ratio = fit.rate.value, fit.rate.value * fit.exposure.value
    variance = 1 / fit.rate_over_diffusion.value
    apart = 2 * (np.cosh(ratio) - 1) / ratio**2 * np.exp(-rate * lags)
    apart[0] = float(blur_factor(ratio))
    learned = variance * apart
    learned[0] += fit.error.value**2
    if fit.wander is not None and fit.memory is not None:
        learned += fit.wander.value**2 * np.exp(-lags / fit.memory.value)
    part = fit.rate_over_diffusion.sd / fit.rate_over_diffusion.value
    spread = np.hypot(part, lags * fit.rate.sd)
    return Curve(
        "autocovariance of the bead",
        ("lag [ms]", "autocovariance [nm²]"),
        1e3 * lags,
        1e6 * learned,
        1e6 * learned * spread,
        1e6 * truth.correlation,
        1e6 * truth.correlation_sd,
    )
