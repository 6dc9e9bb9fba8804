"""The run that is analysed, as all parts of an analysis need it."""

import dataclasses

import numpy as np
from jaxtyping import Float

from pinav.commands.analyse.settings import AnalyseSettings
from pinav.dynamics import OverdampedSwimmer, Swimmer, takes_commands
from pinav.evaluation import FieldMap
from pinav.forces import as_learned_force
from pinav.learning.learned import Learned

COMMANDED_SAMPLES = 250
"""Samples of the reference trajectory that a model driven by commands is rolled out."""


@dataclasses.dataclass(frozen=True)
class Subject:
    """The run that is analysed, as all parts need it.

    Attributes:
        run: the fitted run.
        model: its swimmer with the learned force.
        field: the learned force on a grid.
        settings: of the analysis.
    """

    run: Learned
    model: Swimmer | OverdampedSwimmer
    field: FieldMap
    settings: AnalyseSettings

    @property
    def start(self) -> Float[np.ndarray, " state"]:
        """Start of the reference trajectory."""
        return self.run.start(self.settings.reference)

    @property
    def times(self) -> Float[np.ndarray, " time"]:
        """Times of the reference trajectory [T]; its beginning under commands.

        Every jump of a command ends a step of the solver, for each start of a map.
        """
        index = self.settings.reference
        times = self.run.data.times[index][: self.run.data.lengths[index]]
        return times[:COMMANDED_SAMPLES] if takes_commands(self.run.model) else times

    @property
    def near(self) -> np.ndarray:
        """Grid points near the data."""
        return self.field.distance <= self.field.regions.near

    @property
    def grid(self) -> Float[np.ndarray, "point 2"]:
        """The points of the grid."""
        grid = np.stack(np.meshgrid(self.field.x, self.field.y), axis=-1)
        return grid.reshape(-1, 2)

    @property
    def has_potential(self) -> bool:
        """The learned force is the gradient of a learned potential."""
        learned = as_learned_force(self.model.environment)
        return learned is not None and learned.is_conservative

    def top_of(
        self, potential: Float[np.ndarray, "rows columns"]
    ) -> Float[np.ndarray, "2"]:
        """The place near the data where a potential on the grid is highest [L]."""
        top = np.where(self.near, potential, -np.inf).argmax()
        row, column = np.unravel_index(top, potential.shape)
        return np.array([self.field.x[column], self.field.y[row]])
