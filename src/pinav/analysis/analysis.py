"""Maps, parts and sensitivities of what a fit has learned, as one value."""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from tqdm import tqdm

from pinav.analysis.effects import (
    ConstantEffect,
    Doubt,
    Subject,
    TrajectoryEffect,
    constant_effects,
    is_thermal,
    judge_significance,
    produce_entropy,
    rollout_study,
    trace_influence,
    trajectory_effects,
    vary_starts,
)
from pinav.analysis.entropy import EntropyProduction
from pinav.analysis.helmholtz import HelmholtzSplit, helmholtz_split
from pinav.analysis.sensitivity.lyapunov import LyapunovMap
from pinav.analysis.sensitivity.sobol import SobolIndices
from pinav.dynamics import OverdampedSwimmer, Swimmer, drive_by_arrays
from pinav.errors import FitError, InputError
from pinav.evaluation import FieldMap, check_planar, field_map
from pinav.fitting import AbstractLearned
from pinav.forces import as_learned_force

Part = TypeVar("Part")


class Analysis(eqx.Module):
    """Everything that the analysis of a fit found.

    Attributes:
        reference: index of the trajectory whose rollout is varied.
        relative: half range of the varied strengths, relative to their values.
        shift: half range of each coordinate of the varied start [L].
        paths: observed positions of each trajectory [L]; NaN where there is none.
        potential: on the grid of the field [L² T⁻²].
        is_potential_learned: it is that of the model, not of the gradient part.
        landmark: highest point of the potential near the data [L].
        left_out: sentences on what could not be found, and why.
    """

    model: str
    reference: int
    relative: float
    shift: float
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


def analyse(
    fit: AbstractLearned,
    *,
    points: int = 41,
    draws: int = 32,
    samples: int = 256,
    reference: int = 0,
    relative: float = 0.1,
    shift: float = 0.1,
    seed: int = 0,
) -> Analysis:
    """Analyse what a fit has learned; what needs a posterior is left out without one.

    Args:
        draws: posterior samples behind the spread of fractions.
        samples: samples of the Sobol' indices, a power of two.
        reference: index of the trajectory whose rollout is varied.
        relative: half range of damping, gain and strength of the environment, relative
            to their values.
        shift: half range of each coordinate of the start [L].

    Raises:
        InputError: the fit learned no planar force, or has no such trajectory.
    """
    left_out: list[str] = []

    def attempt(what: str, part: Callable[[], Part]) -> Part | None:
        try:
            return part()
        except (InputError, FitError) as error:
            left_out.append(f"{what}: {str(error).removeprefix(f'{what}: ')}")
            return None

    with tqdm(total=4, desc="analysis", unit="part") as bar:
        subject = _subject(fit, points, reference)
        field = subject.field
        split = helmholtz_split(field)
        potential = split.potential
        if subject.has_potential:
            values = _potentials(subject.model.environment, field.points)
            potential = np.asarray(values, float).reshape(field.distance.shape)
        bar.update()
        doubt = attempt(
            "standard deviations", lambda: judge_significance(subject, draws, seed)
        )
        bar.update()
        effects = attempt(
            "influence of trajectories and constants", lambda: trace_influence(subject)
        )
        constants = effects and attempt(
            "influence of constants", lambda: constant_effects(subject, effects)
        )
        bar.update()
        lyapunov, landmark = vary_starts(subject), subject.top_of(potential)

        def vary_parameters() -> SobolIndices:
            study = rollout_study(subject, landmark)
            factors = study.factors(relative=relative, shift=shift)
            return study.indices(factors, samples=samples, seed=seed)

        sobol = attempt("Sobol' indices", vary_parameters)
        bar.update()
    entropy = None
    if is_thermal(fit):
        entropy = attempt("entropy production", lambda: produce_entropy(fit))
    states = zip(fit.data.observed[..., :2], fit.data.states[..., :2], strict=True)
    return Analysis(
        model=fit.choice.name,
        reference=reference,
        relative=relative,
        shift=shift,
        units=dict(fit.units),
        paths=tuple(np.where(observed, places, np.nan) for observed, places in states),
        field=field,
        split=split,
        potential=potential,
        is_potential_learned=subject.has_potential,
        lyapunov=lyapunov,
        doubt=doubt,
        influence=trajectory_effects(subject, effects) if effects else (),
        constants=constants or (),
        sobol=sobol,
        landmark=None if sobol is None else (float(landmark[0]), float(landmark[1])),
        entropy=entropy,
        left_out=tuple(left_out),
    )


def _subject(fit: AbstractLearned, points: int, reference: int) -> Subject:
    model = fit.model
    is_swimmer = isinstance(model, Swimmer | OverdampedSwimmer)
    if not is_swimmer or as_learned_force(model.environment) is None:
        raise InputError(
            "analyse: the model has no learned force of the environment; fit a kernel "
            "or neural model"
        )
    if not 0 <= reference < len(fit.data):
        raise InputError(
            f"--reference: expected 0 to {len(fit.data) - 1}, a trajectory of the fit, "
            f"got {reference}"
        )
    check_planar(fit.data)
    piece = fit.data.trajectory(reference)
    model = drive_by_arrays(model, piece.times, piece.commands)
    field = field_map(model.environment, fit.data, points=points)
    return Subject(fit, model, field, reference)


@eqx.filter_jit
def _potentials(
    force: Any, points: Float[ArrayLike, "point 2"]
) -> Float[Array, " point"]:
    return jax.vmap(lambda x: force.potential(0.0, x))(jnp.asarray(points))
