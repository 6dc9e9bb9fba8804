"""Numbers in which a path is not linear: those of the drive, and of the noise.

A search moves their coordinates: logarithms of positive numbers, the logit of a part.
All have a place in one vector, those of the drive first; those of the noise that a
system has not have a place too, so that one compiled likelihood serves all systems.
"""

import contextlib
import enum
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.fitting import EvidenceFit
from pinav.identification.tracks import Track
from pinav.recordings.drive import pairs_apart
from pinav.systems import FreeNumber, System


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
    """A number that is estimated.

    Attributes:
        path: place in a swimmer; for the noise, its name among the constants.
        name: name among the estimates of a track.
        meaning: a phrase; empty where the title says all.
        scale: coordinate in which a search moves it.
        absent: coordinate in systems without this number; NaN if all have it.
        title: name in tables; `name` by default.
        prior: mean and standard deviation of its coordinate; of `Prior.of` by default.
    """

    path: str
    name: str
    dimension: str = "?"
    meaning: str = ""
    scale: Scale = Scale.LOG
    absent: float = math.nan
    title: str = ""
    prior: tuple[float, float] | None = None


NONE = math.log(1e-9)
"""Coordinate of a strength, or of a lag, that is none."""

GAIN, DRIFT = "propulsion.gain", "flow.velocity"
"""Paths of the numbers in which displacements are linear."""

CORNER, RESIDUAL = "propulsion.response.corner", "propulsion.response.residual"
DELAY, LAG = "propulsion.delay", "propulsion.lag"
BLOCK_NOISE = "noise of a block"
"""Name of the standard deviation of a block's mean position."""

ROLLING = (
    Parameter(
        *(CORNER, "corner", "Hz", "where the gain begins to fall"),
        title="corner frequency",
        absent=0.0,
    ),
    Parameter(
        *(
            RESIDUAL,
            "residual",
            "1",
            "part that remains far above the corner frequency",
        ),
        *(Scale.LOGIT, 0.0, "residual gain"),
    ),
    Parameter(DELAY, "delay", "T", "from a command to its effect", Scale.PLAIN, 0.0),
    Parameter(
        *(LAG, "lag", "T", "time constant with which the motion follows the command"),
        absent=NONE,
    ),
)
"""Numbers of a rolling propulsion."""

MEMORY = "its correlation time"
NOISE = (
    Parameter(
        *("wandering.still", "still", "L T-1"),
        "standard deviation of the wandering velocity",
        title="wandering without a command",
    ),
    Parameter(
        *("wandering.driven", "driven", "L T-1"),
        "what a command of 1 Hz adds to it, in quadrature",
        title="wandering under a command",
    ),
    Parameter(
        *("wandering.memory", "memory", "T", MEMORY), title="memory of the wandering"
    ),
    Parameter(
        *(BLOCK_NOISE, "noise", "L", "of the mean position of a block of time"),
        title="position error",
    ),
)
"""Numbers of the noise, which are learned in every fit."""

SLOW_DRIFT = (
    Parameter(
        *("wandering.slow", "slow", "L T-1", "standard deviation of its velocity"),
        title="changing drift",
        absent=NONE,
    ),
    Parameter(
        *("wandering.slow_memory", "slow memory", "T", MEMORY),
        title="memory of the changing drift",
        absent=math.log(60.0),
    ),
)
"""Numbers of a drift that changes."""

WANDERING_GAIN = (
    Parameter(
        *("wander of the gain", "gain wander", "L"),
        "its standard deviation, along the heading and across",
        title="wandering of the gain",
        absent=NONE,
    ),
    Parameter(
        *("memory of the gain", "gain memory", "T", MEMORY),
        title="memory of the gain",
        absent=math.log(60.0),
    ),
)
"""Numbers of a gain that wanders."""

DISTURBANCE = (*NOISE, *SLOW_DRIFT, *WANDERING_GAIN)
"""All numbers of the noise, the last of the vector in this order."""

NOISE_PLACES = {p.path: i - len(DISTURBANCE) for i, p in enumerate(DISTURBANCE)}
"""Place of each, counted from the end."""

TURN = "angle from the commanded heading to the motion"
ABOUT_GAIN = (
    Parameter(GAIN, "gain", "L", "displacement per turn of the field", Scale.PLAIN),
    Parameter(GAIN, "gain x/y", "1", "ratio of the gains along both axes", Scale.PLAIN),
    Parameter(GAIN, "heading offset", "rad", TURN, Scale.PLAIN),
)
"""Numbers that a gain matrix gives."""

DRIFTS = tuple(
    Parameter(DRIFT, f"drift {axis}", "L T-1", scale=Scale.PLAIN) for axis in "xy"
)

PARAMETERS = (*ROLLING, *DISTURBANCE)
"""All parameters of a robot that rolls, in the order of their vector."""

ESTIMATED = {p.name: p for p in (*ABOUT_GAIN, *DRIFTS, *PARAMETERS)}
"""All numbers of a rolling robot, by their names among the estimates."""

Coordinates = Float[np.ndarray, " parameter"]
"""Coordinates of all parameters."""


def learned_noise(
    system: System, *, wandering_gain: bool = False
) -> tuple[Parameter, ...]:
    """The parameters of the noise that a fit of a system learns, in their order."""
    slow = system.wandering is not None and system.wandering.slow > 0
    return (
        *NOISE,
        *(SLOW_DRIFT if slow else ()),
        *(WANDERING_GAIN if wandering_gain else ()),
    )


def coordinates_of(
    parameters: Sequence[Parameter], swimmer: Any, noise: Mapping[str, float]
) -> Coordinates:
    """Coordinates of parameters, absent where there is no such number.

    Args:
        swimmer: the paths of parameters of a drive lead to its numbers.
        noise: numbers of the noise, by the paths of their parameters.
    """
    coordinates = np.array([parameter.absent for parameter in parameters])
    for place, parameter in enumerate(parameters):
        number = noise.get(parameter.path, math.nan)
        if parameter.path not in NOISE_PLACES:
            with contextlib.suppress(InputError):
                number = float(FreeNumber(parameter.path).pick(swimmer))
        at = parameter.scale.coordinate(number)
        coordinates[place] = at if math.isfinite(at) else coordinates[place]
    return coordinates


def stated_noise(system: System) -> dict[str, float]:
    """The noise that a system states, by the paths of its parameters."""
    stated = {} if system.wandering is None else vars(system.wandering)
    numbers = {f"wandering.{name}": float(one) for name, one in stated.items()}
    return {BLOCK_NOISE: float(system.observation.noise), **numbers}


def fitted_coordinates(
    fit: EvidenceFit, parameters: Sequence[Parameter] = PARAMETERS
) -> Coordinates:
    """Coordinates of a swimmer that was fitted, and of its noise."""
    noise = {name: one.value for name, one in fit.constants.items()}
    return coordinates_of(parameters, fit.model, noise)


class Prior(NamedTuple):
    """Normal priors of the coordinates of some parameters, and their lower bounds."""

    mean: Coordinates
    sd: Coordinates
    least: Coordinates

    @classmethod
    def of(cls, track: Track, parameters: Sequence[Parameter] = PARAMETERS) -> "Prior":
        """Wide priors about the scales of a track, where a parameter brings none.

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
        rows = [one.prior or table[one.name] for one in parameters]
        # A delay is not negative.
        least = [
            one.scale.coordinate(0.0) if one.path == DELAY else math.nan
            for one in parameters
        ]
        mean, sd = np.array(rows).T
        return cls(mean, sd, np.array(least))

    def about(self, coordinates: Coordinates) -> "Prior":
        """Priors as wide as these about other centres; its own where they are NaN."""
        stated = np.isfinite(coordinates)
        return self._replace(mean=np.where(stated, coordinates, self.mean))

    def bounds(self) -> Float[np.ndarray, "parameter 2"]:
        """Five standard deviations either way, from the least coordinate on."""
        low = np.where(np.isfinite(self.least), self.least, self.mean - 5 * self.sd)
        return np.stack([low, self.mean + 5 * self.sd], axis=1)


def _typical_speed(track: Track) -> float:
    speeds = []
    for piece in track.pieces:
        first, last = pairs_apart(piece.times, track.width)
        step = piece.states[last] - piece.states[first]
        interval = piece.times[last] - piece.times[first]
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
