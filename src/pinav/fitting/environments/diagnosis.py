"""Causes of a failed fit to exact data, told from the data and the known physics.

The rates of change of exact states are known by splines, and with them the force that
the known physics leave unexplained. Whether a field explains it, and how fast rollouts
depart from each other, says why no fit can follow the data, or that this one only
failed to find the field.
"""

import enum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.dynamics import RK4, FixedStep, Swimmer
from pinav.fitting.environments.force_regression import (
    RIDGE,
    KernelKind,
    force_columns,
    regress_with_ridges,
)
from pinav.fitting.environments.gradient_matching import (
    ACROSS,
    MOST_KERNELS,
    RELIABLE,
    match_kernels,
)
from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.fitting.environments.rates import (
    MOST_SAMPLES,
    observed_rates,
    residual_forces,
)
from pinav.forces import KernelForce, KernelPotential, as_learned_force
from pinav.trajectories import Trajectories, informative_rows


class Cause(enum.Enum):
    """Why a fit failed; `str()` gives the clause that a user reads.

    Attributes:
        PHYSICS: no field of the position explains the rates of change, or one does
            beside a drag that is not the known one.
        NO_POTENTIAL: a field explains them, no potential does.
        CHAOS: rollouts depart from each other by more than a fit can follow.
        SAMPLES: splines of two degrees disagree on the rates where the force is large.
        SEARCH: none of these: the fit did not find the field that is there.
    """

    PHYSICS = (
        "the known physics are wrong, or the force depends on more than the position, "
        "because no field explains the rates of change: check drag and propulsion "
        "(--system)"
    )
    NO_POTENTIAL = (
        "the force has no potential: choose a model that needs none, such as "
        "--model kernel-force"
    )
    CHAOS = (
        "the motion is chaotic, and rollouts depart from each other by more than a fit "
        "can follow: fit shorter trajectories"
    )
    SAMPLES = (
        "the samples are too far apart where the force is largest: observe at shorter "
        "intervals, or choose --model kernel-potential"
    )
    SEARCH = (
        "it ended before the model had learned the field that explains the data: raise "
        "--max-steps, or choose another --seed or --model kernel-potential"
    )

    def __str__(self) -> str:
        return self.value


def diagnose(model: Swimmer, trajectories: Trajectories) -> Cause | None:
    """Why a fit to exact data failed.

    Args:
        model: as it was fitted.
        trajectories: the data.

    Returns:
        The cause; None where samples are too few or too noisy to tell one.
    """
    rates = observed_rates(trajectories)
    if rates is None:
        return None
    # Noise makes splines of all degrees disagree everywhere, and tells no cause.
    doubts = np.zeros(len(rates.times)) if rates.doubts is None else rates.doubts
    forces = residual_forces(model, rates)
    largest = float(np.linalg.norm(forces, axis=1).max())
    if np.median(doubts) > RELIABLE * largest:
        return None
    fields = _explain(rates.states, forces, doubts < RELIABLE * largest)
    static = min(fields.potential, fields.free)
    if static > UNEXPLAINED and fields.beside_drag < FAR_BETTER * static:
        return Cause.PHYSICS
    if doubts.max() > DOUBTFUL * largest:
        return Cause.SAMPLES
    learned = as_learned_force(model.environment)
    if learned is not None and learned.is_conservative:
        turns = fields.free < BETTER * fields.potential
        if turns and fields.potential > UNEXPLAINED:
            return Cause.NO_POTENTIAL
    if static > NO_FIELD:
        return Cause.PHYSICS
    teacher = model.with_environment(match_kernels(model, rates))
    chaotic = largest_growth(teacher, trajectories) > CHAOTIC
    return Cause.CHAOS if chaotic else Cause.SEARCH


UNEXPLAINED, NO_FIELD = 3e-3, 0.2
"""Relative error of held-out forces that a field leaves unexplained; that from which on
there is no field."""

FAR_BETTER, BETTER = 0.2, 0.8
"""Share of the error of a field that is left beside a drag, and share of that of a
potential that a force without one leaves: it has twice as many weights to find."""

RIDGES = (RIDGE, 1e-9, 1e-7, 1e-5, 1e-3)
"""Between paths that are far apart a field needs more than rounding asks for."""

DOUBTFUL = 0.03
"""Difference between the rates of two splines, relative to the largest force, above
which the samples are too far apart; below `RELIABLE` a rate is not in doubt."""

CHAOTIC = 1e4
"""Growth of a small difference between two rollouts."""


def largest_growth(model: Swimmer, trajectories: Trajectories) -> float:
    r"""By how much a difference of states grows along the data at most.

    The largest singular value of $A_k \cdots A_0$, for positions [L] and velocities
    [L T⁻¹] alike, where $A_k$ is the derivative of a step of the model from sample k.

    Args:
        model: whose rollouts are meant.
        trajectories: where they are linearised.
    """
    growth = 1.0
    for one in trajectories:
        product = np.eye(one.states.shape[1])
        with jax.enable_x64(new_val=True):
            steps = _derivatives(model, jnp.asarray(one.times), jnp.asarray(one.states))
        for step in np.asarray(steps):
            product = step @ product
            growth = max(growth, float(np.linalg.norm(product, 2)))
    return growth


@eqx.filter_jit
def _derivatives(
    model: Swimmer, times: Float[Array, " time"], states: Float[Array, "time state"]
) -> Float[Array, "step state state"]:
    solver = FixedStep(RK4)

    def derivative(
        y: Float[Array, " state"], t0: Float[Array, ""], t1: Float[Array, ""]
    ) -> Float[Array, "state state"]:
        return jax.jacfwd(lambda y: solver.step(model, y, t0, t1))(y)

    return jax.vmap(derivative)(states[:-1], times[:-1], times[1:])


class _Fields(NamedTuple):
    """Relative errors of held-out forces, of the best grid of each kind of field.

    Attributes:
        potential: of a potential.
        free: of a force without one.
        beside_drag: of the better one beside a force along and across the velocity.
    """

    potential: float
    free: float
    beside_drag: float


def _explain(
    states: Float[np.ndarray, "point state"],
    forces: Float[np.ndarray, "point dim"],
    reliable: Bool[np.ndarray, " point"],
) -> _Fields:
    rows = np.flatnonzero(reliable)
    if len(rows) < FEWEST:
        return _Fields(0.0, 0.0, 0.0)
    rows = rows[informative_rows(states[rows], MOST_SAMPLES)]
    dim = forces.shape[1]
    positions, forces = states[rows, :dim], forces[rows]
    velocities = states[rows, dim:]
    # As large as kernels are, so that the ridge hardly touches it.
    velocities = velocities / np.abs(velocities).max()
    beside = velocities[:, :, None]
    if dim == PLANE:
        beside = np.stack([velocities, velocities[:, ::-1] * [-1.0, 1.0]], axis=2)
    nothing = beside[:, :, :0]
    potential, free, with_drag, free_with_drag = (
        _held_out_error(kind, positions, forces, extra)
        for extra in (nothing, beside)
        for kind in (KernelPotential, KernelForce)
    )
    return _Fields(potential, free, min(with_drag, free_with_drag))


FEWEST, PLANE = 50, 2
"""Reliable samples that tell a field, and the dimension in which a velocity turns."""


def _held_out_error(
    kind: KernelKind,
    positions: Float[np.ndarray, "point dim"],
    forces: Float[np.ndarray, "point dim"],
    extra: Float[np.ndarray, "point dim column"],
) -> float:
    """Relative error of every fourth force, by the best grid of kernels and ridge."""
    held_out = np.arange(len(positions)) % 4 == 2
    size, errors = float(np.sqrt(np.mean(forces**2))) or 1.0, [1.0]
    for across in ACROSS[:-1]:
        centers, width = surround_with_kernels(positions, KernelGrid(across, 1.5, 2.0))
        columns = force_columns(kind, positions, centers, width)
        if columns.shape[2] > MOST_KERNELS:
            break
        columns = np.concatenate([columns, extra], axis=2)
        for weights in regress_with_ridges(
            columns[~held_out], forces[~held_out], RIDGES
        ):
            missed = (columns @ weights - forces)[held_out]
            errors.append(float(np.sqrt(np.mean(missed**2))) / size)
    return min(errors)
