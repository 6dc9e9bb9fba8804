"""The result of a fit of thermal motion."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.dynamics import BrownianSwimmer
from pinav.fitting.engine.evidence_fit import EvidenceFit, GoodnessOfFit
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.langevin.checks import LangevinChecks
from pinav.fitting.langevin.diffusion import DiffusionField
from pinav.fitting.langevin.increments import ObservedAxes
from pinav.fitting.langevin.tracking import ReferencePath
from pinav.fitting.outcome import Outcome


class LangevinFit(eqx.Module):
    """A force learned from thermal motion, and what else the motion says.

    It has all that an `EvidenceFit` has, so that what takes one takes its
    `regression`.

    Attributes:
        regression: the drift given the diffusion; its posterior holds the share of the
            diffusion too.
        diffusion: D [L² T⁻¹]: one number, or a field along the axes.
        observation: exposure and error of each group of axes; empty where positions
            count as exact.
        reference: the path of the frame of reference, where it drifts.
        checks: of the innovations; None where positions count as exact.
        thermal_energy: $k_BT$ [F L] where Einstein's relation was used.
    """

    regression: EvidenceFit
    diffusion: Estimate | DiffusionField
    observation: tuple[ObservedAxes, ...] = ()
    reference: ReferencePath | None = None
    checks: LangevinChecks | None = None
    thermal_energy: float | None = None

    @property
    def model(self) -> Any:
        """The `OverdampedSwimmer` with its best force, and the learned mobility."""
        return self.regression.model

    @property
    def brownian(self) -> BrownianSwimmer:
        """The model with its thermal noise, where Einstein's relation was used.

        Raises:
            ValueError: it was not, so that mobility and noise are apart.
        """
        if self.thermal_energy is None:
            raise ValueError("LangevinFit.brownian: the fit had a free drift")
        return BrownianSwimmer(self.model, self.thermal_energy)

    @property
    def posterior(self) -> Posterior:
        """Distribution of the weights of the force."""
        return self.regression.posterior

    @property
    def outcome(self) -> Outcome:
        """How the fit ended."""
        return self.regression.outcome

    @property
    def iterations(self) -> int:
        """Steps of the drift, on the last kernels."""
        return self.regression.iterations

    @property
    def hyperparameters(self) -> Hyperparameters:
        """What the evidence chose for the force."""
        return self.regression.hyperparameters

    @property
    def constants(self) -> dict[str, Estimate]:
        """Learned numbers, `diffusion` among them where it is one."""
        return self.regression.constants

    @property
    def linear(self) -> LinearFit:
        """The linear problem of the drift; see `model_evidence`."""
        return self.regression.linear

    @property
    def goodness(self) -> GoodnessOfFit | None:
        """Whether the innovations look like noise."""
        return self.regression.goodness

    @property
    def states(self) -> Float[np.ndarray, "trajectory time state"] | None:
        """No states are smoothed."""
        return self.regression.states
