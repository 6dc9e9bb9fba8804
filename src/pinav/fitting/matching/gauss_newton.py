r"""Gauss-Newton on trajectory residuals, from one-step matching to the full rollout.

Rollouts restart from the data every `window` samples; one sample is one-step
matching, all of them the full rollout. All steps are linearised at once, and the
Jacobian of the residuals follows by $J_{k+1} = A_k J_k + B_k$, with J set to zero
where the rollout restarts. The Jacobian of a trained network has a numerical rank of
some tens, so one random projection captures it, and any damping costs nothing more.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.fitting.matching.phases import AbstractPhase, Loss
from pinav.fitting.matching.windows import Windows
from pinav.fitting.outcome import Outcome


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


class DampedState(eqx.Module):
    """Where a phase of damped steps stands.

    Attributes:
        slow: steps in a row that gained little.
        value: the loss that the phase reports.
        coloured: whether neighbouring residuals of the full rollout are alike.
        exact: whether the full rollout is good enough.
    """

    damping: Float[Array, ""]
    slow: Int[Array, ""]
    value: Float[Array, ""]
    promised: Float[Array, ""]
    coloured: Bool[Array, ""]
    exact: Bool[Array, ""]
    done: Bool[Array, ""]

    @classmethod
    def begin(cls, damping: Float[Array, ""], value: Float[Array, ""]) -> "DampedState":
        """Before the first step."""
        none, yes = jnp.zeros((), int), jnp.ones((), bool)
        damping = damping.astype(value.dtype)
        return cls(damping, none, value, jnp.ones_like(value), yes, ~yes, ~yes)


class AbstractDampedPhase(AbstractPhase):
    """A phase whose steps are damped, and which no longer moves once it has ended."""

    @abc.abstractmethod
    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        """Parameters and state after a step of a phase that has not ended."""

    @property
    def side_by_side(self) -> bool:
        return False

    def step(
        self, loss: Loss, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState, Float[Array, ""]]:
        return jax.lax.cond(
            state.done,
            lambda: (params, state, state.value),
            lambda: (*self.take_step(loss, params, state), state.value),
        )

    def finish(self, loss: Loss, params: PyTree, state: DampedState) -> PyTree:
        return params

    def is_done(self, state: DampedState) -> Bool[Array, ""]:
        return state.done


class AbstractRolloutPhase(AbstractDampedPhase):
    """Damped steps towards the data, which the full rollout judges.

    The phase is done when the full rollout is good enough (`target`), when `patience`
    steps in a row gained less than a tenth, or when nothing lower is found.

    Attributes:
        window: samples between two restarts; an array, so that phases which differ
            in it alone share one compilation.
        target: root-mean-square residual of the full rollout at which the phase ends.
        damping: of the first step.
        patience: slow steps in a row after which it ends.
        converged: residual of the full rollout below which a fit that ended counts as
            converged, whatever ended it.
        linearisation: solver of the Jacobian and of the trial points. It may be
            cruder than that of the objective, which decides where the solution is.
    """

    window: eqx.AbstractVar[Int[Array, ""]]
    target: eqx.AbstractVar[Float[Array, ""]]
    damping: eqx.AbstractVar[Float[Array, ""]]
    patience: eqx.AbstractVar[Int[Array, ""]]
    converged: eqx.AbstractVar[Float[Array, ""]]
    steps: eqx.AbstractVar[int]
    linearisation: eqx.AbstractVar[FixedStep]

    @abc.abstractmethod
    def best_step(
        self, windows: Windows, theta: Float[Array, " parameter"], state: DampedState
    ) -> DampedStep:
        """The best of several steps from these parameters."""

    @property
    def num_steps(self) -> int:
        return self.steps

    @property
    def chunk_steps(self) -> int:
        return 1

    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> DampedState:
        return DampedState.begin(self.damping, value)

    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        theta, unravel = ravel_pytree(params)
        windows = Windows.of(problem, params, self.window, self.linearisation)
        step = self.best_step(windows, theta, state)
        # Windows flatter: the phase is judged by rollouts of the whole length.
        full, coloured = windows.full_error(step.theta)
        slow = jnp.where(step.left > SLOW, state.slow + 1, 0)
        state = DampedState(
            damping=step.damping,
            slow=slow,
            value=windows.count * full**2,
            promised=step.promised,
            coloured=coloured,
            exact=full < jnp.maximum(self.target, self.converged),
            done=(full < self.target) | (slow >= self.patience),
        )
        return unravel(step.theta), state

    def outcome(self, state: DampedState) -> Int[Array, ""]:
        spent = state.promised < NEGLIGIBLE
        noise = spent & ~state.coloured
        ended = jnp.where(spent, Outcome.MISFIT, Outcome.STALLED)
        return jnp.where(state.exact | noise, Outcome.CONVERGED, ended)


SLOW = 0.81
"""Share of the squares that a slow step leaves: a tenth less residual."""

NEGLIGIBLE = 1e-3
"""Share of the squares that a linear step promises to save, below which none counts."""


class GaussNewton(AbstractRolloutPhase):
    r"""Damped Gauss-Newton steps on rollouts of `window` samples.

    Each step factors the Jacobian as $J \approx U S V^\top$ of rank `rank`, tries
    several dampings at once and, for each, iterates
    $z \leftarrow z - (S^2 + \lambda)^{-1} (S U^\top r(\theta + V z) + \lambda z)$
    with the true residuals r and the Jacobian held (chord steps), which follows the
    curvature of the network far beyond the linear model. The best point wins.

    Attributes:
        rank: columns of the random projection.
        chord_steps: inner iterations with the Jacobian held.
        num_dampings: dampings tried per step, a factor of ten apart.

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
    damping: Float[Array, ""] = eqx.field(
        converter=lambda x: jnp.asarray(x, float), default=1e-2
    )
    steps: int = eqx.field(static=True, default=20)
    rank: int = eqx.field(static=True, default=64)
    chord_steps: int = eqx.field(static=True, default=5)
    num_dampings: int = eqx.field(static=True, default=5)
    linearisation: FixedStep = FixedStep()

    def __check_init__(self) -> None:
        for name in ("steps", "rank", "chord_steps", "num_dampings"):
            if getattr(self, name) < 1:
                raise InputError(
                    f"GaussNewton.{name}: expected 1 or more, got {getattr(self, name)}"
                )

    @property
    def name(self) -> str:
        return f"L = {int(self.window)}"

    def best_step(
        self, windows: Windows, theta: Float[Array, " parameter"], state: DampedState
    ) -> DampedStep:
        starts, residual, surrogate = windows.surrogate(theta)
        return damped_step(
            surrogate,
            theta,
            (residual, windows.jacobian(theta, starts)),
            state.damping,
            rank=self.rank,
            num_dampings=self.num_dampings,
            chord_steps=self.chord_steps,
        )


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
        linear: the residuals there, and their Jacobian.
        rank: of the random projection.
        num_dampings: tried at once, a factor of ten apart.
    """
    residual, jacobian = linear
    left, scale, right = low_rank(jacobian, rank)
    # All smaller but the last two: a step that works is followed by a bolder one.
    exponents = jnp.arange(num_dampings) - (num_dampings - 2)
    dampings = damping * 10.0 ** exponents.astype(theta.dtype)

    def attempt(
        damping: Float[Array, ""],
    ) -> tuple[Float[Array, " direction"], Float[Array, ""]]:
        def newton(
            current: Float[Array, " residual"], z: Float[Array, " direction"]
        ) -> Float[Array, " direction"]:
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
        # Where no damping lowers the cost all were too small.
        damping=jnp.where(lower, dampings[best], 100.0 * damping),
        left=costs[best] / cost,
        promised=_predicted_decrease(residual, left, scale, dampings[0]) / cost,
    )


def low_rank(
    jacobian: Float[Array, "residual parameter"], rank: int
) -> tuple[
    Float[Array, "residual direction"],
    Float[Array, " direction"],
    Float[Array, "parameter direction"],
]:
    """U, S, V of a random projection of the row space; exact up to its rank."""
    basis = row_space(jacobian, rank)
    left, triangle = jnp.linalg.qr(jacobian @ basis)
    inner, scale, outer = jnp.linalg.svd(triangle)
    return left @ inner, scale, basis @ outer.T


def row_space(
    jacobian: Float[Array, "residual parameter"], rank: int
) -> Float[Array, "parameter direction"]:
    """Orthonormal directions of the parameters that matter, `rank` of them at most."""
    rows, columns = jacobian.shape
    if columns <= rank:
        return jnp.eye(columns, dtype=jacobian.dtype)
    # A random projection of the rows finds the directions that matter without the
    # decomposition of the whole Jacobian.
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (rank, rows))
    return _orthonormal((jnp.asarray(signs, jacobian.dtype) @ jacobian).T)


def _orthonormal(
    columns: Float[Array, "row column"],
) -> Float[Array, "row column"]:
    """Orthonormal basis by two rounds of the Gram matrix: quicker than a QR here."""
    # Twice: the first pass leaves what the rounding of a Gram matrix hides.
    for floor in (1e-11, 1e-15):
        values, vectors = jnp.linalg.eigh(columns.T @ columns)
        lengths = jnp.sqrt(jnp.maximum(values, floor * values[-1]))
        columns = columns @ vectors / lengths[None]
    return columns


def _predicted_decrease(
    residual: Float[Array, " residual"],
    left: Float[Array, "residual direction"],
    scale: Float[Array, " direction"],
    damping: Float[Array, ""],
) -> Float[Array, ""]:
    """By how much the linear model says that a damped step lowers the squares."""
    along = left.T @ residual
    # The share of the residual along each direction that a damped step leaves.
    kept = damping / (scale**2 + damping)
    return along @ along - (kept * along) @ (kept * along)


def chord(
    residuals: Callable[[Float[Array, " direction"]], Float[Array, " residual"]],
    residual: Float[Array, " residual"],
    zero: Float[Array, " direction"],
    newton: Callable[
        [Float[Array, " residual"], Float[Array, " direction"]],
        Float[Array, " direction"],
    ],
    num_steps: int,
) -> tuple[Float[Array, " direction"], Float[Array, ""]]:
    """Best of several steps with the Jacobian held, and its sum of squares.

    Args:
        residual: their values at no step.
        zero: the coordinates of no step.
        newton: the next coordinates, from the residuals and the coordinates.
    """

    def iterate(state: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], None]:
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
