"""Numbers in which a path is not linear: the drive of a swimmer, and its noise.

A search moves their coordinates: logarithms of positive numbers, the logit of a part.
All have a place in one vector, those that a swimmer has not too, so that one compiled
likelihood serves all systems.
"""

import enum
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.fitting import EvidenceFit
from pinav.forces import RollingPropulsion
from pinav.identification.tracks import Track
from pinav.systems import System


class Scale(enum.Enum):
    """The coordinate of a number."""

    PLAIN = "plain"
    LOG = "log"
    LOGIT = "logit"

    def number(self, coordinate: float) -> float:
        """The number at a coordinate."""
        if self is Scale.LOG:
            return math.exp(coordinate)
        if self is Scale.LOGIT:
            return 1 / (1 + math.exp(-coordinate))
        return coordinate

    def slope(self, coordinate: float) -> float:
        """Derivative of the number by its coordinate."""
        number = self.number(coordinate)
        if self is Scale.LOGIT:
            return number * (1 - number)
        return number if self is Scale.LOG else 1.0

    def coordinate(self, number: float) -> float:
        """The coordinate of a number; NaN where it has none."""
        if self is Scale.PLAIN:
            return number
        odds = number / (1 - number) if self is Scale.LOGIT else number
        return math.log(odds) if odds > 0 else math.nan


class Parameter(NamedTuple):
    """One of these numbers.

    Attributes:
        path: place in a swimmer; of the noise, its name among the constants of a fit.
        name: name among the estimates of a track.
        scale: coordinate in which a search moves it.
        absent: coordinate where a system has not this number.
    """

    path: str
    name: str
    scale: Scale = Scale.LOG
    absent: float = math.nan


NONE = math.log(1e-9)
"""Coordinate of a strength, or of a lag, that is none."""

CORNER, RESIDUAL = "propulsion.response.corner", "propulsion.response.residual"
DELAY, LAG = "propulsion.delay", "propulsion.lag"
BLOCK_NOISE = "noise of a block"
"""Name of the standard deviation of a block's mean position."""

DRIVE = (
    Parameter(CORNER, "corner", absent=0.0),
    Parameter(RESIDUAL, "residual", Scale.LOGIT, 0.0),
    Parameter(DELAY, "delay", Scale.PLAIN, 0.0),
    Parameter(LAG, "lag", absent=NONE),
)
"""Numbers of the propulsion, the first of all."""

NOISE = (
    Parameter("wandering.still", "still"),
    Parameter("wandering.driven", "driven"),
    Parameter("wandering.memory", "memory"),
    Parameter(BLOCK_NOISE, "noise"),
)
"""Numbers of the noise, which are learned in every fit."""

SLOW_DRIFT = (
    Parameter("wandering.slow", "slow", absent=NONE),
    Parameter("wandering.slow_memory", "slow memory", absent=math.log(60.0)),
)
"""Numbers of a drift that changes."""

WANDERING_GAIN = (
    Parameter("wander of the gain", "gain wander", absent=NONE),
    Parameter("memory of the gain", "gain memory", absent=math.log(60.0)),
)
"""Numbers of a gain that wanders."""

PARAMETERS = (*DRIVE, *NOISE, *SLOW_DRIFT, *WANDERING_GAIN)
"""All of them, in the order of their vector."""

PLACES = {parameter.path: place for place, parameter in enumerate(PARAMETERS)}
"""Place of each in the vector, by its path."""

GAIN, DRIFT = "propulsion.gain", "flow.velocity"
"""Paths of the numbers in which displacements are linear."""

Coordinates = Float[np.ndarray, " parameter"]
"""Coordinates of all parameters."""

ABSENT: Coordinates = np.array([parameter.absent for parameter in PARAMETERS])
"""Coordinates of a system that has none of them; NaN where every system has one."""


def learned_parameters(
    system: System, *, wandering_gain: bool = False
) -> tuple[Parameter, ...]:
    """The parameters that a system leaves open, in their order.

    Args:
        system: `learn` names those of the propulsion; a drift that changes is
            learned where its wandering velocity has one.
        wandering_gain: learn a gain that wanders, too.
    """
    paths = {number.path for number in system.learn}
    slow = system.wandering is not None and system.wandering.slow > 0
    return (
        *(parameter for parameter in DRIVE if parameter.path in paths),
        *NOISE,
        *(SLOW_DRIFT if slow else ()),
        *(WANDERING_GAIN if wandering_gain else ()),
    )


def drive_coordinates(
    swimmer: Swimmer | OverdampedSwimmer,
) -> Float[np.ndarray, "4"]:
    """Coordinates of the drive of a swimmer, absent ones without a propulsion."""
    drive = ABSENT[: len(DRIVE)].copy()
    propulsion = swimmer.propulsion
    if isinstance(propulsion, RollingPropulsion):
        drive[PLACES[DELAY]] = float(propulsion.delay)
        if float(propulsion.lag) > 0:
            drive[PLACES[LAG]] = math.log(propulsion.lag)
        for path in (CORNER, RESIDUAL):
            number = getattr(propulsion.response, path.rpartition(".")[2], None)
            if number is not None:
                scale = DRIVE[PLACES[path]].scale
                drive[PLACES[path]] = scale.coordinate(float(number))
    return drive


def stated_coordinates(system: System) -> Coordinates:
    """Coordinates that a system states; NaN for noise of which it says nothing."""
    coordinates = ABSENT.copy()
    coordinates[: len(DRIVE)] = drive_coordinates(system.swimmer)
    numbers = {BLOCK_NOISE: system.observation.noise}
    if system.wandering is not None:
        stated = vars(system.wandering)
        numbers |= {f"wandering.{name}": value for name, value in stated.items()}
    for path, number in numbers.items():
        coordinates[PLACES[path]] = Scale.LOG.coordinate(number)
    return coordinates


def fitted_coordinates(fit: EvidenceFit) -> Coordinates:
    """Coordinates of the swimmer of a fit, and of the noise that it found."""
    coordinates = ABSENT.copy()
    coordinates[: len(DRIVE)] = drive_coordinates(fit.model)
    for parameter in PARAMETERS[len(DRIVE) :]:
        if parameter.path in fit.constants:
            number = fit.constants[parameter.path].value
            coordinates[PLACES[parameter.path]] = parameter.scale.coordinate(number)
    return coordinates


class Prior(NamedTuple):
    """Normal priors of all coordinates.

    Attributes:
        mean: their centres.
        sd: their standard deviations.
    """

    mean: Coordinates
    sd: Coordinates

    @classmethod
    def of(cls, track: Track) -> "Prior":
        """Wide priors about the scales of a track.

        Speeds about a tenth of the track's, within a factor of 20 (two sd); the
        corner about the geometric mean of the commanded frequencies, within a factor
        of 20; delays of a camera and its computer, 0.2 ± 0.2 s; lags about 0.1 s; a
        gain that wanders by about a tenth within ten blocks.
        """
        speed = _typical_speed(track)
        quick = math.log(0.1 * speed)
        frequency = math.log(_typical_frequency(track))
        table = {
            "corner": (frequency, 1.5),
            "residual": (0.0, 1.5),
            "delay": (0.2, 0.2),
            "lag": (math.log(0.1), 1.0),
            "still": (quick - 1.0, 1.5),
            "driven": (quick, 1.5),
            "memory": (math.log(2.0 * track.width), 1.0),
            "noise": (math.log(0.2 * speed * track.width), 1.5),
            "slow": (quick, 1.5),
            "slow memory": (math.log(30.0 * track.width), 1.0),
            "gain wander": (quick - frequency, 1.5),
            "gain memory": (math.log(10.0 * track.width), 1.0),
        }
        mean, sd = np.array([table[parameter.name] for parameter in PARAMETERS]).T
        return cls(mean, sd)

    def about(self, coordinates: Coordinates) -> "Prior":
        """Priors as wide as these about other centres; its own where they are NaN."""
        stated = np.isfinite(coordinates)
        return self._replace(mean=np.where(stated, coordinates, self.mean))

    def bounds(self) -> Float[np.ndarray, "parameter 2"]:
        """Five standard deviations either way; a delay is not negative."""
        reach = 5 * self.sd
        bounds = np.stack([self.mean - reach, self.mean + reach], axis=1)
        bounds[PLACES[DELAY], 0] = 0.0
        return bounds


def _typical_speed(track: Track) -> float:
    """Root-mean-square speed over the length of a block."""
    speeds = []
    for piece in track.pieces:
        index = np.arange(0, len(piece.times))
        later = np.searchsorted(piece.times, piece.times + track.width)
        fits = later < len(index)
        step = piece.states[later[fits]] - piece.states[index[fits]]
        interval = piece.times[later[fits]] - piece.times[index[fits]]
        speeds.append(np.hypot(*step.T) / interval)
    values = np.concatenate(speeds)
    return max(float(np.sqrt(np.mean(values**2))) if len(values) else 0.0, 1e-6)


def _typical_frequency(track: Track) -> float:
    """Geometric mean of the commanded frequencies; 1 Hz without commands."""
    if not track.commanded:
        return 1.0
    values = np.concatenate([p.commands["frequency"] for p in track.pieces])
    values = values[values > 0]
    return float(np.exp(np.log(values).mean())) if len(values) else 1.0
