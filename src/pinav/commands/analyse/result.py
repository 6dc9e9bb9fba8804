"""What `pinav analyse` finds in a run, as one value."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.analysis import (
    EntropyProduction,
    HelmholtzSplit,
    LyapunovMap,
    SobolIndices,
)
from pinav.commands.analyse.settings import AnalyseSettings
from pinav.evaluation import FieldMap


class Doubt(eqx.Module):
    """What the posterior says of the learned force.

    Attributes:
        sd: standard deviation of the force on the grid [L T⁻²].
        rotational: that of the rotational fraction.
        significant: fraction of each region in which the force is above two standard
            deviations.
    """

    sd: Float[np.ndarray, "rows columns 2"]
    rotational: float
    significant: dict[str, float]


class TrajectoryEffect(eqx.Module):
    """What leaving a trajectory out of the fit would do, to first order.

    Attributes:
        trajectory: its index.
        leverage: number of parameters that it determines.
        cook: Cook's distance.
        force: relative change of the force near the data.
        final: change of the final position of the reference rollout [L].
        change: of the force on the grid [L T⁻²].
    """

    trajectory: int
    leverage: float
    cook: float
    force: float
    final: float
    change: Float[np.ndarray, "rows columns 2"]


class ConstantEffect(eqx.Module):
    """What a constant that is one percent larger would do.

    Attributes:
        constant: its name.
        value: its value.
        learned: it was learned beside the force.
        force: relative change of the force near the data.
        final: change of the final position of the reference rollout [L].
        change: of the force on the grid [L T⁻²].
    """

    constant: str
    value: float
    learned: bool
    force: float
    final: float
    change: Float[np.ndarray, "rows columns 2"]


class Analysis(eqx.Module):
    """What a fit has learned, and what it depends on.

    Attributes:
        model: name of the model that stands for the unknown.
        settings: of the analysis.
        units: of the channels, with the order of the dynamics.
        paths: observed positions of each trajectory [L]; NaN where there is none.
        field: the learned force.
        split: its gradient and its rotational part.
        potential: on the grid of the field [L² T⁻²].
        is_potential_learned: it is that of the model, not of the gradient part.
        lyapunov: growth of separations over starts.
        doubt: by the posterior.
        influence: of each trajectory.
        constants: effects of constants.
        sobol: indices of the reference rollout.
        landmark: highest point of the potential near the data [L].
        entropy: production of thermal motion.
        left_out: sentences on what could not be found, and why.
    """

    model: str
    settings: AnalyseSettings
    units: dict[str, str]
    paths: tuple[Float[np.ndarray, "_ 2"], ...]
    field: FieldMap
    split: HelmholtzSplit
    potential: Float[np.ndarray, "rows columns"]
    is_potential_learned: bool
    lyapunov: LyapunovMap
    doubt: Doubt | None = None
    influence: tuple[TrajectoryEffect, ...] = ()
    constants: tuple[ConstantEffect, ...] = ()
    sobol: SobolIndices | None = None
    landmark: tuple[float, float] | None = None
    entropy: EntropyProduction | None = None
    left_out: tuple[str, ...] = ()

    @property
    def all_paths(self) -> Float[np.ndarray, "_ 2"]:
        """All paths in one array, a row of NaN between two."""
        gap = np.full((1, 2), np.nan)
        return np.concatenate([part for path in self.paths for part in (path, gap)])
