r"""Gauss-Newton on the errors of rollouts, and regression on rates of change.

Where every state is observed without noise, the data themselves are the rollout of the
model that is sought. The defect $d_k$ of a model is where its step leads from one
sample, less the next sample, and $e_{k+1} = A_k e_k + d_k$ is the error of its rollout
to first order. It vanishes with the defects, so that minimising it needs no rollout,
which could diverge; all steps are computed at once.

References:
    Bock, multiple shooting with the states from the data; Levenberg 1944.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Float, Int, PyTree

from pinav.dynamics import RK4, FixedStep
from pinav.errors import InputError
from pinav.fitting.matching.gauss_newton import (
    AbstractDampedPhase,
    AbstractRolloutPhase,
    DampedState,
    DampedStep,
    chord,
)
from pinav.fitting.matching.phases import Loss
from pinav.fitting.matching.windows import Windows
from pinav.fitting.outcome import Outcome


class DefectMatching(AbstractRolloutPhase):
    r"""Damped Gauss-Newton steps on propagated defects, with the whole Jacobian.

    Errors begin anew at zero where a window begins.

    Attributes:
        samples: the (trajectory, step) whose errors count; all unless given. A few
            hundred tell what a network can represent.
        prior_root: $C$ with $C C^\top$ the prior covariance of the parameters; steps
            are then damped in units of the prior, so that what the data do not
            determine stays as smooth as the prior says.
        least_damping: below which no step is damped, the square of the residuals'
            numerical error where there is a prior.

    Raises:
        InputError: `steps` is not positive.
    """

    window: Int[Array, ""] = eqx.field(converter=jnp.asarray)
    target: Float[Array, ""] = eqx.field(converter=lambda x: jnp.asarray(x, float))
    samples: Int[Array, "sample 2"] | None = None
    prior_root: Float[Array, "parameter direction"] | None = None
    least_damping: Float[Array, ""] = eqx.field(
        converter=lambda x: jnp.asarray(x, float), default=0.0
    )
    damping: Float[Array, ""] = eqx.field(
        converter=lambda x: jnp.asarray(x, float), default=1e-2
    )
    patience: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=3)
    converged: Float[Array, ""] = eqx.field(
        converter=lambda x: jnp.asarray(x, float), default=0.0
    )
    steps: int = eqx.field(static=True, default=20)
    linearisation: FixedStep = FixedStep(RK4)

    def __check_init__(self) -> None:
        if self.steps < 1:
            raise InputError(f"DefectMatching.steps: expected >= 1, got {self.steps}")

    @property
    def name(self) -> str:
        return f"Defects, L = {int(self.window)}"

    def best_step(
        self, windows: Windows, theta: Float[Array, " parameter"], state: DampedState
    ) -> DampedStep:
        errors = windows.propagated_defects(theta)
        starts = windows.problem.observations.states[:, :-1]
        jacobian = self._rows_that_count(windows, windows.jacobian(theta, starts))

        def residuals(theta: Float[Array, " parameter"]) -> Float[Array, " row"]:
            return self._rows_that_count(windows, errors(theta))

        damping = jnp.maximum(state.damping, self.least_damping / DAMPINGS[0])
        root = self.prior_root
        if root is None or root.shape[0] != theta.shape[0]:  # or constants train, too
            return full_step(residuals, theta, (residuals(theta), jacobian), damping)

        def move(z: Float[Array, " direction"]) -> Float[Array, " parameter"]:
            return theta + root @ z

        step = full_step(
            lambda z: residuals(move(z)),
            jnp.zeros(root.shape[1], theta.dtype),
            (residuals(theta), jacobian @ root),
            damping,
        )
        return dataclasses.replace(step, theta=move(step.theta))

    def _rows_that_count(
        self, windows: Windows, rows: Float[Array, "residual ..."]
    ) -> Float[Array, "row ..."]:
        """The rows of the samples that count."""
        if self.samples is None:
            return rows
        data = windows.problem.observations.states[:, 1:]
        each = rows.reshape(*data.shape, *rows.shape[1:])
        return each[tuple(self.samples.T)].reshape(-1, *rows.shape[1:])


DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""Dampings that are tried at once, in units of that of the last step."""

CHORD_STEPS = 3
"""Iterations with the Jacobian held."""

ROUNDING = 1e-15
"""Least damping, in units of the trace of the normal matrix."""


def full_step(
    residuals: Callable[[Float[Array, " parameter"]], Float[Array, " residual"]],
    theta: Float[Array, " parameter"],
    linear: tuple[Float[Array, " residual"], Float[Array, "residual parameter"]],
    damping: Float[Array, ""],
) -> DampedStep:
    """The best of several damped steps with the whole Jacobian and chord iterations.

    A projection loses what it does not hold: with the same few directions in each step
    the residual outside them stays. The normal matrix is that of the rows where they
    are fewer than the parameters.
    """
    residual, jacobian = linear
    # The smaller of both normal matrices gives the same step.
    tall = jacobian.shape[0] >= jacobian.shape[1]
    normal = jacobian.T @ jacobian if tall else jacobian @ jacobian.T
    dampings = damping * jnp.asarray(DAMPINGS, theta.dtype)
    # Below its rounding the normal matrix may be indefinite.
    dampings = jnp.maximum(dampings, ROUNDING * jnp.trace(normal))

    def pull_back(residual: Float[Array, " residual"]) -> Float[Array, " unknown"]:
        return jacobian.T @ residual if tall else residual

    def move(z: Float[Array, " unknown"]) -> Float[Array, " parameter"]:
        return z if tall else jacobian.T @ z

    def attempt(
        damping: Float[Array, ""],
    ) -> tuple[Float[Array, " parameter"], Float[Array, ""], Float[Array, ""]]:
        # Only the lower triangle is read: to symmetrise it first costs a fifth more.
        damped = normal + damping * jnp.eye(normal.shape[0])
        factor = jax.lax.linalg.cholesky(damped, symmetrize_input=False)

        def newton(
            current: Float[Array, " residual"], z: Float[Array, " unknown"]
        ) -> Float[Array, " unknown"]:
            gradient = pull_back(current) + damping * z
            return z - jax.scipy.linalg.cho_solve((factor, True), gradient)

        best, lowest = chord(
            lambda z: residuals(theta + move(z)),
            residual,
            jnp.zeros(normal.shape[0], theta.dtype),
            newton,
            CHORD_STEPS,
        )
        along = jax.scipy.linalg.cho_solve((factor, True), pull_back(residual))
        across = pull_back(residual) if tall else normal @ residual
        return move(best), lowest, across @ along

    # One after the other: LAPACK's batched solves wait for threads of the very pool
    # they run on, and on few cores never end.
    moves, costs, gains = jax.lax.map(attempt, dampings)
    best, cost = jnp.argmin(costs), residual @ residual
    lower = costs[best] < cost
    return DampedStep(
        theta=jnp.where(lower, theta + moves[best], theta),
        damping=jnp.where(lower, dampings[best], 100.0 * damping),
        left=jnp.where(lower, costs[best] / cost, 1.0),
        promised=gains[0] / cost,
    )


class Rates(eqx.Module):
    """Rates of change of states.

    Attributes:
        rates: of change of the last channels; of a swimmer's velocity alone.
        doubts: estimated error of all rates of a state, where it is known.
    """

    times: Float[np.ndarray, " point"]
    states: Float[np.ndarray, "point state"]
    rates: Float[np.ndarray, "point channel"]
    doubts: Float[np.ndarray, " point"] | None = None


def _on_device(rates: Rates) -> Rates:
    return jax.tree.map(jnp.asarray, rates)


class RateMatching(AbstractDampedPhase):
    """Damped Gauss-Newton steps on rates of change, which need no rollout.

    Rollouts of a random network depart from the data after a few samples. Its rates
    at observed states are functions of the parameters alone, without a solver, and
    steps with the whole Jacobian learn them to some millionths.

    Attributes:
        patience: steps in a row that gain less than a tenth, after which it ends.

    Raises:
        InputError: `steps` is not positive.
    """

    targets: Rates = eqx.field(converter=_on_device)
    steps: int = eqx.field(static=True, default=40)
    patience: int = eqx.field(static=True, default=3)

    def __check_init__(self) -> None:
        if self.steps < 1:
            raise InputError(f"RateMatching.steps: expected >= 1, got {self.steps}")

    @property
    def name(self) -> str:
        return "Rates"

    @property
    def num_steps(self) -> int:
        return self.steps

    @property
    def chunk_steps(self) -> int:
        return 5

    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> DampedState:
        damping = jnp.asarray(DAMPING, value.dtype)
        return DampedState.begin(damping, value)

    def outcome(self, state: DampedState) -> Int[Array, ""]:
        return jnp.asarray(Outcome.COMPLETED)

    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        theta, unravel = ravel_pytree(params)

        targets = self.targets.rates
        size = jnp.sqrt(jnp.mean(targets**2, axis=0))
        size = jnp.where(size > 0, size, 1.0)

        def rate(
            theta: Float[Array, " parameter"], t: ArrayLike, y: ArrayLike
        ) -> Float[Array, " channel"]:
            rates = problem.model(unravel(theta))(t, y)
            return rates[-targets.shape[1] :] / size

        def residuals(theta: Float[Array, " parameter"]) -> Float[Array, " residual"]:
            computed = jax.vmap(rate, (None, 0, 0))(
                theta, self.targets.times, self.targets.states
            )
            return (computed - targets / size[None]).reshape(-1)

        jacobian = jax.vmap(jax.jacrev(rate), (None, 0, 0))(
            theta, self.targets.times, self.targets.states
        ).reshape(-1, theta.shape[0])
        step = full_step(residuals, theta, (residuals(theta), jacobian), state.damping)
        slow = jnp.where(step.left < SLOW_RATES, 0, state.slow + 1)
        error = jnp.sqrt(jnp.mean(residuals(step.theta) ** 2))
        done = (slow >= self.patience) | (error < MATCHED)
        after = (step.damping, slow, done)
        state = eqx.tree_at(lambda s: (s.damping, s.slow, s.done), state, after)
        return unravel(step.theta), state


DAMPING = 1e3
"""Of the first step: with less, a third of the networks saturate and learn no more."""

SLOW_RATES = 0.95
"""Share of the squares that a slow step leaves: steps are cheap, and networks that see
the whole state gain a few per cent for twenty steps before they gain the rest."""

MATCHED = 1e-6
"""Relative error of the rates that needs no further step: splines are less exact."""
