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
import scipy.linalg
from jaxtyping import Array, Bool, Float

from pinav.dynamics import RK4, FixedStep, Swimmer
from pinav.fitting.environments.force_prior import (
    KernelKind,
    force_columns,
    kernel_ladder,
)
from pinav.fitting.environments.gradient_matching import match_kernels
from pinav.fitting.environments.rates import (
    MOST_SAMPLES,
    RELIABLE,
    ForceSamples,
    forces_beside_drag,
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


class Limits(eqx.Module):
    """Thresholds between the causes.

    Attributes:
        decisive: evidence for each number by which one field is better [nats].
        explained: evidence of a field that leaves a thousandth of the forces [nats].
        no_field: evidence below which there is no field [nats]; a force of pure noise
            has -1.4.
        doubtful: difference between the rates of two splines, relative to the largest
            force, above which the samples are too far apart; below `RELIABLE` a rate is
            not in doubt.
        chaotic: growth of a small difference between two rollouts.
        fewest: reliable samples that tell a field.
        acts: force beside a uniform one and a drag that needs a field, in units of the
            largest one.
        broad: size of the force of a drag in the prior, in units of that of a kernel.
    """

    decisive: float = 0.5
    explained: float = 5.5
    no_field: float = -0.8
    doubtful: float = 0.03
    chaotic: float = 1e4
    fewest: int = 50
    acts: float = 1e-2
    broad: float = 3.0


LIMITS = Limits()


def diagnose(model: Swimmer, trajectories: Trajectories) -> Cause | None:
    """Why a fit to exact data failed.

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
    static = max(fields.potential, fields.free)
    if fields.beside_drag > static + LIMITS.decisive:
        return Cause.PHYSICS
    if doubts.max() > LIMITS.doubtful * largest:
        return Cause.SAMPLES
    learned = as_learned_force(model.environment)
    if learned is not None and learned.is_conservative:
        turns = fields.free > fields.potential + LIMITS.decisive
        if turns and fields.potential < LIMITS.explained:
            return Cause.NO_POTENTIAL
    if static < LIMITS.no_field:
        return Cause.PHYSICS
    teacher = model.with_environment(match_kernels(model, rates))
    chaotic = largest_growth(teacher, trajectories) > LIMITS.chaotic
    return Cause.CHAOS if chaotic else Cause.SEARCH


def largest_growth(model: Swimmer, trajectories: Trajectories) -> float:
    r"""By how much a difference of states grows along the data at most.

    The largest singular value of $A_k \cdots A_0$, for positions [L] and velocities
    [L T⁻¹] alike, where $A_k$ is the derivative of a step of the model from sample k.
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
    """Evidence of the best grid of each kind of field, for each number [nats].

    Attributes:
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
    if len(rows) < LIMITS.fewest or not forces[rows].any():
        return _Fields(np.inf, np.inf, np.inf)
    dim = forces.shape[1]
    beside = forces_beside_drag(states[rows, dim:], forces[rows])
    left = np.linalg.norm(beside, axis=1)
    places = states[rows[left >= LIMITS.acts * left.max()], :dim]
    # Where a narrow force acts, forces change although states hardly do.
    told = np.hstack([states, forces])[rows]
    rows = rows[informative_rows(told, MOST_SAMPLES)]
    samples = ForceSamples(places, states[rows, :dim], forces[rows])
    velocities = states[rows, dim:]
    along = velocities[:, :, None]
    if dim == 2:  # where a velocity can be turned
        along = np.stack([velocities, velocities[:, ::-1] * [-1.0, 1.0]], axis=2)
    nothing = along[:, :, :0]
    potential, free, with_drag, free_with_drag = (
        _best_evidence(kind, samples, extra)
        for extra in (nothing, along)
        for kind in (KernelPotential, KernelForce)
    )
    return _Fields(potential, free, max(with_drag, free_with_drag))


def _best_evidence(
    kind: KernelKind,
    samples: ForceSamples,
    extra: Float[np.ndarray, "point dim column"],
) -> float:
    """Evidence of the forces by the best grid of kernels around places."""
    evidence = [-np.inf]
    for laid in kernel_ladder(kind, samples.places):
        columns = force_columns(laid, samples.positions)
        columns = columns.reshape(*samples.forces.shape, -1)
        size = LIMITS.broad * np.sqrt(np.sum(columns**2, axis=(0, 1)).max())
        beside = size * extra / np.sqrt(np.sum(extra**2, axis=(0, 1)))
        columns = np.concatenate([columns, beside], axis=2)
        evidence.append(regression_evidence(columns, samples.forces))
    return max(evidence)


def regression_evidence(
    columns: Float[np.ndarray, "point dim weight"],
    forces: Float[np.ndarray, "point dim"],
) -> float:
    r"""Evidence of a regression for each number that it explains [nats].

    Weights and noise are normal, with variances $s^2$ and $\lambda s^2$. The forces
    $y$, in units of their root mean square, have the covariance
    $s^2 K = s^2 (X X^\top + \lambda I)$; the likeliest scale is
    $s^2 = y^\top K^{-1} y / n$, with which the logarithm of the evidence is
    $-\tfrac12 (n \ln 2\pi s^2 + \ln \det K + n)$. The likeliest of several $\lambda$
    counts. A regression that explains the forces up to a relative error e has some
    $-\ln e - 1.4$ less what its freedom costs.

    Args:
        forces: to be explained, not all zero.

    References:
        MacKay, Neural Computation 4, 415 (1992).
    """
    rows = columns.reshape(-1, columns.shape[-1])
    targets = forces.reshape(-1) / np.sqrt(np.mean(forces**2))
    values, vectors = scipy.linalg.eigh(rows.T @ rows)
    values = np.maximum(values, 0.0)
    along = (vectors.T @ (rows.T @ targets))[:, None] ** 2
    noise = NOISES * np.sum(rows**2, axis=0).max()
    count, spectrum = len(targets), values[:, None]
    # In float64 nothing is explained beyond its rounding, and the difference may be 0.
    # Rounding is that of the sum of squares of the forces.
    left = count - np.sum(along / (noise + spectrum), axis=0)
    scale = np.maximum(left / count, 1e-14) / noise
    determinant = np.sum(np.log1p(spectrum / noise), axis=0) / count + np.log(noise)
    return float(np.max(-0.5 * (np.log(2 * np.pi * scale) + determinant + 1.0)))


NOISES = 10.0 ** -np.arange(2.0, 13.0)
"""Variances of the noise that are tried, relative to the largest sum of squares of a
column."""
