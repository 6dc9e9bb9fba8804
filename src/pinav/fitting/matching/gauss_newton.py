r"""Gauss-Newton on trajectory residuals, from one-step matching to the full rollout.

Rollouts restart from the data every `window` samples; one sample is one-step
matching, all of them the full rollout. All steps are linearised at once, and the
Jacobian of the residuals follows by $J_{k+1} = A_k J_k + B_k$, with J set to zero
where the rollout restarts. The Jacobian of a trained network has a numerical rank of
some tens, so one random projection captures it, and any damping costs nothing more.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.fitting.matching.phases import AbstractPhase
from pinav.fitting.matching.windows import Windows
from pinav.fitting.outcome import Outcome


class GaussNewton(AbstractPhase):
    r"""Damped Gauss-Newton steps on rollouts of `window` samples.

    Each step factors the Jacobian as $J \approx U S V^\top$ of rank `rank`, tries
    several dampings at once and, for each, iterates
    $z \leftarrow z - (S^2 + \lambda)^{-1} (S U^\top r(\theta + V z) + \lambda z)$
    with the true residuals r and the Jacobian held (chord steps), which follows the
    curvature of the network far beyond the linear model. The best point wins.

    The phase is done when the full rollout is good enough (`target`), when `patience`
    steps in a row gained less than a tenth, or when nothing lower is found.

    Attributes:
        window: samples between two restarts; an array, so that phases which differ
            in it alone share one compilation.
        target: root-mean-square residual of the full rollout at which the phase ends.
        patience: slow steps in a row after which it ends.
        converged: residual of the full rollout below which a fit that ended counts as
            converged, whatever ended it.
        steps: number of steps at most.
        rank: columns of the random projection.
        chord_steps: inner iterations with the Jacobian held.
        num_dampings: dampings tried per step, a factor of ten apart.
        linearisation: solver of the Jacobian and of the trial points. It may be
            cruder than that of the objective, which decides where the solution is.

    Raises:
        InputError: a number is not positive.

    References:
        Levenberg 1944; Marquardt 1963. Projection: Halko, Martinsson and Tropp, SIAM
        Review 53, 2011. Windows: Bock's multiple shooting with starts from the data.
    """

    window: Int[Array, ""] = eqx.field(converter=jnp.asarray)
    target: Float[Array, ""] = eqx.field(converter=lambda x: jnp.asarray(x, float))
    patience: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=2)
    converged: Float[Array, ""] = eqx.field(
        converter=lambda x: jnp.asarray(x, float), default=0.0
    )
    steps: int = eqx.field(static=True, default=20)
    rank: int = eqx.field(static=True, default=64)
    chord_steps: int = eqx.field(static=True, default=5)
    num_dampings: int = eqx.field(static=True, default=5)
    linearisation: FixedStep = FixedStep()

    def __check_init__(self):
        for name in ("steps", "rank", "chord_steps", "num_dampings"):
            if getattr(self, name) < 1:
                raise InputError(
                    f"GaussNewton.{name}: expected 1 or more, got {getattr(self, name)}"
                )

    @property
    def name(self):
        return f"L = {int(self.window)}"

    @property
    def num_steps(self):
        return self.steps

    @property
    def chunk_steps(self):
        return 1

    def init(self, loss, params, value):
        theta, _ = ravel_pytree(params)
        return _State(
            damping=jnp.asarray(1e-2, theta.dtype),
            slow=jnp.zeros((), int),
            full=jnp.sqrt(
                value / Windows.of(loss, params, self.window, self.linearisation).count
            ),
            promised=jnp.ones((), theta.dtype),
            coloured=jnp.ones((), bool),
            done=jnp.zeros((), bool),
        )

    @property
    def side_by_side(self):
        return False

    def step(self, loss, params, state):
        windows = Windows.of(loss, params, self.window, self.linearisation)
        value = windows.count * state.full**2
        return jax.lax.cond(
            state.done,
            lambda: (params, state, value),
            lambda: (*self._take_step(windows, params, state), value),
        )

    def _take_step(self, windows: Windows, params, state):
        """Parameters and state after a step that is taken."""
        theta, unravel = ravel_pytree(params)
        starts, residual, surrogate = windows.surrogate(theta)
        step = damped_step(
            surrogate,
            theta,
            (residual, windows.jacobian(theta, starts)),
            state.damping,
            rank=self.rank,
            num_dampings=self.num_dampings,
            chord_steps=self.chord_steps,
        )
        full, coloured = windows.full_error(step.theta)
        slow = jnp.where(step.left > 0.81, state.slow + 1, 0)
        done = (full < self.target) | (slow >= self.patience)
        state = _State(step.damping, slow, full, step.promised, coloured, done)
        return unravel(step.theta), state

    def finish(self, loss, params, state):
        return params

    def is_done(self, state):
        return state.done

    def outcome(self, state):
        exact = state.full < jnp.maximum(self.target, self.converged)
        spent = state.promised < NEGLIGIBLE
        noise = spent & ~state.coloured
        ended = jnp.where(spent, Outcome.MISFIT, Outcome.STALLED)
        return jnp.where(exact | noise, Outcome.CONVERGED, ended)


NEGLIGIBLE = 1e-3
"""Share of the squares that a linear step promises to save, below which none counts."""


class _State(eqx.Module):
    """Where a phase stands.

    Attributes:
        damping: of the step taken last.
        slow: slow steps in a row.
        full: root-mean-square residual of the full rollout.
        promised: share of the squares that the linear model promised to save.
        coloured: whether neighbouring residuals of the full rollout are alike.
        done: whether the phase has ended.
    """

    damping: Float[Array, ""]
    slow: Int[Array, ""]
    full: Float[Array, ""]
    promised: Float[Array, ""]
    coloured: Bool[Array, ""]
    done: Bool[Array, ""]


class DampedStep(eqx.Module):
    """Where the best of several damped steps leads.

    Attributes:
        theta: the parameters; those before where no step lowers the squares.
        damping: of that step, or of the next one to try.
        left: share of the sum of squares that is left.
        promised: share of the squares that the linear model promised to save.
    """

    theta: Float[Array, " parameter"]
    damping: Float[Array, ""]
    left: Float[Array, ""]
    promised: Float[Array, ""]


def damped_step(
    residuals: Callable[[Float[Array, " parameter"]], Float[Array, " residual"]],
    theta: Float[Array, " parameter"],
    linear: tuple[Float[Array, " residual"], Float[Array, "residual parameter"]],
    damping: Float[Array, ""],
    *,
    rank: int,
    num_dampings: int,
    chord_steps: int,
) -> DampedStep:
    """The best of several damped Gauss-Newton steps with chord iterations.

    Args:
        residuals: as a function of the parameters.
        theta: the parameters.
        linear: the residuals there, and their Jacobian.
        damping: of the last step.
        rank: of the random projection.
        num_dampings: tried at once, a factor of ten apart.
        chord_steps: iterations with the Jacobian held.
    """
    residual, jacobian = linear
    left, scale, right = low_rank(jacobian, rank)
    exponents = jnp.arange(num_dampings) - (num_dampings - 2)
    dampings = damping * 10.0 ** exponents.astype(theta.dtype)

    def attempt(damping):
        def newton(current, z):
            gradient = scale * (left.T @ current) + damping * z
            return z - gradient / (scale**2 + damping)

        return chord(
            lambda z: residuals(theta + right @ z),
            residual,
            jnp.zeros_like(scale),
            newton,
            chord_steps + 1,
        )

    moves, costs = jax.vmap(attempt)(dampings)
    best, cost = jnp.argmin(costs), residual @ residual
    lower = costs[best] < cost
    return DampedStep(
        theta=jnp.where(lower, theta + right @ moves[best], theta),
        damping=jnp.where(lower, dampings[best], 100.0 * damping),
        left=costs[best] / cost,
        promised=_predicted_decrease(residual, left, scale, dampings[0]) / cost,
    )


def low_rank(jacobian, rank):
    """U, S, V of a random projection of the row space; exact up to its rank."""
    rows, columns = jacobian.shape
    if columns <= rank:
        basis = jnp.eye(columns, dtype=jacobian.dtype)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (rank, rows))
        basis = _orthonormal((jnp.asarray(signs, jacobian.dtype) @ jacobian).T)
    left, triangle = jnp.linalg.qr(jacobian @ basis)
    inner, scale, outer = jnp.linalg.svd(triangle)
    return left @ inner, scale, basis @ outer.T


def _orthonormal(columns):
    """Orthonormal basis by two rounds of the Gram matrix: quicker than a QR here."""
    for floor in (1e-11, 1e-15):
        values, vectors = jnp.linalg.eigh(columns.T @ columns)
        lengths = jnp.sqrt(jnp.maximum(values, floor * values[-1]))
        columns = columns @ vectors / lengths[None]
    return columns


def _predicted_decrease(residual, left, scale, damping):
    """By how much the linear model says that a damped step lowers the squares."""
    along = left.T @ residual
    kept = damping / (scale**2 + damping)
    return along @ along - (kept * along) @ (kept * along)


def chord(residuals, residual, zero, newton, num_steps):
    """Best of several steps with the Jacobian held, and its sum of squares.

    Args:
        residuals: as a function of the coordinates of the step.
        residual: their values at no step.
        zero: the coordinates of no step.
        newton: the next coordinates, from the residuals and the coordinates.
        num_steps: number of steps.
    """

    def iterate(state, _):
        z, current, best, lowest = state
        z = newton(current, z)
        current = residuals(z)
        cost = current @ current
        lower = cost < lowest
        best, lowest = jnp.where(lower, z, best), jnp.where(lower, cost, lowest)
        return (z, current, best, lowest), None

    start = (zero, residual, zero, jnp.asarray(jnp.inf, zero.dtype))
    (_, _, best, lowest), _ = jax.lax.scan(iterate, start, length=num_steps)
    return best, lowest
