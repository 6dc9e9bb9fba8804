"""The interface of a finished fit, by which it is evaluated, analysed and explained."""

import abc
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractDynamics
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.environments.summary import ModelChoice
from pinav.systems import System, WanderingVelocity
from pinav.trajectories import Trajectories
from pinav.units import with_order


class AbstractLearned(abc.ABC):
    """A finished fit with one model, or with several that are compared.

    Attributes:
        system: the known part of the swimmer.
        models: the fitted models by name; that of a single one is `model`.
        choice: the model that stands for the unknown, and the learned constants.
        evidence: posterior, hyperparameters and smoothed states; None where the recipe
            has none.
    """

    system: System
    data: Trajectories
    models: dict[str, AbstractDynamics]
    choice: ModelChoice
    evidence: Any

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the channels, with the order of the dynamics and of a force."""
        force = self.system.base_units.force
        return with_order(self.data.units, self.system.order, force)

    @property
    @abc.abstractmethod
    def model(self) -> AbstractDynamics:
        """The fitted model.

        Raises:
            InputError: there are several.
        """

    @property
    @abc.abstractmethod
    def posterior(self) -> Posterior | None:
        """The posterior of the parameters; None where the recipe has none."""

    @property
    @abc.abstractmethod
    def noise(self) -> float:
        """Standard deviation of the observations; 0 where the fit gives none."""

    @property
    @abc.abstractmethod
    def wandering(self) -> WanderingVelocity | None:
        """The wandering velocity, learned or stated."""

    @property
    @abc.abstractmethod
    def constants(self) -> Mapping[str, Estimate]:
        """The learned constants by name; their deviation is NaN without a posterior."""

    @property
    @abc.abstractmethod
    def horizon(self) -> float:
        """Longest time since the start in the training data [T]."""

    @abc.abstractmethod
    def start(self, index: int) -> Float[np.ndarray, " state"]:
        """The start of a training trajectory: estimated, or its first sample."""

    @abc.abstractmethod
    def shared_trajectories(self, data: Trajectories) -> int:
        """Number of the given trajectories that the fit has seen."""
