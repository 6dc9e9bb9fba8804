"""Model selection: all candidates on one track, scored on data that none has seen."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.errors import FitError, InputError
from pinav.fitting import (
    EvidenceFit,
    KernelGrid,
    kernel_environment,
    neural_environment,
)
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.forces import KernelForce, KernelPotential, NeuralForce
from pinav.identification import forecast
from pinav.identification.baselines import explained_variance, least_squares
from pinav.identification.candidates import (
    CANDIDATES,
    drift_only,
    gain_matrix,
    like,
    scalar_gain,
    with_learned,
    with_response,
    with_slow_drift,
)
from pinav.identification.drive import drive_of, gain_of, is_open
from pinav.identification.fit import fit_track
from pinav.identification.parameters import DELAY, LAG
from pinav.identification.residual_field import (
    ResidualFit,
    fit_residual,
    path_along,
    positions_of,
    residual_errors,
)
from pinav.identification.rollouts import (
    HORIZONS,
    Errors,
    Rollouts,
    errors,
    stack,
    stacking_weight,
)
from pinav.identification.tracks import Track, cut_track
from pinav.recordings.drive import pairs_apart
from pinav.settings import FRACTION
from pinav.systems import System

LEAST_SQUARES = "least squares"
"""The baseline that a choice should never lose to by much."""

STACKED = "chosen and least squares, averaged"
"""Line of the average of both."""

ENCLOSING = "slipping"
"""The response kept where the evidence is not decisive: it contains the others."""


class Row(eqx.Module):
    """One line of the table, of one track or medians over `tracks`.

    Attributes:
        seconds: duration of the fit, compilation included [s].
        errors: errors of held-out rollouts by their length in seconds.
        velocity_r2: share of the held-out velocity's variance that is explained.
    """

    name: str = eqx.field(static=True)
    log_evidence: float
    seconds: float
    errors: dict[str, Errors]
    velocity_r2: float
    reason: str = eqx.field(static=True, default="")
    tracks: int = 1

    def over(self, horizon: float) -> Errors | None:
        """Errors of rollouts of a length [s]; none where there are no results."""
        return self.errors.get(f"{horizon:g}")

    @property
    def label(self) -> str:
        """The name without the candidates that this one extends."""
        first, *others = self.name.split(" + ")
        return f"+ {others[-1]}" if others else first


@dataclasses.dataclass
class Selection:
    """The selection on one track, between its first part and the held-out rest.

    Attributes:
        wandering: fit of the chosen candidate beside a gain that wanders, where the
            evidence prefers that.
    """

    track: Track
    train: Track
    held_out: Track
    rows: list[Row] = dataclasses.field(default_factory=list)
    candidates: dict[str, System] = dataclasses.field(default_factory=dict)
    fits: dict[str, EvidenceFit] = dataclasses.field(default_factory=dict)
    chosen: str = ""
    wandering: EvidenceFit | None = None

    @property
    def system(self) -> System:
        """The chosen candidate."""
        return self.candidates[self.chosen]

    @property
    def best(self) -> EvidenceFit:
        """The chosen candidate, fitted to the training part."""
        return self.fits[self.chosen]

    @property
    def predictor(self) -> forecast.Predictor:
        """The same with its bands."""
        return forecast.Predictor.of(self.train, self.best, self.wandering)

    def row(self, name: str) -> Row:
        """A line of the table by its name."""
        return next(row for row in self.rows if row.name == name)

    def compare_candidates(self) -> None:
        """Fit all candidates that are lines and slopes, and choose one."""
        self.chosen = self._fit(drift_only(), None)
        if self.train.commanded:
            self._fit(scalar_gain(), self.chosen)
            for candidate in CANDIDATES:
                system = candidate()
                extended = system.name.rpartition(" + ")[0]
                self._fit(system, extended if extended in self.fits else None)
            self.chosen = self._propulsion()
            drive = drive_of(self.system.swimmer, self.system.learn)
            for one in drive.parameters:
                if one.path in (DELAY, LAG) and not is_open(self.system, one.path):
                    needed = 0.0 if one.path == DELAY else DECISIVE
                    self._extend(with_learned(self.system, one.name, one.path), needed)
        self._extend(with_slow_drift(self.system))
        if self.train.commanded:
            self._compare_with_simpler()
            if gain_of(self.system.swimmer) is not None:
                self._allow_for_wandering_gain()

    def evidence(self, name: str) -> float:
        """Log evidence of a candidate on the training part [nats]."""
        return self.fits[name].hyperparameters.log_evidence

    def _fit(self, system: System, start: str | None) -> str:
        earlier = self.fits[start] if start else None
        self.candidates[system.name] = system
        self.fits[system.name] = self._fit_and_score(system.name, system, earlier)
        return system.name

    def _fit_and_score(
        self, name: str, system: System, start: EvidenceFit | None, **options: bool
    ) -> EvidenceFit:
        begin = time.perf_counter()
        fit = fit_track(self.train, system, start=start, **options)
        path = forecast.path_of(fit.model)
        self._add(name, fit.hyperparameters.log_evidence, begin, path)
        return fit

    def _propulsion(self) -> str:
        """The candidate of highest evidence, if decisive; else the enclosing one."""
        names = [candidate().name for candidate in CANDIDATES]
        kept = with_response(gain_matrix(), ENCLOSING).name
        best = max(names, key=self.evidence)
        return best if self.evidence(best) > self.evidence(kept) + DECISIVE else kept

    def _extend(self, system: System, needed: float = DECISIVE) -> None:
        """A further candidate on the chosen one; chosen itself if it gains enough."""
        name = self._fit(system, self.chosen)
        if self.evidence(name) > self.evidence(self.chosen) + needed:
            self.chosen = name

    def _compare_with_simpler(self) -> None:
        """The chosen candidate with one number for its gain, and without propulsion.

        They have the same response, delay and noise, so that a verdict on gain or
        propulsion compares nothing else; neither is chosen.
        """
        simpler = ((scalar_gain(), self.chosen), (drift_only(), drift_only().name))
        for base, start in simpler:
            system = like(base, self.system)
            if system.name not in self.fits:
                self._fit(system, start)

    def _allow_for_wandering_gain(self) -> None:
        """The chosen candidate beside a gain that wanders, for the bands alone.

        Its path is no better than that of a constant gain, and far worse where the
        wander is a large part of the gain.
        """
        name = f"{self.chosen} + wandering gain"
        fit = self._fit_and_score(name, self.system, self.best, wandering_gain=True)
        if fit.hyperparameters.log_evidence > self.evidence(self.chosen):
            self.wandering = fit

    def add_residual(self, name: str) -> None:
        """A position-dependent residual on the chosen candidate."""
        begin = time.perf_counter()
        label = f"{self.chosen} + {name}"
        try:
            environment = RESIDUALS[name](self.train)
            fit = fit_residual(self.train, self.system, self.best, environment)
        except (FitError, InputError) as error:
            nan = float("nan")
            self.rows.append(Row(label, nan, nan, {}, nan, str(error)))
            return
        self._add(label, fit.log_evidence, begin, path_along(fit), residual=fit)

    def add_least_squares(self) -> None:
        """The baseline, and where commands were given its average with the choice."""
        begin = time.perf_counter()
        path = least_squares(self.train)
        self._add(LEAST_SQUARES, float("nan"), begin, path)
        if self.train.commanded:
            begin, chosen = time.perf_counter(), forecast.path_of(self.best.model)
            weight = stacking_weight(self.train, chosen, path)
            self._add(STACKED, float("nan"), begin, stack(chosen, path, weight))

    def _add(
        self,
        name: str,
        log_evidence: float,
        begin: float,
        displacement: forecast.Displacement,
        residual: ResidualFit | None = None,
    ) -> None:
        """A line of the table, of a model whose fit began at this time."""
        seconds = time.perf_counter() - begin
        displacement, by_horizon = forecast.cache_by_segment(displacement), {}
        for horizon in HORIZONS:
            rollouts = Rollouts.of(self.held_out, horizon)
            by_horizon[f"{horizon:g}"] = (
                errors(self.held_out, rollouts, displacement)
                if residual is None
                else residual_errors(self.held_out, rollouts, residual)
            )
        r2 = velocity_r2(self.held_out, displacement)
        self.rows.append(Row(name, log_evidence, seconds, by_horizon, r2))


def split(track: Track, fraction: float) -> tuple[Track, Track]:
    """The first part of a track by time, to train on, and the rest.

    Raises:
        InputError: `fraction` is not between 0 and 1, or a part is too short.
    """
    FRACTION.check("split fraction", fraction)
    first, last = track.span
    moment = first + fraction * (last - first)
    train = cut_track(track, lambda times: times < moment)
    return train, cut_track(track, lambda times: times >= moment)


def select_model(
    track: Track, *, train_fraction: float = 0.7, residuals: Sequence[str] = ()
) -> Selection:
    """Fit every candidate to the first part of a track and roll it out on the rest.

    Raises:
        InputError: a part of the track is too short.
    """
    selection = Selection(track, *split(track, train_fraction))
    selection.compare_candidates()
    for name in residuals:
        selection.add_residual(name)
    selection.add_least_squares()
    return selection


def velocity_r2(track: Track, displacement: forecast.Displacement) -> float:
    """Explained share of the velocity over two blocks, both components pooled."""
    observed, predicted = [], []
    for piece in track.pieces:
        path = displacement(piece)
        first, last = pairs_apart(piece.times, 2 * track.width)
        interval = (piece.times[last] - piece.times[first])[:, None]
        observed.append((piece.states[last] - piece.states[first]) / interval)
        predicted.append((path[last] - path[first]) / interval)
    return explained_variance(np.concatenate(observed), np.concatenate(predicted))


GRID = KernelGrid(across=6, margin=2.0)
"""Coarse grid of kernels: a residual by position is a question, not a map."""


def _kernels(kind: Any) -> Callable[[Track], Any]:
    return lambda track: kernel_environment(kind, positions_of(track), GRID, dim=2)


def _network(track: Track) -> NeuralForce:
    return neural_environment(
        NeuralForce, positions_of(track), key=jax.random.key(0), width=8, dim=2
    )


RESIDUALS: dict[str, Callable[[Track], Any]] = {
    "Gaussian process": _kernels(KernelForce),
    "potential": _kernels(KernelPotential),
    "network": _network,
}
"""Position-dependent residuals: kernels with a prior, and a network."""
