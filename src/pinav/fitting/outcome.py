"""How a fit ended: one enumeration for all fits."""

import enum


class Outcome(enum.IntEnum):
    """How a fit ended; `str()` gives the word that tables and reports print.

    Attributes:
        COMPLETED: all steps were taken, of phases that do not judge themselves.
        DIVERGED: the loss, the residuals or the states are not finite, or they depart
            from the dynamics.
        CONVERGED: another step would change nothing that matters.
        STALLED: the steps ran out, or gained too little although the linear model
            promised more.
        UNDER_RESOLVED: converged, but the kernels are coarser than what the data show
            and finer ones would be too many.
        MISFIT: another step would change nothing, and yet the residuals are no noise,
            or kernels follow trajectories in pieces alone: the model is too small, or
            the known physics are wrong.
    """

    COMPLETED = 0
    DIVERGED = 1
    CONVERGED = 2
    STALLED = 3
    UNDER_RESOLVED = 4
    MISFIT = 5

    def __str__(self) -> str:
        return self.name.lower().replace("_", "-")

    def __format__(self, spec: str) -> str:
        return format(str(self), spec)


def confirm(
    outcome: Outcome, residual: float, independent: float, spread: float
) -> Outcome:
    """An outcome that another solver than that of the fit confirms.

    A fit judges itself by its own solver, whose errors grow on an unstable path: there
    a model can follow the data by one solver alone.

    Args:
        residual: root-mean-square residual of the fit's own rollouts.
        independent: that of rollouts by an independent solver.

    Returns:
        `STALLED` in place of `CONVERGED` where the independent rollouts miss the data
        by more than three times the fit's own residual and by more than 1e-4 of their
        spread.
    """
    close = independent <= max(CONFIRMED * residual, CLOSE * spread)
    return Outcome.STALLED if outcome is Outcome.CONVERGED and not close else outcome


CONFIRMED, CLOSE = 3.0, 1e-4
"""Residual of independent rollouts that confirms a fit: in units of its own, and of the
spread of the data."""
