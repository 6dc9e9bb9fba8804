"""Findings of a fit: its errors, constants, force, structure, and remarks."""

import dataclasses

import numpy as np
from jaxtyping import Float

from pinav.evaluation import FieldMap, ForceLine, RestartErrors
from pinav.fitting import Estimate, Hyperparameters
from pinav.fitting.checks.departures import Contradiction
from pinav.fitting.structure.trace import Hypothesis
from pinav.learning.matching import Losses
from pinav.learning.thermal import ThermalFindings
from pinav.learning.verdict import Verdict


@dataclasses.dataclass(frozen=True)
class Rollouts:
    """The data of a fit, and rollouts of its model over their times.

    Attributes:
        lengths: samples of each trajectory; what follows is padding.
    """

    channels: tuple[str, ...]
    times: Float[np.ndarray, "trajectory time"]
    states: Float[np.ndarray, "trajectory time state"]
    observed: np.ndarray
    predicted: Float[np.ndarray, "trajectory time state"]
    lengths: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class ForceMaps:
    """A planar force on a grid, and the true one where it is known.

    Attributes:
        sd: standard deviation of each component of the learned one [L T⁻²]; None
            without a posterior.
    """

    learned: FieldMap
    truth: FieldMap | None = None
    sd: Float[np.ndarray, "row column 2"] | None = None


@dataclasses.dataclass(frozen=True)
class FoundLaw:
    """A law that the potential of a profile follows.

    Attributes:
        formula: of the potential, in LaTeX, for unit height.
        constants: the height [L² T⁻²] first.
    """

    name: str
    formula: str
    constants: dict[str, Estimate]


@dataclasses.dataclass(frozen=True)
class FoundTerm:
    """A term of the force.

    Attributes:
        geometry: its numbers, such as a centre [L] or an angle [rad].
        profile: the force along its coordinate, where it is a function of one.
    """

    name: str
    formula: str
    geometry: tuple[Estimate, ...]
    law: FoundLaw | None = None
    profile: ForceLine | None = None


@dataclasses.dataclass(frozen=True)
class FoundStructure:
    """Result of a search for a structure.

    Attributes:
        terms: with structure; none where free kernels alone are preferred.
        gain: log evidence over free kernels [nats]; None where no structure explained
            the data well enough to be fitted, or free kernels alone diverge.
        rotation: log evidence of a rotational part beside a potential [nats]; None
            where none was weighed.
        sought: there were data enough for a search.
        of_teacher: it is the structure of the kernels that taught a network.
        tried: the hypotheses of the search, in the order in which they were weighed.
    """

    terms: tuple[FoundTerm, ...]
    gain: float | None
    rotation: float | None = None
    turns: bool = False
    sought: bool = True
    of_teacher: bool = False
    tried: tuple[Hypothesis, ...] = ()


@dataclasses.dataclass(frozen=True)
class Findings:
    r"""Findings of a fit.

    Attributes:
        rmse: root-mean-square errors of rollouts on the training data, by channel; of
            a recording each is a whole film long.
        constants: learned beside the environment.
        units: of the channels and of time; with the order of the dynamics.
        force_error: relative error of the force by region, where the truth is known.
        hyperparameters: chosen by the evidence; their noise is that of a position [L],
            for Langevin dynamics $\sqrt{2D}$.
        support: log evidence of a field beside commands over none [nats].
        restarts: errors of a recording by the length of rollouts.
        contradictions: departures from the stated physics, the largest evidence first.
        lines: the force along lines through other data, by the coordinate.
    """

    DERIVED = ("noise", "log_evidence")

    model: str
    recipe: str
    outcome: str
    verdict: Verdict
    rmse: dict[str, float]
    constants: dict[str, Estimate]
    remarks: tuple[str, ...]
    units: dict[str, str]
    rollouts: Rollouts
    force_error: dict[str, float] | None = None
    hyperparameters: Hyperparameters | None = None
    iterations: int | None = None
    support: float | None = None
    losses: Losses | None = None
    restarts: RestartErrors | None = None
    structure: FoundStructure | None = None
    thermal: ThermalFindings | None = None
    force: ForceMaps | None = None
    lines: dict[str, ForceLine] | None = None
    contradictions: tuple[Contradiction, ...] = ()

    @property
    def noise(self) -> float | None:
        """Standard deviation of the observations that the fit found."""
        return None if self.hyperparameters is None else self.hyperparameters.noise

    @property
    def log_evidence(self) -> float | None:
        """Log evidence of the fit [nats]."""
        chosen = self.hyperparameters
        return None if chosen is None else chosen.log_evidence
