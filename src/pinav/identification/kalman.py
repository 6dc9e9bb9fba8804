r"""The Kalman filter behind every evidence here: a path with a wandering velocity.

Along each axis $\dot p = \sigma(t) z + u$ with Ornstein-Uhlenbeck processes: a quick
one z of variance 1, whose strength $\sigma$ grows with the drive, and a slow one u, the
drift that changes. Observed is $p$ plus white noise. Known regressors add to p, and the
filter is linear: filtered as further columns, they make the fit of their coefficients
ordinary least squares.

References:
    de Jong, Ann. Statist. 19, 1073 (1991), the augmented filter; Gillespie, Phys. Rev.
    E 54, 2084 (1996), the exact integrated Ornstein-Uhlenbeck process.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Disturbance(eqx.Module):
    r"""Noise of a track.

    Attributes:
        still: standard deviation of the quick velocity without drive [L T⁻¹].
        driven: its growth, $\sigma^2 = \mathrm{still}^2 + \mathrm{driven}^2 \sqrt f$.
        memory: correlation time of the quick velocity [T].
        slow: standard deviation of the slow velocity [L T⁻¹].
        slow_memory: its correlation time [T].
        noise: of the mean position of a block [L].
    """

    still: Float[Array, ""]
    driven: Float[Array, ""]
    memory: Float[Array, ""]
    slow: Float[Array, ""]
    slow_memory: Float[Array, ""]
    noise: Float[Array, ""]

    def strength(self, frequency: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        r"""$\sigma$ at these frequencies."""
        rolling = frequency > 0
        root = jnp.sqrt(jnp.where(rolling, frequency, 1.0))
        return jnp.sqrt(self.still**2 + self.driven**2 * jnp.where(rolling, root, 0.0))


class Transition(eqx.Module):
    """From one block to the next: state (p, z, u).

    Attributes:
        matrix: of the mean.
        noise: covariance that is added.
    """

    matrix: Float[Array, "*step 3 3"]
    noise: Float[Array, "*step 3 3"]


def transitions(
    intervals: Float[Array, " step"],
    strength: Float[Array, " step"],
    disturbance: Disturbance,
) -> Transition:
    """Exact transitions over intervals [T], the strength of each held.

    Args:
        intervals: between two times.
        strength: of the quick velocity in each.
        disturbance: memories and the slow velocity.
    """
    slow = jnp.broadcast_to(disturbance.slow, strength.shape)
    quick = _integrate(intervals, disturbance.memory, strength)
    drift = _integrate(intervals, disturbance.slow_memory, slow)
    zero, one = jnp.zeros_like(intervals), jnp.ones_like(intervals)
    matrix = [
        [one, quick[0], drift[0]],
        [zero, quick[1], zero],
        [zero, zero, drift[1]],
    ]
    noise = [
        [quick[2] + drift[2], quick[3], drift[3]],
        [quick[3], quick[4], zero],
        [drift[3], zero, drift[4]],
    ]
    return Transition(*(_stack(rows) for rows in (matrix, noise)))


def _stack(rows: list[list[Array]]) -> Array:
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _integrate(interval: Array, memory: Array, strength: Array) -> tuple[Array, ...]:
    """What one process of variance 1 adds: reach, decay, and three covariances."""
    ratio = interval / memory
    decay = jnp.exp(-ratio)
    reach = memory * -jnp.expm1(-ratio)
    spread = 2 * ratio - 3 + 4 * decay - decay**2
    spread = jnp.where(ratio < SMALL, 2 * ratio**3 / 3, spread)  # cancellation
    return (
        strength * reach,
        decay,
        strength**2 * memory**2 * spread,
        strength * memory * jnp.expm1(-ratio) ** 2,
        -jnp.expm1(-2 * ratio),
    )


SMALL = 1e-3
"""Intervals this short against the memory are taken to third order."""


class Innovations(eqx.Module):
    """What each block adds to the ones before it, in its own standard deviation.

    Attributes:
        columns: whitened columns; zero where there is no block.
        log_variance: of each innovation; zero where there is no block.
    """

    columns: Float[Array, "step column"]
    log_variance: Float[Array, " step"]


def innovations(
    columns: Float[Array, "block column"],
    present: Float[Array, " block"],
    begins: Float[Array, " block"],
    transition: Transition,
    noise: Float[Array, ""],
) -> Innovations:
    """Filter the columns of segments; the first block of each only sets its start.

    Args:
        columns: observed positions and regressors at each block.
        present: 1 for a block, 0 for padding, which comes last.
        begins: 1 for the first block of a segment.
        transition: from each block to the next.
        noise: standard deviation of an observed position.
    """

    def step(state: State, inputs: tuple[Array, ...]) -> tuple[State, tuple]:
        matrix, added, row, here, new = inputs
        ahead = _predict(state, matrix, added)
        innovation, variance, updated = _update(ahead, row, noise)
        begun = _begin(row, noise)
        after = [jnp.where(new > 0, a, b) for a, b in zip(begun, updated, strict=True)]
        whitened = here * innovation / jnp.sqrt(variance)
        return (after[0], after[1]), (whitened, here * jnp.log(variance))

    here = present[1:] * (1 - begins[1:])
    rows = transition.matrix, transition.noise, columns[1:], here, begins[1:]
    _, (whitened, log_variance) = jax.lax.scan(step, _begin(columns[0], noise), rows)
    return Innovations(whitened, log_variance)


State = tuple[Array, Array]
"""Mean of (p, z, u) for each column, and their covariance."""


def _begin(row: Array, noise: Array) -> State:
    """The state at the first block of a segment."""
    unit = jnp.zeros_like(row)
    one = jnp.ones(())
    return jnp.stack([row, unit, unit]), jnp.diag(jnp.stack([noise**2, one, one]))


def _predict(state: State, matrix: Array, added: Array) -> State:
    mean, covariance = state
    return matrix @ mean, matrix @ covariance @ matrix.T + added


def _update(ahead: State, row: Array, noise: Array) -> tuple[Array, Array, State]:
    """What an observation adds, its variance, and the state that knows it."""
    mean, covariance = ahead
    variance = covariance[0, 0] + noise**2
    gain = covariance[:, 0] / variance
    innovation = row - mean[0]
    mean = mean + gain[:, None] * innovation[None]
    return innovation, variance, (mean, covariance - jnp.outer(gain, gain) * variance)


def smoothed_velocity(
    positions: Float[Array, "block 2"],
    strength: Float[Array, " block"],
    transition: Transition,
    disturbance: Disturbance,
) -> tuple[Float[Array, "block 2"], Float[Array, "block 2"], Float[Array, " block"]]:
    """Velocity of both processes at each block.

    Args:
        positions: what the regressors leave [L].
        strength: of the quick velocity at each block.
        transition: from each block to the next.
        disturbance: slow velocity and noise.

    Returns:
        Mean velocity [L T⁻¹] of both processes together, that of the slow one alone,
        and the standard deviation of both together along either axis.

    References:
        Rauch, Tung and Striebel, AIAA J. 3, 1445 (1965).
    """
    noise, start = disturbance.noise, _begin(positions[0], disturbance.noise)

    def forth(state: State, inputs: tuple[Array, ...]) -> tuple[State, tuple]:
        matrix, added, row = inputs
        ahead = _predict(state, matrix, added)
        _, _, updated = _update(ahead, row, noise)
        return updated, (state, ahead)

    def back(later: State, inputs: tuple) -> tuple[State, State]:
        mean, covariance = later
        (past_mean, past_spread), (ahead_mean, ahead_spread), matrix = inputs
        gain = jnp.linalg.solve(ahead_spread, matrix @ past_spread).T
        mean = past_mean + gain @ (mean - ahead_mean)
        covariance = past_spread + gain @ (covariance - ahead_spread) @ gain.T
        return (mean, covariance), (mean, covariance)

    rows = transition.matrix, transition.noise, positions[1:]
    last, (states, ahead) = jax.lax.scan(forth, start, rows)
    passed = states, ahead, transition.matrix
    _, (means, spreads) = jax.lax.scan(back, last, passed, reverse=True)
    means = jnp.concatenate([means, last[0][None]])
    spreads = jnp.concatenate([spreads, last[1][None]])
    slow = jnp.broadcast_to(disturbance.slow, strength.shape)
    weights = jnp.stack([jnp.zeros_like(strength), strength, slow], axis=1)
    both = jnp.einsum("bs,bsa->ba", weights, means)
    alone = slow[:, None] * means[:, 2]
    variance = jnp.einsum("bs,bst,bt->b", weights, spreads, weights)
    return both, alone, jnp.sqrt(variance)
