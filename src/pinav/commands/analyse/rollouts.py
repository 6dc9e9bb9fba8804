"""The dependence of a rollout on its start and on all parameters."""

import numpy as np
from jaxtyping import Float

from pinav.analysis import LyapunovMap, RolloutStudy, SobolIndices, lyapunov_map
from pinav.commands.analyse.subject import Subject
from pinav.dynamics import Swimmer
from pinav.errors import InputError

LYAPUNOV_POINTS = 25
"""Starts along each side of the map of Lyapunov exponents."""


def vary_starts(subject: Subject) -> LyapunovMap:
    """Growth of separations over the starts of the reference rollout."""
    x, y = (
        np.linspace(axis[0], axis[-1], LYAPUNOV_POINTS)
        for axis in (subject.field.x, subject.field.y)
    )
    velocity = subject.start[2:]
    return lyapunov_map(
        subject.model,
        x,
        y,
        subject.times,
        velocity=(lambda _: velocity) if len(velocity) else None,
    )


def vary_parameters(subject: Subject, landmark: Float[np.ndarray, "2"]) -> SobolIndices:
    """Indices of the reference rollout by strengths and start.

    Raises:
        InputError: they are not defined for its model, or a rollout is not finite.
    """
    if not isinstance(subject.model, Swimmer):
        raise InputError("they are varied for swimmers with inertia alone")
    near = subject.field.regions.visited
    study = RolloutStudy(subject.model, subject.start, subject.times, landmark, near)
    settings = subject.settings
    factors = study.factors(relative=settings.relative, shift=settings.shift)
    return study.indices(factors, samples=settings.samples, seed=settings.seed)
