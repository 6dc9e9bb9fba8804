"""`fit_track`: one candidate on one track, with evidence and intervals."""

import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import FitError
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    Hyperparameters,
    LinearFit,
    Outcome,
    Posterior,
)
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import NoWeights
from pinav.identification import likelihood
from pinav.identification.drive import is_open
from pinav.identification.estimates import learned_posterior
from pinav.identification.parameters import (
    BLOCK_NOISE,
    CORNER,
    DELAY,
    DRIFT,
    GAIN,
    LAG,
    RESIDUAL,
    Coordinates,
    Parameter,
    Prior,
    coordinates_of,
    fitted_coordinates,
    learned_noise,
    stated_noise,
)
from pinav.identification.tracks import Blocks, Track
from pinav.systems import System

Learned = Float[np.ndarray, " learned"]
"""Coordinates of the parameters that are learned."""


def fit_track(
    track: Track,
    system: System,
    *,
    start: EvidenceFit | None = None,
    wandering_gain: bool = False,
) -> EvidenceFit:
    """Maximise the posterior of a candidate and integrate it.

    Returns:
        The swimmer, its posterior and the log evidence, the nonlinear parameters
        integrated out by Laplace's method; those of the noise are constants.

    Raises:
        FitError: the likelihood is not finite at any start.
    """
    with jax.enable_x64(new_val=True):
        design = likelihood.Design.of(system, Blocks.of(track))
        prior = Prior.of(track, design.parameters)
        search = CandidateSearch(system, design, prior, wandering_gain=wandering_gain)
        # Starts that coincide are searched once.
        begins = np.unique(search.begins(start), axis=0)
        sizes = search.sizes(start)
        ends = [search.descend(begin, sizes) for begin in begins]
        best = min(ends, key=lambda pair: pair[1])
        if not math.isfinite(best[1]):
            raise FitError(
                f"track {track.name}: the likelihood of {system.name} is not "
                "finite; check the times and units of the recording"
            )
        return search.result(*best, system)


ENOUGH = 1e-7
"""Relative gain of the log posterior at which a search ends: some 1e-4 nats."""

STARTS = (0.1, 0.4)
"""Delays from which a search begins where no simpler candidate had one [s]."""


WHITE = ("wandering.memory", BLOCK_NOISE)
"""Noise that is small where the velocity of a track is nearly white."""


def stated_coordinates(system: System, design: likelihood.Design) -> Coordinates:
    """Coordinates that a system states; NaN for noise of which it says nothing."""
    return coordinates_of(design.parameters, system.swimmer, stated_noise(system))


class CandidateSearch:
    """The posterior of the nonlinear parameters of a system, by Laplace's method.

    Attributes:
        base: coordinates of the parameters that are not open.
        field: displacements by a field whose weights have unit prior variances.
    """

    def __init__(
        self,
        system: System,
        design: likelihood.Design,
        prior: Prior,
        *,
        wandering_gain: bool = False,
    ) -> None:
        self.design, self.prior = design, prior
        self.learned = [p for p in design.drive.parameters if is_open(system, p.path)]
        self.learned += learned_noise(system, wandering_gain=wandering_gain)
        paths = [parameter.path for parameter in design.parameters]
        self.place = {path: place for place, path in enumerate(paths)}
        self.places = np.array([self.place[p.path] for p in self.learned])
        # What is stated and not open stays as it is stated, noise not stated does not.
        stated = stated_coordinates(system, design)
        self.base = np.where(np.isfinite(stated), stated, prior.mean)
        self.evaluations = 0
        self.field: likelihood.Field | None = None
        self.known, self.known_field = {}, self.field
        self.latest: tuple[bytes, likelihood.CommandedPath] | None = None

    def begins(self, start: EvidenceFit | None) -> list[np.ndarray]:
        """Starts of the search: the prior, or where a simpler candidate ended.

        Without one two kinds of noise are tried, a velocity that is remembered beside
        errors of positions, and one that is nearly white without them: the posterior
        has a maximum at either, and they can be 150 nats apart.
        """
        theta = self.theta(self.prior.mean[self.places])
        known = set() if start is None else {p.path for p in self._shared(start)}
        if start is not None:
            shared = [self.place[path] for path in known]
            fitted = fitted_coordinates(start, self.design.parameters)
            theta[shared] = fitted[shared]
        several = [theta]
        if start is None:
            white, noise = theta.copy(), [self.place[path] for path in WHITE]
            white[noise] -= 2 * self.prior.sd[noise]
            several.append(white)
        for parameter in self.learned:
            if parameter.path == DELAY and DELAY not in known:
                chosen = np.arange(len(theta)) == self.place[DELAY]
                several = [
                    np.where(chosen, parameter.scale.coordinate(late), one)
                    for one in several
                    for late in STARTS
                ]
        return [one[self.places] for one in several]

    def _shared(self, start: EvidenceFit) -> list[Parameter]:
        """The parameters that a simpler candidate has learned, too."""
        return [p for p in self.learned if p.path in start.constants]

    def sizes(self, start: EvidenceFit | None) -> Learned:
        """Scale of each parameter: its sd in a simpler candidate, or of its prior."""
        sizes = self.prior.sd.copy()
        if start is not None:
            coordinates = fitted_coordinates(start, self.design.parameters)
            for parameter in self._shared(start):
                place = self.place[parameter.path]
                slope = parameter.scale.slope(coordinates[place])
                sizes[place] = start.constants[parameter.path].sd / slope
        return sizes[self.places]

    @property
    def present(self) -> Bool[np.ndarray, " coefficient"]:
        """True for each of the four gains and two drifts that is open."""
        gains, drifts = self.design.still.gains, self.design.still.drifts
        return np.concatenate([np.any(gains, axis=(1, 2)), np.any(drifts, axis=1)])

    @property
    def linear(self) -> dict[str, int]:
        """Number of open numbers of gain and drift, by their paths."""
        return {GAIN: int(self.present[:4].sum()), DRIFT: int(self.present[4:].sum())}

    def theta(self, learned: Learned) -> np.ndarray:
        """All nonlinear parameters."""
        theta = self.base.copy()
        theta[self.places] = learned
        return theta

    def __call__(self, learned: Learned) -> tuple[float, Learned]:
        """Negative log posterior density and its gradient."""
        (value, _), slope = self._evaluate(learned)
        log_prior, by_prior = self.log_prior(learned)
        value = float(value) - log_prior
        slope = np.asarray(slope)[self.places] - by_prior
        if not (math.isfinite(value) and np.isfinite(slope).all()):
            # A large number makes L-BFGS shorten its step, infinity would end the
            # search.
            return 1e30, np.zeros_like(slope)
        return value, slope

    def log_prior(self, learned: Learned) -> tuple[float, Learned]:
        """Log density of the prior and its gradient."""
        sd = self.prior.sd[self.places]
        offset = (learned - self.prior.mean[self.places]) / sd
        constant = np.log(sd).sum() + 0.5 * len(sd) * math.log(2 * math.pi)
        return float(-0.5 * offset @ offset - constant), -offset / sd

    def _evaluate(self, learned: Learned) -> Any:
        """Result of `value_and_slope`, computed once for curvatures and derivatives."""
        if self.known_field is not self.field:
            self.known, self.known_field = {}, self.field
        key = learned.tobytes()
        if key not in self.known:
            self.evaluations += 1
            theta = self.theta(learned)
            path = self._commanded_path(theta[: len(self.design.drive.parameters)])
            self.known[key] = likelihood.value_and_slope(
                theta, path, self.design.still, self.field
            )
        return self.known[key]

    def _commanded_path(
        self, coordinates: Float[np.ndarray, " parameter"]
    ) -> likelihood.CommandedPath:
        """The path at a point, kept for the next one: the noise alone may differ."""
        key = coordinates.tobytes()
        if self.latest is None or self.latest[0] != key:
            self.latest = key, self.design.commanded_path(coordinates)
        return self.latest[1]

    def descend(
        self, begin: Learned, sizes: Learned | None = None
    ) -> tuple[Learned, float]:
        """The nearest maximum of the posterior, and minus its logarithm."""
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
        self, learned: Learned
    ) -> tuple[Float[np.ndarray, "learned learned"], float]:
        """Covariance about the maximum, and the logarithm of its volume.

        In units of the prior's deviations no curvature is below 1: nothing is less
        certain than its prior was, and a direction that the data leave flat adds
        neither evidence nor width.
        """
        rows = np.array([self._curvature(learned, step) for step in self.steps()])
        for index, parameter in enumerate(self.learned):
            if parameter.path in (CORNER, RESIDUAL):
                rows[index] = self._curvature_of_interval(learned, index, rows[index])
        sd = self.prior.sd[self.places]
        # Differences are symmetric only to their own error, and eigh reads one
        # triangle.
        scaled = sd[:, None] * (rows + rows.T) / 2 * sd
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(values, 1.0)
        volume = np.log(sd).sum() + 0.5 * np.log(2 * math.pi / values).sum()
        return sd[:, None] * (vectors / values @ vectors.T) * sd, float(volume)

    def _curvature(self, learned: Learned, step: Learned) -> Learned:
        """A row of the curvature, over a step along one parameter."""
        # Differences of gradients, not of values: values lose half of their digits.
        return (self(learned + step)[1] - self(learned - step)[1]) / (2 * step.max())

    def _curvature_of_interval(
        self, learned: Learned, index: int, row: Learned
    ) -> Learned:
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

    def result(self, learned: Learned, value: float, system: System) -> EvidenceFit:
        """Evidence and posterior about the maximum."""
        spread, volume = self.laplace(learned)
        _, information = self._coefficients(learned)
        present = np.flatnonzero(self.present)
        posterior, constants = self.joint_posterior(
            system.swimmer,
            learned,
            spread,
            lambda place: self._coefficients(place)[0][present],
            np.linalg.inv(information)[np.ix_(present, present)],
        )
        noise = constants[BLOCK_NOISE].value
        hyperparameters = Hyperparameters(np.zeros(0), 0.0, noise, volume - value)
        nothing = Quadratic(
            point=np.zeros(0),
            hessian=np.zeros((0, 0)),
            gradient=np.zeros(0),
            squares=0.0,
            num_free=len(posterior.mean),
            log_determinant=0.0,
        )
        return EvidenceFit(
            model=posterior.model,
            outcome=Outcome.CONVERGED,
            iterations=self.evaluations,
            hyperparameters=hyperparameters,
            posterior=posterior,
            constants=constants,
            states=None,
            linear=LinearFit(nothing, NoWeights(), noise, nothing.num_free, 0.0),
        )

    def steps(self) -> Float[np.ndarray, "learned learned"]:
        """Differences, a fraction of the prior; held commands make kinks in delays."""
        wide = np.array([parameter.path in (DELAY, LAG) for parameter in self.learned])
        fraction = np.where(wide, ACROSS_KINKS, DIFFERENCE)
        return np.diag(fraction * self.prior.sd[self.places])

    def slopes(
        self, learned: Learned, of: Callable[[np.ndarray], Any]
    ) -> Float[np.ndarray, "value learned"]:
        """Derivatives of a vector by what is learned, by central differences."""
        columns = [
            (of(learned + s) - of(learned - s)) / (2 * s.max()) for s in self.steps()
        ]
        return np.stack(columns, axis=1)

    def _coefficients(self, learned: Learned) -> tuple[np.ndarray, np.ndarray]:
        (_, (best, information)), _ = self._evaluate(learned)
        return np.asarray(best), np.asarray(information)

    def joint_posterior(
        self,
        swimmer: Swimmer | OverdampedSwimmer,
        learned: Learned,
        spread: Float[np.ndarray, "learned learned"],
        linear_mean: Callable[[np.ndarray], np.ndarray],
        alone: Float[np.ndarray, "linear linear"],
    ) -> tuple[Posterior, dict[str, Estimate]]:
        """Posterior of a swimmer and the learned constants.

        The linear unknowns, gain, drift and weights, follow the nonlinear ones: their
        covariance is that at given nonlinear ones, and what they follow.

        Args:
            spread: covariance of the nonlinear unknowns.
            linear_mean: mean of the linear unknowns at given nonlinear ones.
            alone: covariance of the linear unknowns at given nonlinear ones.
        """
        slopes = self.slopes(learned, linear_mean)
        cross = slopes @ spread
        covariance = np.block([[spread, cross.T], [cross, alone + cross @ slopes.T]])
        unknown = np.concatenate([learned, linear_mean(learned)])
        return learned_posterior(
            swimmer, self.learned, self.linear, unknown, covariance
        )


DIFFERENCE, ACROSS_KINKS, WIDEST = 0.02, 0.25, 0.5
"""Steps of central differences, in standard deviations of the prior: the usual one,
that across kinks, and the widest for a parameter of the response."""

STEPS_OF_INTERVAL = 4
"""Lengths that are tried at most."""
