r"""Results of `pinav design`, and the force that the data of a fit leave open.

A fit of few trajectories can be sure of more than it may be: its kernels end not far
from the data, and its evidence may have found that forces fade away from there. Before
one asks where to go next, such certainty is put aside: to the fitted force is added a
Gaussian process, with a potential of mean zero, which fills the arena with forces of a
given strength and is then conditioned on the data.
"""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray

from pinav.arguments import Planar, check_positive
from pinav.dynamics import FixedStep, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import Observations, Posterior, ravel_model
from pinav.fitting.engine.multiple_shooting import linearise
from pinav.forces import KernelPotential, SumForce
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.belief.belief import Belief
from pinav.navigation.design.campaign import Campaign, Decision
from pinav.navigation.design.choices import InformedDesign, Stage, expected_sd
from pinav.navigation.maps import ArenaGrid, Course, ForceMaps
from pinav.navigation.task.task import Rectangle
from pinav.trajectories import Trajectories

LENGTHS = 10
"""Length scales along the longer side of an arena, unless one is given."""


class PriorField(eqx.Module):
    """The prior of forces where nobody was.

    Attributes:
        arena: where.
        strength: standard deviation of each component [L T⁻²], positive; forces that
            matter to a swimmer are about as strong as its thrust.
        length: length scale of their potential [L]; a tenth of the arena's longer side
            unless given.

    Raises:
        InputError: `strength` or `length` is not positive.
    """

    arena: Rectangle
    strength: float
    length: float | None = None

    def __check_init__(self) -> None:
        check_positive(self, "strength", "length")

    def kernels(self) -> KernelPotential:
        r"""Kernels whose independent weights make such a process, all zero.

        Weights on a grid of spacing b under kernels of width b make a process of the
        length scale $\sqrt2\, b$.
        """
        lower, upper = np.asarray(self.arena.lower), np.asarray(self.arena.upper)
        length = self.length or float((upper - lower).max()) / LENGTHS
        width = length / math.sqrt(2)
        axes = [
            np.linspace(a - width, b + width, math.ceil((b - a) / width) + 3)
            for a, b in zip(lower, upper, strict=True)
        ]
        centers = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        return KernelPotential.with_zero_weights(centers, width)

    def amplitude(self, kernels: KernelPotential) -> float:
        """Standard deviation of the weights that gives the strength."""
        middle = (self.arena.lower + self.arena.upper) / 2

        def force(weights: Float[Array, " kernel"]) -> Planar:
            filled = eqx.tree_at(lambda k: k.weights, kernels, weights)
            return filled(0.0, middle, jnp.zeros_like(middle))

        slopes = np.asarray(jax.jit(jax.jacfwd(force))(kernels.weights))
        return self.strength / math.sqrt(np.mean(np.sum(slopes**2, axis=1)))


def prior_uncertainty(
    model: Swimmer | OverdampedSwimmer,
    trajectories: Trajectories,
    states: ArrayLike,
    *,
    noise: float,
    prior: PriorField,
    solver: FixedStep | None = None,
) -> Posterior:
    r"""Posterior of a force that is added to a fitted model's environment.

    Its mean is zero: the fit is taken for the best guess. The covariance is
    $(1/a^2 + H/\sigma^2)^{-1}$ with the sum of squares' $H$, starts eliminated.

    Args:
        model: the fitted swimmer.
        trajectories: to which it was fitted.
        states: smoothed states, as of `EvidenceFit.states`.
        noise: $\sigma$ of the observations, positive.
        prior: what forces there may be.
        solver: steps between samples; `FixedStep()` unless given.

    Raises:
        InputError: `noise` is not positive.
    """
    if not noise > 0:
        raise InputError(f"prior_uncertainty noise: expected > 0, got {noise}")
    solver = FixedStep() if solver is None else solver
    with jax.enable_x64(new_val=True):
        kernels = prior.kernels()
        environment = SumForce((model.environment, kernels))
        wider = model.with_environment(environment)
        free, theta = ravel_model(wider, lambda m: m.environment.terms[1].parameters)
        observations = Observations.of(trajectories, jnp.float64)
        linear = linearise(free, theta, jnp.asarray(states), observations, solver)
        amplitude = prior.amplitude(kernels)
    return Posterior(
        free, np.asarray(theta), _weight_covariance(linear.hessian, noise, amplitude)
    )


def _weight_covariance(
    hessian: Float[Array, "n n"], noise: float, amplitude: float
) -> Float[np.ndarray, "n n"]:
    """Covariance of the weights, given the data."""
    values, vectors = np.linalg.eigh(np.asarray(hessian))
    precision = amplitude**-2 + np.maximum(values, 0.0) / noise**2
    return (vectors / precision) @ vectors.T


MAP_POINTS = 41
"""Points of the maps of the force along each side."""

Path = Float[np.ndarray, "_ 2"]


@dataclasses.dataclass(frozen=True)
class CampaignSummary:
    """Campaigns of one design in a simulation.

    Attributes:
        finished: campaigns in which the way became known by the belief.
        trajectories: median number of trajectories until then; infinite where more than
            half did not finish.
        fewest: least number of trajectories of a campaign.
        largest: greatest number; campaigns that were given up count with theirs.
        reached: median number of trajectories until the true error was below the
            accuracy for the first time; infinite where more than half did not get
            there.
        right: finished campaigns whose true error was below the accuracy.
        error: median of the true relative error at the end.
    """

    campaigns: int
    finished: int
    trajectories: float
    fewest: int
    largest: int
    reached: float
    right: int
    error: float

    @classmethod
    def of(cls, campaigns: Sequence[Campaign]) -> "CampaignSummary":
        """The summary of the campaigns of one design."""
        counts = np.array([len(one.paths) for one in campaigns])
        finished = np.array([one.finished for one in campaigns])
        ends = np.where(finished, counts, np.inf)
        reached = np.array([_first_below(one) for one in campaigns])
        errors = [d.true_error for d in (one.decisions[-1] for one in campaigns)]
        return cls(
            campaigns=len(campaigns),
            finished=int(finished.sum()),
            trajectories=_median(ends),
            fewest=int(counts.min()),
            largest=int(counts.max()),
            reached=_median(reached),
            right=sum(one.right is True for one in campaigns),
            error=_median(np.array([np.nan if e is None else e for e in errors])),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class NextTrajectory:
    """The trajectory that should be recorded next.

    Attributes:
        sd_after: standard deviation of the force along the way that is expected after
            it.
    """

    sd_after: float
    start: tuple[float, float]
    times: Float[np.ndarray, " knot"]
    frequency: Float[np.ndarray, " knot"]
    heading: Float[np.ndarray, " knot"]

    @classmethod
    def informed(cls, stage: Stage, *, key: PRNGKeyArray) -> "NextTrajectory | None":
        """The choice of the informed design; none where all leave the arena."""
        chosen = InformedDesign().choose(stage, key=key)
        after = expected_sd(stage, chosen)
        if not np.isfinite(after):
            return None
        x, y = np.asarray(chosen.starts[:2], float).tolist()
        series = stage.experiment.knots, chosen.frequency, chosen.heading
        return cls(after, (x, y), *(np.asarray(values, float) for values in series))


@dataclasses.dataclass(frozen=True)
class Recorded:
    """The knowledge of recordings of a lab.

    Attributes:
        arrives: True where the plan on the learned force reaches the goal.
        error: bound of the relative error of the force along the way (95 %).
        certain: True where nothing further need be recorded.
        sd: standard deviation of the force along the way now.
    """

    trajectories: int
    arrives: bool
    error: float
    certain: bool
    sd: float


@dataclasses.dataclass(frozen=True, eq=False)
class DesignResult:
    """Trajectories until the force along a way is known.

    Attributes:
        accuracy: relative error of the force along the way that is small enough.
        maps: learned force after the first campaign, or the recordings.
        way: way that is planned then [L].
        paths: trajectories of the first campaign of each design, or the recordings [L].
        designs: simulated campaigns by the name of their design.
        bounds: bound of the error after each trajectory, by design and campaign.
        recorded: what recordings leave open; none of a simulation.
        next: trajectory to record next; none where no candidate stays in the arena, or
            of a simulation.
    """

    system: str
    accuracy: float
    course: Course
    maps: ForceMaps
    way: Path
    thrust: float
    paths: dict[str, tuple[Path, ...]]
    designs: dict[str, CampaignSummary] = dataclasses.field(default_factory=dict)
    bounds: dict[str, tuple[Float[np.ndarray, " _"], ...]] = dataclasses.field(
        default_factory=dict
    )
    recorded: Recorded | None = None
    next: NextTrajectory | None = None


def map_belief(adaptive: AdaptiveController, belief: Belief) -> ForceMaps:
    """The learned force on the arena, and its standard deviation."""
    grid = ArenaGrid.over(Course.of(adaptive.task), MAP_POINTS)
    mean, sd = belief.force(grid.places)
    return ForceMaps(grid.field(lambda _: mean), sd=grid.lay(sd))


def relative_bound(decision: Decision) -> float:
    """The bound of an error, at most 1: nothing is known of the force."""
    return min(decision.error, 1.0)


def _first_below(campaign: Campaign) -> float:
    for count, decision in enumerate(campaign.decisions):
        error = decision.true_error
        if decision.arrives and error is not None and error <= campaign.accuracy:
            return float(count)
    return np.inf


def _median(values: Float[np.ndarray, " value"]) -> float:
    """The lower median."""
    return float(np.quantile(values, 0.5, method="inverted_cdf"))
