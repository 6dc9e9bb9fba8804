r"""`fit_langevin`: forces, diffusion and observation from paths that heat kicks."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.dynamics import (
    AbstractDynamics,
    BrownianSwimmer,
    OverdampedSwimmer,
    with_dtype,
)
from pinav.errors import InputError
from pinav.fitting.bayes.parameters import learned_environment
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.environments.kernels import check_size
from pinav.fitting.environments.refinement import AS_FINE_AS_BUMPS, Refinement
from pinav.fitting.langevin.checks import LangevinChecks
from pinav.fitting.langevin.diffusion import (
    ConstantDiffusion,
    Diffusion,
    DiffusionField,
    KernelDiffusion,
    begin_motion,
    observed_axes,
)
from pinav.fitting.langevin.drift import mix_over_shapes
from pinav.fitting.langevin.increments import (
    Increments,
    LearnedObservation,
    ObservedAxes,
    Relation,
)
from pinav.fitting.langevin.rounds import (
    LATER_STEPS,
    SCORING_STEPS,
    RoundResult,
    diffusion_share,
    fit_drift,
    fit_motion,
    langevin_checks,
    levels_share,
    motion_covariance,
)
from pinav.fitting.langevin.tracking import (
    ReferencePath,
    SlowReference,
    first_path,
    from_reference,
    track_reference,
)
from pinav.forces import as_learned_force
from pinav.systems import Observation
from pinav.trajectories import Trajectories


class ThermalResult(eqx.Module):
    """The findings of a fit of thermal motion, beside the force.

    Attributes:
        diffusion: D [L² T⁻¹]: one number, or a field along the axes that is called with
            points, one a row, and has `sd`.
        observation: exposure and error of each group of axes; empty where positions
            count as exact.
        reference: the path of the frame of reference, where it drifts.
        checks: of the innovations.
        thermal_energy: $k_BT$ [F L] where Einstein's relation was used.
    """

    diffusion: Estimate | DiffusionField
    observation: tuple[ObservedAxes, ...] = ()
    reference: ReferencePath | None = None
    checks: LangevinChecks | None = None
    thermal_energy: float | None = None


ROUNDS = 10
"""Turns of diffusion and drift at most."""

NEGLIGIBLE = 0.01
"""Change of the means of all increments, in squares of standard deviations, that ends
the turns: it is that of a tenth of one parameter's standard deviation."""


def fit_langevin(
    model: AbstractDynamics,
    trajectories: Trajectories,
    *,
    diffusion: Diffusion | None = None,
    observation: Observation | LearnedObservation | None = None,
    einstein: bool = False,
    reference: SlowReference | None = None,
    refine: Refinement | None = AS_FINE_AS_BUMPS,
) -> EvidenceFit:
    r"""Fit the force, and the diffusion, to stochastic paths.

    $$dX = v\,dt + \sqrt{2D}\,dW,\qquad v = u + \beta D F + \nabla\cdot D
      \quad\text{or}\quad v = u + M F,$$

    in Itô's sense, with the force F of the model's environment. The first is Einstein's
    relation: the mobility is $D/k_BT$ and its divergence is part of the drift, not of
    the force. The second is a free drift: the model's mobility is kept, and D does not
    tell of it; with a mobility of one F is v itself.

    Increments are those of positions that a camera averages over an exposure and errs
    about, unless positions are exact: then an error s adds about $s^2/\Delta t$ to D.
    Diffusion, drift and reference take turns: the diffusion and observation by maximum
    likelihood given the drift, the force by causal generalised least squares given
    them, both with priors that the evidence chooses. Steps follow the drift linearised
    at their start (`Transition`), so that intervals may be as long as the time in
    which the force relaxes. Times may be irregular and samples missing. There may be
    one coordinate, two or three, with any channel names; those in which the
    environment (`KernelProfile`) or the diffusion is periodic may be wrapped or not.

    Args:
        model: an `OverdampedSwimmer`, or a `BrownianSwimmer` that has one; its
            environment is linear in its weights: `kernel_environment`, or a
            `KernelProfile` along some axes (`profile_environment`).
        trajectories: their channels are the positions.
        diffusion: D where it is known [L² T⁻¹]; None for one number to learn,
            `ConstantDiffusion(groups)` for one of each group of axes,
            `KernelDiffusion(axes, groups)` for fields.
        observation: `Observation(noise, exposure)` where it is known,
            `LearnedObservation()` to learn both for each group of axes; None counts
            positions as exact.
        einstein: whether mobility is $D/k_BT$, with the `thermal_energy` of a
            `BrownianSwimmer`; otherwise it is that of the model.
        reference: a coordinate whose zero drifts slowly; fields depend on the
            coordinate from there.
        refine: when kernels of the force turn out too coarse, and finer ones are laid;
            None keeps them. Those of a `KernelProfile` stay.

    Returns:
        The fit, of force and mobility; its posterior is that of the force and holds the
        share of the diffusion, its `thermal` is a `ThermalResult`.

    Raises:
        InputError: the model is none of these, its environment is not linear in its
            weights, the channels are not its positions, there are no increments,
            `diffusion` is a number <= 0 or its groups are not the axes, or Einstein's
            relation is asked for without a `BrownianSwimmer`.
        FitError: the drift or the likelihood is not finite.

    References:
        Frishman and Ronceray, Phys. Rev. X 10, 021009 (2020); Vestergaard, Blainey and
        Flyvbjerg, Phys. Rev. E 89, 022726 (2014); Lau and Lubensky, Phys. Rev. E 76,
        011123 (2007); Kloeden and Platen, Numerical Solution of Stochastic Differential
        Equations (1992).
    """
    swimmer = _first_order_swimmer(model, trajectories)
    known = float(diffusion) if isinstance(diffusion, float | int) else None
    if known is not None and not 0 < known < np.inf:
        raise InputError(
            f"fit_langevin diffusion: expected a finite number > 0, got {diffusion}; "
            "leave it out to estimate it"
        )
    increments = Increments.of(trajectories)
    relation = Relation(
        thermal_energy=_thermal_energy(model) if einstein else None,
        learn_diffusion=known is None,
        observation=observation
        if isinstance(observation, LearnedObservation)
        else None,
    )
    kind = ConstantDiffusion() if diffusion is None else diffusion
    increments = increments.wrap(_periods(swimmer, kind))
    path = None if reference is None else first_path(reference, increments)
    first = increments if path is None else from_reference(increments, path)
    with jax.enable_x64(new_val=True):
        motion = begin_motion(kind, observation, first)
        swimmer = with_dtype(swimmer, jnp.float64)
        belief = RoundResult.first(swimmer, motion, first, relation)
        # The drift comes first: where steps are long, what it relaxes looks like errors
        # of the camera until it is known.
        belief, _ = fit_drift(belief, refine, trajectories)
        turns = 0
        while True:
            before, turns = belief, turns + 1
            most = SCORING_STEPS if turns == 1 else LATER_STEPS
            belief, problem, step = fit_motion(belief, most)
            belief, fit = fit_drift(belief, refine, trajectories)
            if turns == ROUNDS or belief.moved_from(before) < NEGLIGIBLE:
                break
            if reference is not None and path is not None:
                belief, path = track_reference(belief, increments, reference, path)
        covariance, *spreads = motion_covariance(problem, step, belief.motion)
        if relation.learn_diffusion:
            groups = len(belief.motion.diffusion.groups)
            covariance[:groups, :groups] += levels_share(belief, fit)
        tensor = belief.motion.diffusion
        field = DiffusionField(tensor, covariance)
        varies = tensor.weights.size or len(tensor.levels) > 1
        mixed = mix_over_shapes(fit, belief.increments.positions)
        fit = diffusion_share(belief, mixed, field)
        observed = () if observation is None else observed_axes(belief.motion, *spreads)
        result = ThermalResult(
            diffusion=field if varies else field.estimates()[0],
            observation=observed,
            reference=path,
            checks=langevin_checks(belief, observed),
            thermal_energy=relation.thermal_energy,
        )
        constants = fit.constants | _numbers(field, observed)
        return dataclasses.replace(fit, constants=constants, thermal=result)


def _numbers(
    field: DiffusionField, observed: tuple[ObservedAxes, ...]
) -> dict[str, Estimate]:
    """Diffusion where it is the same everywhere, exposure and error of each group."""
    groups = field.tensor.groups
    several = len(groups) > 1
    marks = [f"[{','.join(map(str, axes))}]" if several else "" for axes in groups]
    numbers = {}
    if not field.tensor.weights.size:
        pairs = zip(marks, field.estimates(), strict=True)
        numbers = {f"diffusion{mark}": value for mark, value in pairs}
    for mark, axes in zip(marks, observed, strict=False):
        numbers |= {f"exposure{mark}": axes.exposure, f"error{mark}": axes.error}
    return numbers


def _periods(swimmer: OverdampedSwimmer, diffusion: Diffusion) -> dict[int, float]:
    """Periods of the coordinates, as environment or diffusion state them."""
    axes = diffusion.axes if isinstance(diffusion, KernelDiffusion) else ()
    periods = {axis.index: axis.period for axis in axes if axis.period is not None}
    learned = as_learned_force(swimmer.environment)
    return periods if learned is None else periods | learned.periods


def _thermal_energy(model: AbstractDynamics) -> float:
    if not isinstance(model, BrownianSwimmer):
        raise InputError(
            "fit_langevin einstein: expected a BrownianSwimmer, whose thermal energy "
            "tells the force from the mobility; pass one, or einstein=False for a "
            "drift that the diffusion does not tell of"
        )
    energy = float(model.thermal_energy)
    if not 0 < energy < np.inf:
        raise InputError(
            f"fit_langevin einstein: expected a thermal energy > 0, got {energy}"
        )
    return energy


def _first_order_swimmer(
    model: AbstractDynamics, trajectories: Trajectories
) -> OverdampedSwimmer:
    swimmer = model.swimmer if isinstance(model, BrownianSwimmer) else model
    if not isinstance(swimmer, OverdampedSwimmer):
        raise InputError(
            "fit_langevin model: expected a swimmer without inertia, got "
            f"{type(model).__name__}; for Swimmer use fit_bayes"
        )
    environment = learned_environment(swimmer)
    if environment is None or not environment.is_linear:
        raise InputError(
            "fit_langevin model: expected an environment made by kernel_environment, "
            f"got {type(swimmer.environment).__name__}"
        )
    check_size(environment)
    dim = environment.dim
    if len(trajectories.channels) != dim:
        raise InputError(
            f"fit_langevin trajectories: expected {dim} channels, positions alone, got "
            f"{', '.join(trajectories.channels)}"
        )
    return swimmer
