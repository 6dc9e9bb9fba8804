"""Priors of the nonlinear parameters of a candidate, from the scales of a track."""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.identification.models import NAMES
from pinav.identification.tracks import Track


class Prior(eqx.Module):
    """Normal priors of the nonlinear parameters, in the order of `NAMES`.

    Attributes:
        mean: their centres.
        sd: their standard deviations.
    """

    mean: Float[np.ndarray, " parameter"]
    sd: Float[np.ndarray, " parameter"]

    @classmethod
    def of(cls, track: Track) -> "Prior":
        """Wide priors about the scales of a track.

        Speeds about a tenth of the track's, within a factor of 20 (two sd); the
        corner about the geometric mean of the commanded frequencies, within a factor
        of 20; delays of a camera and its computer, 0.2 ± 0.2 s; lags about 0.1 s; a
        gain that wanders by about a tenth within ten blocks.
        """
        speed = _typical_speed(track)
        jitter = math.log(0.2 * speed * track.width)
        quick = math.log(0.1 * speed)
        frequency = math.log(_typical_frequency(track))
        table = {
            "log_corner": (frequency, 1.5),
            "logit_residual": (0.0, 1.5),
            "delay": (0.2, 0.2),
            "log_lag": (math.log(0.1), 1.0),
            "log_still": (quick - 1.0, 1.5),
            "log_driven": (quick, 1.5),
            "log_memory": (math.log(2.0 * track.width), 1.0),
            "log_noise": (jitter, 1.5),
            "log_slow": (quick, 1.5),
            "log_slow_memory": (math.log(30.0 * track.width), 1.0),
            "log_gain_wander": (quick - frequency, 1.5),
            "log_gain_memory": (math.log(10.0 * track.width), 1.0),
        }
        mean, sd = np.array([table[name] for name in NAMES]).T
        return cls(mean, sd)

    def bounds(self) -> Float[np.ndarray, "parameter 2"]:
        """Five standard deviations either way; a delay is not negative."""
        reach = 5 * self.sd
        bounds = np.stack([self.mean - reach, self.mean + reach], axis=1)
        bounds[NAMES.index("delay"), 0] = 0.0
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
    if not track.commanded:
        return 1.0
    values = np.concatenate([p.commands["frequency"] for p in track.pieces])
    values = values[values > 0]
    return float(np.exp(np.log(values).mean())) if len(values) else 1.0
