r"""Starts of held-out trajectories that are noisy or not completely observed.

With the model fixed, the start alone is fitted to the first K samples by lifted
Gauss-Newton steps: every sample state is a point of linearisation, so that a rollout
that depends on its start sensitively does no harm. What follows those K samples is then
a prediction; the K samples themselves are not.

References:
    Bock, Randwertproblemmethoden zur Parameteridentifizierung (1987).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.dynamics import (
    AbstractDynamics,
    FixedStep,
    drive_by_arrays,
    takes_commands,
    with_dtype,
)
from pinav.errors import InputError
from pinav.evaluation.scores import require_x64
from pinav.fitting import Outcome
from pinav.fitting.engine.local_model import ParametricModel, known_model
from pinav.fitting.engine.multiple_shooting import Linearisation, advance, linearise
from pinav.fitting.matching.state import Observations
from pinav.trajectories import Trajectories, smooth_states

START_SAMPLES = 20
"""Samples from which a start is estimated."""

STEPS, TOLERANCE = 30, 1e-9
"""Gauss-Newton steps at most, and the relative change at which they end."""


class Starts(eqx.Module):
    """Estimated starts.

    Attributes:
        states: state at the first time of each trajectory; NaN where it failed,
            because the samples do not determine it or the model diverged on them.
        lifted: states at the first samples, about which was linearised last.
        outcomes: how each estimate ended; a stalled one holds the last step.
    """

    states: Float[np.ndarray, "trajectory state"]
    lifted: Float[np.ndarray, "trajectory sample state"]
    outcomes: tuple[Outcome, ...]
    count: int


def estimate_starts(
    dynamics: AbstractDynamics,
    trajectories: Trajectories,
    *,
    count: int = START_SAMPLES,
) -> Starts:
    r"""Least squares for each start, the model fixed.

    $\min_s \sum_{k<K} |m_k (y_k(s) - \tilde y_k)|^2$ with the mask $m_k$ of what was
    observed.

    Args:
        count: $K$, at least 2.

    Raises:
        InputError: a trajectory is too short, a channel has too few observations among
            its first samples, or x64 is switched off.
    """
    require_x64("estimating starts")
    head = first_samples(trajectories, count)
    dim = head.dim
    states = on_device(smooth_states(head, dim))
    scale = np.maximum(np.ptp(np.asarray(states), axis=1), np.finfo(float).tiny)
    free = known_model(with_dtype(dynamics, jnp.float64))
    solver = FixedStep(substeps=4)
    nothing, settled = jnp.zeros(0), np.zeros(len(head), bool)
    for _ in range(STEPS):
        linear = linearise_driven(free, nothing, states, head, solver)
        moved = advance(states, linear, nothing)
        change = np.abs(np.asarray(moved - states)).max(axis=1) / scale
        settled = (change < TOLERANCE).all(axis=1)
        states = moved
        if (settled | ~np.isfinite(change).all(axis=1)).all():
            break
    lifted = np.asarray(states)
    finite = np.asarray(np.isfinite(lifted).all(axis=(1, 2)))
    ended = np.where(settled, Outcome.CONVERGED, Outcome.STALLED)
    outcomes = tuple(map(Outcome, np.where(finite, ended, Outcome.DIVERGED).tolist()))
    lifted = np.where(finite[:, None, None], lifted, np.nan)
    return Starts(lifted[:, 0], lifted, outcomes, count)


class DrivenModel(eqx.Module):
    """A model as a function of its parameters, driven by one trajectory's commands."""

    free: ParametricModel
    times: Float[Array, " time"]
    commands: dict[str, Float[Array, " time"]]

    def __call__(self, theta: Float[Array, " parameter"]) -> AbstractDynamics:
        """The model with these parameters, under the commands."""
        return drive_by_arrays(self.free(theta), self.times, self.commands)


def driven_models(
    free: ParametricModel, theta: Float[Array, " parameter"], trajectories: Trajectories
) -> list[DrivenModel]:
    """The model under the commands of each trajectory."""
    commands = trajectories.commands if takes_commands(free(theta)) else {}
    return [
        DrivenModel(
            free,
            on_device(times),
            {name: on_device(values[index]) for name, values in commands.items()},
        )
        for index, times in enumerate(trajectories.times)
    ]


def linearise_driven(
    free: ParametricModel,
    theta: Float[Array, " parameter"],
    states: Float[Array, "trajectory time state"],
    trajectories: Trajectories,
    solver: FixedStep,
) -> Linearisation:
    """`linearise`, each trajectory under its own commands where the model takes any."""
    observations = Observations.of(trajectories, jnp.float64)
    if not takes_commands(free(theta)):
        return linearise(free, theta, states, observations, solver)
    parts = []
    for index, driven in enumerate(driven_models(free, theta, trajectories)):
        row = jax.tree.map(lambda leaf, i=index: leaf[i : i + 1], observations)
        parts.append(linearise(driven, theta, states[index : index + 1], row, solver))
    return Linearisation(
        hessian=jnp.stack([part.hessian for part in parts]).sum(axis=0),
        gradient=jnp.stack([part.gradient for part in parts]).sum(axis=0),
        squares=jnp.stack([part.squares for part in parts]).sum(),
        columns=jnp.concatenate([part.columns for part in parts]),
        start_factor=jnp.concatenate([part.start_factor for part in parts]),
        start_rows=jnp.concatenate([part.start_rows for part in parts]),
        defects=jnp.max(jnp.stack([part.defects for part in parts]), axis=0),
    )


def first_samples(trajectories: Trajectories, count: int) -> Trajectories:
    """The first `count` samples of each trajectory; InputError if one has no more."""
    if count < 2:
        raise InputError(f"starts count: expected 2 or more samples, got {count}")
    for index, length in enumerate(trajectories.lengths):
        if length <= count:
            raise InputError(
                f"trajectory {index}: expected more than {count} samples, from which "
                f"its start is estimated, got {length}; drop it"
            )
    pieces = [
        jax.tree.map(lambda array: array[:count], piece) for piece in trajectories
    ]
    return Trajectories.from_pieces(
        pieces, trajectories.channels, trajectories.units, trajectories.provenance
    )


def without_first(trajectories: Trajectories, count: int) -> Trajectories:
    """The trajectories, their first `count` samples not observed."""
    observed = trajectories.observed.copy()
    observed[:, :count] = False
    return eqx.tree_at(lambda t: t.observed, trajectories, observed)
