"""`fit_track`: one candidate on one track, with evidence and intervals."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from pinav.actuation import HeldProgramme
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import FitError
from pinav.fitting import Estimate
from pinav.forces import (
    RollingPropulsion,
    UniformFlow,
    ZeroForce,
)
from pinav.identification.blocks_filter import disturbance_of
from pinav.identification.kalman import Disturbance
from pinav.identification.likelihood import (
    CommandedPath,
    Design,
    Field,
    commanded_path,
    value_and_slope,
)
from pinav.identification.models import (
    ABSENT,
    COMMAND_RESPONSE,
    NAMES,
    CandidateModel,
    response_of,
)
from pinav.identification.priors import Prior
from pinav.identification.quantities import estimates_about, speed_about
from pinav.identification.tracks import Blocks, Track


class TrackFit(eqx.Module):
    r"""A candidate fitted to a track.

    Attributes:
        candidate: what was free.
        theta: all nonlinear parameters, in the order of `NAMES`.
        coefficients: of the candidate's gain matrices and drifts; absent ones are 0.
        covariance: joint, of `candidate.learned` and then of all coefficients.
        log_evidence: the nonlinear parameters integrated out by Laplace's method.
        evaluations: of the likelihood.
        fastest: highest frequency that was commanded while it was fitted [Hz].
        wandering: the same beside a gain that wanders, where the evidence prefers
            that; bands are those of this fit about the path of the constant gain.
    """

    candidate: CandidateModel
    theta: Float[np.ndarray, " parameter"]
    coefficients: Float[np.ndarray, " coefficient"]
    covariance: Float[np.ndarray, "unknown unknown"]
    log_evidence: float
    evaluations: int
    fastest: float
    wandering: "TrackFit | None" = None

    @property
    def gain(self) -> Float[np.ndarray, "2 2"]:
        """Gain matrix [L per cycle]."""
        return np.einsum("g,gab->ab", self.coefficients[:4], self.candidate.matrices())

    @property
    def drift(self) -> Float[np.ndarray, "2"]:
        """Drift [L T⁻¹]."""
        return self.coefficients[4:] @ self.candidate.velocities()

    @property
    def disturbance(self) -> Disturbance:
        """The noise."""
        return disturbance_of(jnp.asarray(self.theta))

    def parameter(self, name: str) -> float:
        """A nonlinear parameter by its name."""
        return float(self.theta[NAMES.index(name)])

    def swimmer(self, programme: HeldProgramme) -> OverdampedSwimmer:
        """The first-order swimmer under a programme; a lag is not part of it."""
        corner, residual = map(self.parameter, ("log_corner", "logit_residual"))
        propulsion = RollingPropulsion(
            gain=jnp.asarray(self.gain),
            response=response_of(self.candidate.response, corner, residual),
            programme=programme,
            delay=self.parameter("delay"),
        )
        return OverdampedSwimmer(
            propulsion, ZeroForce(), 1.0, UniformFlow(jnp.asarray(self.drift))
        )

    def speed(
        self, frequency: Float[np.ndarray, " place"]
    ) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, " place"]]:
        """Speed along the command by frequency [Hz], with its standard deviation."""
        names = ("log_corner", "logit_residual")
        held = np.array([self.parameter(name) for name in names])
        return speed_about(
            self.candidate, self._unknown(), self.covariance, held, frequency
        )

    def estimates(self) -> dict[str, Estimate]:
        """Quantities with a meaning, by name, with their standard deviations."""
        return estimates_about(self.candidate, self._unknown(), self.covariance)

    def _unknown(self) -> Float[np.ndarray, " unknown"]:
        """What was learned, then all coefficients."""
        learned = [self.parameter(name) for name in self.candidate.learned]
        return np.concatenate([learned, self.coefficients])


def fit_track(
    track: Track,
    candidate: CandidateModel,
    *,
    prior: Prior | None = None,
    start: TrackFit | None = None,
) -> TrackFit:
    """Maximise the posterior of a candidate and integrate it.

    Args:
        track: what is fitted.
        candidate: what is free.
        prior: of the nonlinear parameters; `Prior.of(track)` unless given.
        start: a simpler candidate of the same track; the search begins there too.

    Raises:
        FitError: the likelihood is not finite at any start.
    """
    prior = Prior.of(track) if prior is None else prior
    with jax.enable_x64(new_val=True):
        search = Search(Design.of(candidate, Blocks.of(track)), candidate, prior)
        # Starts that coincide are searched once.
        begins = np.unique(search.begins(start), axis=0)
        sizes = search.sizes(start)
        ends = [search.descend(begin, sizes) for begin in begins]
        best = min(ends, key=lambda pair: pair[1])
        if not math.isfinite(best[1]):
            raise FitError(
                f"track {track.name}: the likelihood of {candidate.name} is not "
                "finite; check the times and units of the recording"
            )
        return search.result(*best)


ENOUGH = 1e-7
"""Relative gain of the log posterior at which a search ends: some 1e-4 nats."""

STARTS = (0.1, 0.4)
"""Delays from which a search begins where no simpler candidate had one [s]."""


WHITE = ("log_memory", "log_noise")
"""What is small where the velocity of a track is nearly white."""


class Search:
    """The posterior of the nonlinear parameters of a candidate, by Laplace's method.

    Attributes:
        design: the track, as the candidate sees it.
        candidate: what is free.
        prior: of the nonlinear parameters.
        field: displacements by a field whose weights have unit prior variances.
        evaluations: of the likelihood so far.
    """

    def __init__(
        self,
        design: Design,
        candidate: CandidateModel,
        prior: Prior,
        field: Field | None = None,
    ) -> None:
        self.design, self.candidate, self.prior = design, candidate, prior
        self.field = field
        self.places = np.array([NAMES.index(name) for name in candidate.learned])
        fixed = {**ABSENT, **candidate.fixed}
        self.base = np.array([fixed.get(name, 0.0) for name in NAMES])
        self.evaluations = 0
        self.known, self.known_field = {}, field
        self.latest: tuple[bytes, CommandedPath] | None = None

    def begins(self, start: TrackFit | None) -> list[np.ndarray]:
        """Where searches begin: at the prior, or where a simpler candidate ended.

        Without one two kinds of noise are tried, a velocity that is remembered beside
        errors of positions, and one that is nearly white without them: the posterior
        has a maximum at either, and they can be 150 nats apart.
        """
        theta = self.theta(self.prior.mean[self.places])
        if start is not None:
            shared = [i for i in self.places if NAMES[i] in start.candidate.learned]
            theta[shared] = start.theta[shared]
        several = [theta]
        if start is None:
            white, noise = theta.copy(), [NAMES.index(name) for name in WHITE]
            white[noise] -= 2 * self.prior.sd[noise]
            several.append(white)
        if "delay" in self.candidate.free and (
            start is None or "delay" not in start.candidate.free
        ):
            place = NAMES.index("delay")
            several = [
                np.where(np.arange(len(one)) == place, delay, one)
                for one in several
                for delay in STARTS
            ]
        return [one[self.places] for one in several]

    def sizes(self, start: TrackFit | None) -> Float[np.ndarray, " learned"]:
        """Over what each parameter matters: its deviation in a simpler candidate.

        It is that of the prior where no simpler candidate has the parameter.
        """
        sizes = self.prior.sd[self.places]
        if start is None:
            return sizes
        learned = start.candidate.learned
        known = dict(zip(learned, np.sqrt(start.covariance.diagonal()), strict=False))
        places = zip(self.places, sizes, strict=True)
        return np.array([known.get(NAMES[place], size) for place, size in places])

    def theta(self, learned: Float[np.ndarray, " learned"]) -> np.ndarray:
        """All nonlinear parameters."""
        theta = self.base.copy()
        theta[self.places] = learned
        return theta

    def __call__(
        self, learned: Float[np.ndarray, " learned"]
    ) -> tuple[float, Float[np.ndarray, " learned"]]:
        """Negative log posterior density and its gradient."""
        (value, _), slope = self._evaluate(learned)
        mean, sd = self.prior.mean[self.places], self.prior.sd[self.places]
        offset = (learned - mean) / sd
        value = float(value) + 0.5 * float(offset @ offset)
        value += float(np.log(sd).sum()) + 0.5 * len(sd) * math.log(2 * math.pi)
        slope = np.asarray(slope)[self.places] + offset / sd
        if not (math.isfinite(value) and np.isfinite(slope).all()):
            # A large number makes L-BFGS shorten its step, infinity would end the
            # search.
            return 1e30, np.zeros_like(offset)
        return value, slope

    def _evaluate(self, learned: Float[np.ndarray, " learned"]) -> Any:
        """What `value_and_slope` gives, computed once for each point.

        Curvatures and derivatives of the coefficients ask for the same points.
        """
        if self.known_field is not self.field:
            self.known, self.known_field = {}, self.field
        key = learned.tobytes()
        if key not in self.known:
            self.evaluations += 1
            theta = self.theta(learned)
            path = self._commanded_path(theta[: len(COMMAND_RESPONSE)])
            self.known[key] = value_and_slope(
                theta, path, self.design.still, self.field
            )
        return self.known[key]

    def _commanded_path(self, drive: Float[np.ndarray, "4"]) -> CommandedPath:
        """It at a point, kept for the next one: there only the noise may differ."""
        key = drive.tobytes()
        if self.latest is None or self.latest[0] != key:
            design = self.design
            self.latest = key, commanded_path(drive, design.blocks, design.response)
        return self.latest[1]

    def descend(
        self,
        begin: Float[np.ndarray, " learned"],
        sizes: Float[np.ndarray, " learned"] | None = None,
    ) -> tuple[Float[np.ndarray, " learned"], float]:
        """The nearest maximum of the posterior, and minus its logarithm.

        Args:
            begin: where the search begins.
            sizes: units of the search; the prior's deviations unless given.
        """
        units = self.prior.sd[self.places] if sizes is None else sizes
        bounds = self.prior.bounds()[self.places]
        low, high = bounds.T

        def objective(place: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = self(place * units)
            return value, slope * units

        end = minimize(
            objective,
            np.clip(begin, low, high) / units,
            jac=True,
            method="L-BFGS-B",
            bounds=bounds / units[:, None],
            options={"maxiter": 100, "ftol": ENOUGH, "gtol": 1e-3},
        )
        return end.x * units, float(end.fun) if end.fun < 1e29 else math.inf

    def laplace(
        self, learned: Float[np.ndarray, " learned"]
    ) -> tuple[Float[np.ndarray, "learned learned"], float]:
        """Covariance about the maximum, and the logarithm of its volume.

        In units of the prior's deviations no curvature is below 1: nothing is less
        certain than its prior was, and a direction that the data leave flat adds
        neither evidence nor width.
        """
        rows = np.array([self._curvature(learned, step) for step in self.steps()])
        for index, place in enumerate(self.places):
            if NAMES[place] in RESPONSE_PARAMETERS:
                rows[index] = self._curvature_of_interval(learned, index, rows[index])
        sd = self.prior.sd[self.places]
        # Differences are symmetric only to their own error, and eigh reads one
        # triangle.
        scaled = sd[:, None] * (rows + rows.T) / 2 * sd
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(values, 1.0)
        volume = np.log(sd).sum() + 0.5 * np.log(2 * math.pi / values).sum()
        return sd[:, None] * (vectors / values @ vectors.T) * sd, float(volume)

    def _curvature(
        self,
        learned: Float[np.ndarray, " learned"],
        step: Float[np.ndarray, " learned"],
    ) -> Float[np.ndarray, " learned"]:
        """A row of the curvature, over a step along one parameter."""
        # Differences of gradients, not of values: values lose half of their digits.
        return (self(learned + step)[1] - self(learned - step)[1]) / (2 * step.max())

    def _curvature_of_interval(
        self,
        learned: Float[np.ndarray, " learned"],
        index: int,
        row: Float[np.ndarray, " learned"],
    ) -> Float[np.ndarray, " learned"]:
        """A row of the curvature, over a step as long as the deviation that it makes.

        The corner of a response is where its law bends most: a curvature within a
        fiftieth of the prior can be that of one commanded frequency, and the interval
        then far too narrow, or of a plateau beside a wall.
        """
        sd = self.prior.sd[self.places][index]
        length = DIFFERENCE * sd
        for _ in range(STEPS_OF_INTERVAL):
            width = 1 / math.sqrt(row[index]) if row[index] > 0 else math.inf
            before, length = length, float(np.clip(width, DIFFERENCE * sd, WIDEST * sd))
            if abs(length - before) < 0.2 * before:
                break
            step = np.zeros(len(learned))
            step[index] = length
            row = self._curvature(learned, step)
        return row

    def result(self, learned: Float[np.ndarray, " learned"], value: float) -> TrackFit:
        """Evidence and posterior about the maximum."""
        spread, volume = self.laplace(learned)
        coefficients, covariance = self._joint(learned, spread)
        return TrackFit(
            candidate=self.candidate,
            theta=self.theta(learned),
            coefficients=coefficients,
            covariance=covariance,
            log_evidence=volume - value,
            evaluations=self.evaluations,
            fastest=float(np.max(self.design.blocks.frequency)),
        )

    def steps(self) -> Float[np.ndarray, "learned learned"]:
        """Differences, a fraction of the prior; held commands make kinks in delays."""
        wide = np.array([NAMES[i] in ("delay", "log_lag") for i in self.places])
        fraction = np.where(wide, ACROSS_KINKS, DIFFERENCE)
        return np.diag(fraction * self.prior.sd[self.places])

    def slopes(
        self, learned: Float[np.ndarray, " learned"], of: Callable[[np.ndarray], Any]
    ) -> Float[np.ndarray, "value learned"]:
        """Derivatives of a vector by what is learned, by central differences."""
        columns = [
            (of(learned + s) - of(learned - s)) / (2 * s.max()) for s in self.steps()
        ]
        return np.stack(columns, axis=1)

    def _coefficients(
        self, learned: Float[np.ndarray, " learned"]
    ) -> tuple[np.ndarray, np.ndarray]:
        (_, (best, information)), _ = self._evaluate(learned)
        return np.asarray(best), np.asarray(information)

    def _joint(
        self, learned: Float[np.ndarray, " learned"], spread: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients, and the joint covariance with what is learned."""
        best, information = self._coefficients(learned)
        slopes = self.slopes(learned, lambda place: self._coefficients(place)[0])
        gains = np.any(self.candidate.matrices(), axis=(1, 2))
        present = np.concatenate([gains, self.candidate.velocities().any(1)])
        alone = np.linalg.inv(information) * np.outer(present, present)
        cross = slopes @ spread
        return best, np.block([[spread, cross.T], [cross, alone + cross @ slopes.T]])


DIFFERENCE, ACROSS_KINKS, WIDEST = 0.02, 0.25, 0.5
"""Steps of central differences, in standard deviations of the prior: the usual one,
that across kinks, and the widest for a parameter of the response."""

STEPS_OF_INTERVAL = 4
"""Lengths that are tried at most."""

RESPONSE_PARAMETERS = ("log_corner", "logit_residual")
"""Parameters whose curvature is taken over their own interval."""
