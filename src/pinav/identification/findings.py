"""Findings of a recording, supported or not, in words with their numbers."""

import math

import equinox as eqx
import numpy as np

from pinav.errors import InputError
from pinav.evaluation import normal_quantile
from pinav.fitting import Estimate, EvidenceFit
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.identification.baselines import restoring_force
from pinav.identification.candidates import (
    axis_gains,
    drift_only,
    gain_matrix,
    like,
    scalar_gain,
    with_learned,
    with_response,
)
from pinav.identification.drive import RESPONSES, gain_of, response_name
from pinav.identification.estimates import estimates as estimates_of
from pinav.identification.fit import fit_track
from pinav.identification.parameters import DELAY
from pinav.identification.selection import LEAST_SQUARES, Row, Selection
from pinav.identification.tracks import Track
from pinav.recordings.drive import pairs_apart
from pinav.systems import System

TURNING_WINDOW = 2.0
"""Turning rates are taken over this time [s]."""

CONSTANT_TURNING = 0.1
"""Relative spread of the turning rate below which it counts as constant."""

ALIGNED = math.radians(30.0)
"""Heading offsets up to this are taken for zero where a delay is sought."""


def positive_interval(estimate: Estimate) -> tuple[float, float]:
    """Interval of 95 % of a positive number, symmetric in its logarithm."""
    factor = math.exp(min(normal_quantile() * estimate.sd / estimate.value, 50.0))
    return estimate.value / factor, estimate.value * factor


def turning_rate(track: Track) -> tuple[float, float]:
    """Median turning rate of the heading [rad/s]; its relative spread (central 80 %).

    The spread is infinite where the median is zero.
    """
    rates = []
    for piece in track.pieces:
        turned = np.unwrap(piece.commands["heading"])
        first, last = pairs_apart(piece.times, TURNING_WINDOW)
        driven = piece.commands["frequency"][first] > 0
        first, last = first[driven], last[driven]
        interval = piece.times[last] - piece.times[first]
        rates.append((turned[last] - turned[first]) / interval)
    values = np.concatenate(rates)
    if not len(values):
        return 0.0, math.inf
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    if abs(middle) < 1e-3:
        return float(middle), math.inf
    return float(middle), float((high - low) / 2 / abs(middle))


class DelayFindings(eqx.Module):
    """Delay and heading offset of a track.

    Attributes:
        free: the delay beside any gain matrix [s].
        offset: the heading offset that belongs to it [rad].
        offset_without_delay: the heading offset without a delay [rad].
        zero_offset: the delay with a gain for each axis and no turn [s]; None where
            the offset without delay is not small.
        confounded: True if the turning rate is constant, which makes delay and offset
            one number.
    """

    free: Estimate
    offset: Estimate
    offset_without_delay: Estimate
    zero_offset: Estimate | None
    turning_rate: float
    confounded: bool


def delay_findings(track: Track, system: System, fit: EvidenceFit) -> DelayFindings:
    """The delay with the heading offset fixed at zero, and with both free."""
    response = response_name(system.swimmer)

    def refit(candidate: System) -> dict[str, Estimate]:
        """Estimates of a candidate: of the fit at hand where it is the same one."""
        same = candidate.name == system.name
        return estimates_of(fit if same else fit_track(track, candidate, start=fit))

    matrix = with_response(gain_matrix(), response)
    without = refit(matrix)["heading offset"]
    both = refit(with_learned(matrix, "delay", DELAY))
    rate, spread = turning_rate(track)
    zero_offset = None
    if abs(without.value) < ALIGNED:
        aligned = with_learned(with_response(axis_gains(), response), "delay", DELAY)
        zero_offset = refit(aligned)["delay"]
    return DelayFindings(
        free=both["delay"],
        offset=both["heading offset"],
        offset_without_delay=without,
        zero_offset=zero_offset,
        turning_rate=rate,
        confounded=spread < CONSTANT_TURNING,
    )


def finding_sentences(
    selection: Selection, estimates: dict[str, Estimate], delays: DelayFindings | None
) -> list[str]:
    """The verdict on one track.

    Args:
        delays: none where nothing was commanded, or the chosen candidate rolls not.
    """
    commanded = selection.train.commanded
    responses = RESPONSES if delays is not None else ()
    nats = {
        response: selection.evidence(with_response(gain_matrix(), response).name)
        for response in responses
    }
    response = response_name(selection.system.swimmer)
    rows = selection.row(selection.chosen), selection.row(LEAST_SQUARES)
    sentences = [choice(selection.chosen, response, nats), *shortcomings(*rows)]
    if not commanded:
        recorded = "frequency" in selection.train.pieces[0].commands
        idle = "The commands ask for no motion" if recorded else "No commands recorded"
        sentences.append(f"{idle}: gain, delay and heading cannot be known.")
        sentences.append(_restoring(selection))
    else:
        sentences.append(_propulsion(selection))
        if delays is not None:
            sentences += [_response(selection, estimates), _delay(delays)]
        sentences.append(_gain(selection, "lag", "a lag of the heading"))
        sentences.append(_wandering(selection))
        sentences.append(extrapolation(selection.train, selection.held_out))
    sentences.append(_gain(selection, "time-dependent drift", "a drift that changes"))
    sentences += [
        _gain(selection, name, f"a velocity that depends on position ({name})")
        for name in ("Gaussian process", "potential")
    ]
    return [sentence for sentence in sentences if sentence]


def choice(chosen: str, response: str, evidence: dict[str, float]) -> str:
    """The chosen model, and why it is that one where another has more evidence."""
    best = max(evidence, key=lambda name: evidence[name], default=response)
    if best == response:
        return f"The evidence chooses: {chosen}."
    more = evidence[best] - evidence[response]
    return (
        f"Chosen: {chosen}. The evidence does not decide the response, {best} is "
        f"{more:.1f} nats ahead of {response}; {response} is kept, because it contains "
        "the linear and the saturating law and claims least where the recording ends."
    )


FEEBLE = 0.1
"""Share of the held-out velocity's variance below which a prediction says nothing."""

HORIZON = 10.0
"""Length of the rollouts by which a model is judged [s]."""


def shortcomings(row: Row, baseline: Row) -> list[str]:
    """Sentences on a prediction that is poor, or judged on little; mostly none."""
    sentences = []
    if row.velocity_r2 < FEEBLE:
        sentences.append(
            f"The chosen model explains {100 * max(row.velocity_r2, 0.0):.0f} % of the "
            f"held-out velocity's variance (R² {row.velocity_r2:.2f}): it predicts "
            "little of the motion."
        )
    ours, theirs = row.over(HORIZON), baseline.over(HORIZON)
    if ours is None or theirs is None or not ours.rollouts:
        sentences.append(
            f"No held-out rollout of {HORIZON:g} s: the prediction is not judged."
        )
        return sentences
    if ours.rollouts == 1:
        sentences.append(
            f"The error over {HORIZON:g} s is that of a single rollout, which says "
            "little about others."
        )
    if ours.relative > theirs.relative:
        sentences.append(
            f"On the held-out part the chosen model loses to least squares: "
            f"{ours.relative:.3f} against {theirs.relative:.3f} of the path over "
            f"{HORIZON:g} s."
        )
    return sentences


def extrapolation(train: Track, held_out: Track) -> str:
    """A sentence where the held-out part is faster than all that trained, or ""."""
    observed, asked = (
        max(float(piece.commands["frequency"].max()) for piece in part.pieces)
        for part in (train, held_out)
    )
    if asked <= BEYOND * observed:
        return ""
    return (
        f"The held-out part is driven at up to {asked:.3g} Hz, the training part at up "
        f"to {observed:.3g} Hz: errors and bands there hang on how the response goes "
        "on."
    )


BEYOND = 1.05
"""Ratio of frequencies above which a prediction extrapolates."""


def _propulsion(selection: Selection) -> str:
    gain, matrix = (
        selection.evidence(selection.chosen)
        - selection.evidence(like(base, selection.system).name)
        for base in (drift_only(), scalar_gain())
    )
    text = f"Propulsion by the command: {_words(gain)}."
    if gain_of(selection.system.swimmer) is None:
        return text
    return (
        f"{text} A gain matrix with drift, over one number and the heading as "
        f"recorded: {_words(matrix)}."
    )


def _response(selection: Selection, estimates: dict[str, Estimate]) -> str:
    linear = selection.evidence(gain_matrix().name)
    chosen = response_name(selection.system.swimmer)
    if chosen == "linear":
        return "Saturation in frequency: not supported; the speed is linear in it."
    difference = selection.evidence(with_response(gain_matrix(), chosen).name) - linear
    text = f"Loss of gain with frequency ({chosen}): {_words(difference)}"
    if "corner" in estimates:
        corner = estimates["corner"]
        low, high = positive_interval(corner)
        text += f", corner {corner.value:.3g} Hz ({_range(low, corner.value, high)})"
    if "residual" in estimates:
        text += f", residual gain {_plus_minus(estimates['residual'])}"
    return text + "."


def _delay(delays: DelayFindings) -> str:
    if delays.confounded:
        offset, rate = delays.offset_without_delay, delays.turning_rate
        text = (
            "Delay and heading offset are confounded, because the heading turns at a "
            f"constant rate ({math.degrees(rate):.0f} degrees/s): without delay the "
            f"offset is {_offset(offset)}, and every 0.1 s of "
            f"delay turns it by {math.degrees(0.1 * rate):.1f}."
        )
    else:
        text = (
            f"Delay {_plus_minus(delays.free)} s with the heading offset free "
            f"({_offset(delays.offset)})."
        )
    if delays.zero_offset is not None:
        text += (
            f" With the heading offset fixed at zero the delay is "
            f"{_plus_minus(delays.zero_offset)} s."
        )
    return text


VAGUE = math.radians(5.0)
"""Standard deviation beyond which a heading offset is no finding."""


def _offset(offset: Estimate) -> str:
    """An offset with its standard deviation, where it is known at all."""
    sd = math.degrees(offset.sd)
    if offset.sd > math.pi:
        return "not known, because the heading hardly changes"
    if offset.sd > VAGUE:
        return f"not known to within {sd:.0f} degrees"
    return f"{math.degrees(offset.value):.1f} ± {sd:.1f} degrees"


def _restoring(selection: Selection) -> str:
    """A force that pulls back, or nothing where the track is too short to tell."""
    try:
        force = restoring_force(selection.train, selection.held_out)
    except InputError:
        return ""
    return force.sentence(DECISIVE)


def _gain(selection: Selection, label: str, meaning: str) -> str:
    rows = [row for row in selection.rows if row.name.endswith(f"+ {label}")]
    if not rows:
        return ""
    row = rows[0]
    if row.reason:
        return f"{meaning.capitalize()}: not fitted, {row.reason}."
    below = max(
        (r for r in selection.rows if row.name.startswith(f"{r.name} + ")),
        key=lambda r: len(r.name),
    )
    difference = row.log_evidence - below.log_evidence
    return f"{meaning[0].upper()}{meaning[1:]}: {_words(difference)}."


def _wandering(selection: Selection) -> str:
    """A sentence on a gain that wanders, and by how much where the bands allow it."""
    text = _gain(selection, "wandering gain", "a gain that wanders")
    if selection.wandering is None:
        return text
    estimates = estimates_of(selection.wandering)
    part = estimates["gain wander"].value / max(estimates["gain"].value, 1e-30)
    return (
        f"{text[:-1]}: by {100 * part:.2g} % of the gain with a memory of "
        f"{estimates['gain memory'].value:.2g} s; the bands allow for it."
    )


def _words(difference: float) -> str:
    if difference >= DECISIVE:
        return f"supported, by {difference:.1f} nats"
    if difference <= -DECISIVE:
        return f"not supported, {-difference:.1f} nats against it"
    return f"undecided ({difference:+.1f} nats)"


def _range(low: float, value: float, high: float) -> str:
    """An interval in so many digits that it holds its value as that is written."""
    for digits in range(2, 8):
        ends = [float(f"{end:.{digits}g}") for end in (low, high)]
        if ends[0] < ends[1] and ends[0] <= float(f"{value:.3g}") <= ends[1]:
            return f"{ends[0]:g} to {ends[1]:g}"
    return f"{low:g} to {high:g}"


def _plus_minus(estimate: Estimate) -> str:
    return f"{estimate.value:.3g} ± {normal_quantile() * estimate.sd:.2g}"
