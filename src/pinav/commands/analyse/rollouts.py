"""The dependence of a rollout on its start and on all parameters."""

import dataclasses

import numpy as np
from jaxtyping import Float

from pinav.analysis import (
    RolloutStudy,
    SobolIndices,
    lyapunov_map,
)
from pinav.commands.analyse.metrics import (
    LyapunovMetrics,
    SobolRow,
)
from pinav.commands.analyse.subject import Arrays, Subject
from pinav.dynamics import Swimmer
from pinav.errors import InputError

LYAPUNOV_POINTS = 25
"""Starts along each side of the map of Lyapunov exponents."""


@dataclasses.dataclass(frozen=True)
class RolloutSensitivity:
    """The dependence of a rollout on its start and on all parameters.

    Attributes:
        lyapunov: exponents over starts.
        arrays: their map.
        sobol: indices of the reference rollout.
        landmark: highest point of the potential near the data [L].
        left_out: what could not be found, and why.
    """

    lyapunov: LyapunovMetrics
    arrays: Arrays
    sobol: tuple[SobolRow, ...] | None = None
    landmark: tuple[float, float] | None = None
    left_out: tuple[str, ...] = ()


def vary_rollouts(
    subject: Subject, potential: Float[np.ndarray, "rows columns"]
) -> RolloutSensitivity:
    """Dependence of the reference rollout on its start and on all parameters.

    Args:
        subject: the run.
        potential: on its grid; its top near the data is the landmark.
    """
    lyapunov, arrays = _lyapunov(subject)
    field = subject.field
    top = np.where(subject.near, potential, -np.inf).argmax()
    row, column = np.unravel_index(top, potential.shape)
    landmark = np.array([field.x[column], field.y[row]])
    plain = RolloutSensitivity(lyapunov, arrays)
    if not isinstance(subject.model, Swimmer):
        reason = "they are varied for swimmers with inertia alone"
        return dataclasses.replace(plain, left_out=(f"Sobol' indices: {reason}",))
    study = RolloutStudy(
        subject.model, subject.start, subject.times, landmark, field.regions.visited
    )
    settings = subject.settings
    factors = study.factors(relative=settings.relative, shift=settings.shift)
    try:
        indices = study.indices(factors, samples=settings.samples, seed=settings.seed)
    except InputError as error:
        return dataclasses.replace(plain, left_out=(f"Sobol' indices: {error}",))
    place = (float(landmark[0]), float(landmark[1]))
    return dataclasses.replace(plain, sobol=_sobol_rows(indices), landmark=place)


def _lyapunov(subject: Subject) -> tuple[LyapunovMetrics, Arrays]:
    x, y = (
        np.linspace(axis[0], axis[-1], LYAPUNOV_POINTS)
        for axis in (subject.field.x, subject.field.y)
    )
    velocity = subject.start[2:]
    growth = lyapunov_map(
        subject.model,
        x,
        y,
        subject.times,
        velocity=(lambda _: velocity) if len(velocity) else None,
    )
    names = ("x", "y", "separation", "final")
    metrics = LyapunovMetrics(
        horizon=growth.horizon,
        median=float(np.nanmedian(growth.separation)),
        greatest=float(np.nanmax(growth.separation)),
        exponent=float(np.nanmedian(growth.exponent)),
    )
    return metrics, {f"lyapunov/{name}": getattr(growth, name) for name in names}


def _sobol_rows(indices: SobolIndices) -> tuple[SobolRow, ...]:
    return tuple(
        SobolRow(
            outcome=outcome,
            factor=factor,
            first=float(indices.first[i, j]),
            first_low=float(indices.first_interval[i, j, 0]),
            first_high=float(indices.first_interval[i, j, 1]),
            total=float(indices.total[i, j]),
            total_low=float(indices.total_interval[i, j, 0]),
            total_high=float(indices.total_interval[i, j, 1]),
            variance=float(indices.variance[i]),
        )
        for i, outcome in enumerate(indices.outcomes)
        for j, factor in enumerate(indices.factors)
    )
