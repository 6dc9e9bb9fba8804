r"""The Kalman filter behind every evidence here: a path with a wandering velocity.

Points of the plane are complex numbers, $p = x + iy$. In
$\dot p = \sigma(t) z + u + \gamma\,\dot c\,g$ there are three complex
Ornstein-Uhlenbeck processes, whose real and imaginary parts are independent: a quick
one z of variance 1, whose strength $\sigma$ grows with the drive; a slow one u, the
drift that changes; and g, a gain that wanders. The command $\dot c$ is turned and
stretched by $\gamma g$: its real part is a change of the gain, its imaginary part one
of the heading. Observed is $p$ plus white noise. Known regressors add to p, and the
filter is linear: filtered as further columns, they make the fit of their coefficients
ordinary least squares.

References:
    de Jong, Ann. Statist. 19, 1073 (1991), the augmented filter; Gillespie, Phys. Rev.
    E 54, 2084 (1996), the exact integrated Ornstein-Uhlenbeck process.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from pinav.arguments import Scalar
from pinav.systems import WanderingVelocity


class Disturbance(eqx.Module):
    r"""Noise of a track: its quick and slow velocity, and a gain that wanders.

    Attributes:
        gain_wander: standard deviation of either part of $\gamma g$ [L per cycle].
        gain_memory: correlation time of that gain [T].
    """

    wandering: WanderingVelocity
    gain_wander: Float[Array, ""]
    gain_memory: Float[Array, ""]
    noise: Float[Array, ""]


class Transition(eqx.Module):
    """From one block to the next: state (p, z, u, g), and the covariance it gains."""

    matrix: Complex[Array, "*step 4 4"]
    noise: Float[Array, "*step 4 4"]


def transitions(
    intervals: Float[Array, " step"],
    strength: Float[Array, " step"],
    disturbance: Disturbance,
    cycles: Complex[Array, " step"],
) -> Transition:
    """Transitions over intervals [T], strength and wandering gain held in each.

    They are exact but for the gain, whose memory is long against an interval.

    Args:
        strength: standard deviation of the quick velocity in each [L T⁻¹].
        cycles: turns of the robot in each, along its heading.
    """
    slow = jnp.broadcast_to(disturbance.wandering.slow, strength.shape)
    quick = _integrate(intervals, disturbance.wandering.memory, strength)
    drift = _integrate(intervals, disturbance.wandering.slow_memory, slow)
    ratio = intervals / disturbance.gain_memory
    zero, one = jnp.zeros_like(intervals), jnp.ones_like(intervals)
    matrix = [
        [one, quick[0], drift[0], zero],
        [zero, quick[1], zero, zero],
        [zero, zero, drift[1], zero],
        [zero, zero, zero, jnp.exp(-ratio)],
    ]
    noise = [
        [quick[2] + drift[2], quick[3], drift[3], zero],
        [quick[3], quick[4], zero, zero],
        [drift[3], zero, drift[4], zero],
        [zero, zero, zero, -jnp.expm1(-2 * ratio)],
    ]
    known = _stack(matrix).astype(cycles.dtype)
    # The gain is held over a step: its memory is long against a block.
    moved = disturbance.gain_wander.astype(cycles.dtype) * cycles
    return Transition(known.at[..., 0, 3].set(moved), _stack(noise))


def _stack(rows: list[list[Array]]) -> Array:
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _integrate(interval: Array, memory: Scalar, strength: Array) -> tuple[Array, ...]:
    """Reach and decay of one process of variance 1, and three covariances."""
    lost, decay, spread, fresh = ornstein_uhlenbeck(interval / memory)
    return (
        strength * (memory * lost),
        decay,
        strength**2 * memory**2 * spread,
        strength * memory * lost**2,
        fresh,
    )


def ornstein_uhlenbeck(ratio: Any, xp: Any = jnp) -> tuple[Any, Any, Any, Any]:
    r"""An Ornstein-Uhlenbeck velocity of variance 1 after a time, exactly.

    Args:
        ratio: the time over the memory T.

    Returns:
        $1 - e^{-r}$, which is the way by a velocity at the beginning in units of T;
        $e^{-r}$; the variance that the way gains, in units of T²; and what the
        velocity gains. The covariance of both is the square of the first, times T.
    """
    decay = xp.exp(-ratio)
    # 1 - exp(-ratio) without loss of digits where an interval is short.
    lost = -xp.expm1(-ratio)
    spread = 2 * ratio - 3 + 4 * decay - decay**2
    spread = xp.where(ratio < SMALL, 2 * ratio**3 / 3, spread)  # cancellation
    return lost, decay, spread, -xp.expm1(-2 * ratio)


SMALL = 1e-3
"""Intervals this short against the memory are taken to third order."""


class Innovations(eqx.Module):
    """Innovation of each block in its standard deviation, whose log variance is given.

    Attributes:
        columns: whitened columns, x + iy; zero without a block, as is its log variance.
    """

    columns: Complex[Array, "step column"]
    log_variance: Float[Array, " step"]


def innovations(
    columns: Complex[Array, "block column"],
    present: Float[Array, " block"],
    begins: Float[Array, " block"],
    transition: Transition,
    noise: Float[Array, ""],
) -> Innovations:
    """Filter the columns of segments; the first block of each only sets its start.

    Args:
        columns: observed positions and regressors at each block, x + iy.
        present: 1 for a block, 0 for padding, which comes last.
        begins: 1 for the first block of a segment.
        noise: standard deviation of an observed coordinate.
    """

    # What a step computes is computed again for the gradient: storing it at each block
    # takes two thirds of the time.
    @jax.checkpoint
    def step(state: State, inputs: tuple[Array, ...]) -> tuple[State, tuple]:
        matrix, added, row, here, new = inputs
        ahead = predict(state, matrix, added)
        innovation, variance, updated = update(ahead, row, noise)
        begun = begin(row, noise)
        after = [jnp.where(new > 0, a, b) for a, b in zip(begun, updated, strict=True)]
        whitened = innovation * (here / jnp.sqrt(variance)).astype(row.dtype)
        return (after[0], after[1]), (whitened, here * jnp.log(variance))

    # The first block of a segment sets the start and is no evidence.
    here = present[1:] * (1 - begins[1:])
    rows = transition.matrix, transition.noise, columns[1:], here, begins[1:]
    _, (whitened, log_variance) = jax.lax.scan(step, begin(columns[0], noise), rows)
    return Innovations(whitened, log_variance)


State = tuple[Array, Array]
"""Mean of (p, z, u, g) for each column, and their Hermitian covariance, each part of a
complex number for itself."""


def begin(row: Array, noise: Array) -> State:
    """The state at the first block of a segment."""
    unit = jnp.zeros_like(row)
    one = jnp.ones(())
    # The position is known as well as its block; the processes are stationary, of
    # variance 1.
    variances = jnp.diag(jnp.stack([noise**2, one, one, one]))
    return jnp.stack([row, unit, unit, unit]), variances.astype(row.dtype)


def predict(state: State, matrix: Array, added: Array) -> State:
    """The state after a transition, by its matrix and the covariance that it adds."""
    mean, covariance = state
    half = _product(matrix, covariance)
    spread = _product(matrix, half.conj().T)
    return _product(matrix, mean), spread + added.astype(spread.dtype)


def _product(matrix: Array, other: Array) -> Array:
    """Element by element: four rows are too few for a call of a matrix product."""
    return jnp.sum(matrix[:, :, None] * other[None], axis=1)


def update(ahead: State, row: Array, noise: Array) -> tuple[Array, Array, State]:
    """Innovation of an observation, its variance, and the state that knows it."""
    mean, covariance = ahead
    variance = covariance[0, 0].real + noise**2
    column = covariance[:, 0]
    gain = column / variance.astype(column.dtype)
    innovation = row - mean[0]
    mean = mean + gain[:, None] * innovation[None]
    return innovation, variance, (mean, covariance - jnp.outer(gain, column.conj()))
