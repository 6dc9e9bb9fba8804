r"""Gauss-Newton on the errors of rollouts, linearised about exact data.

Where every state is observed without noise, the data themselves are the rollout of the
model that is sought. The defect $d_k$ of a model is where its step leads from one
sample, less the next sample, and $e_{k+1} = A_k e_k + d_k$ is the error of its rollout
to first order. It vanishes with the defects, so that minimising it needs no rollout,
which could diverge; all steps are computed at once.

References:
    Bock, multiple shooting with the states from the data; Levenberg 1944.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from pinav.dynamics import RK4, FixedStep
from pinav.errors import InputError
from pinav.fitting.matching.damped_phase import AbstractDampedPhase, DampedState
from pinav.fitting.matching.gauss_newton import DampedStep, chord
from pinav.fitting.matching.windows import Windows


class DefectMatching(AbstractDampedPhase):
    """Damped Gauss-Newton steps on propagated defects, with the whole Jacobian.

    Attributes:
        window: samples between two restarts, where the errors begin anew at zero; an
            array, so that phases which differ in it alone share one compilation.
        target: root-mean-square error at which the phase ends.
        damping: of the first step.
        patience: steps in a row that gain less than a twentieth, after which it ends.
        steps: number of steps at most.
        linearisation: solver of the derivatives; that of the objective decides where
            the solution is.

    Raises:
        InputError: `steps` is not positive.
    """

    window: Int[Array, ""] = eqx.field(converter=jnp.asarray)
    target: Float[Array, ""] = eqx.field(converter=lambda x: jnp.asarray(x, float))
    damping: Float[Array, ""] = eqx.field(
        converter=lambda x: jnp.asarray(x, float), default=1e-2
    )
    patience: int = eqx.field(static=True, default=2)
    steps: int = eqx.field(static=True, default=20)
    linearisation: FixedStep = FixedStep(RK4)

    def __check_init__(self):
        if self.steps < 1:
            raise InputError(f"DefectMatching.steps: expected >= 1, got {self.steps}")

    @property
    def name(self):
        return f"Defects, L = {int(self.window)}"

    @property
    def num_steps(self):
        return self.steps

    @property
    def chunk_steps(self):
        return 1

    def init(self, loss, params, value):
        return DampedState.begin(self.damping.astype(value.dtype), value)

    def take_step(self, problem, params, state):
        theta, unravel = ravel_pytree(params)
        windows = Windows.of(problem, params, self.window, self.linearisation)
        errors = windows.propagated_defects(theta)
        residual = errors(theta)
        starts = problem.observations.states[:, :-1]
        linear = residual, windows.jacobian(theta, starts)
        step = full_step(errors, theta, linear, state.damping)
        squares = step.left * (residual @ residual)
        slow = jnp.where(step.left > SLOW, state.slow + 1, 0)
        small = squares < windows.count * self.target**2
        done = small | (slow >= self.patience)
        state = DampedState(step.damping, slow, squares, done)
        return unravel(step.theta), state, residual @ residual


DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""Dampings that are tried at once, in units of that of the last step."""

SLOW = 0.9
"""Share of the squares that a slow step leaves."""

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

    Args:
        residuals: as a function of the parameters.
        theta: the parameters.
        linear: the residuals there, and their Jacobian.
        damping: of the last step.
    """
    residual, jacobian = linear
    tall = jacobian.shape[0] >= jacobian.shape[1]
    normal = jacobian.T @ jacobian if tall else jacobian @ jacobian.T
    dampings = damping * jnp.asarray(DAMPINGS, theta.dtype)
    dampings = jnp.maximum(dampings, ROUNDING * jnp.trace(normal))

    def pull_back(residual):
        return jacobian.T @ residual if tall else residual

    def move(z):
        return z if tall else jacobian.T @ z

    def attempt(damping):
        factor = jnp.linalg.cholesky(normal + damping * jnp.eye(normal.shape[0]))

        def newton(current, z):
            gradient = pull_back(current) + damping * z
            return z - jax.scipy.linalg.cho_solve((factor, True), gradient)

        best, lowest = chord(
            lambda z: residuals(theta + move(z)),
            residual,
            jnp.zeros(normal.shape[0], theta.dtype),
            newton,
            CHORD_STEPS,
        )
        return move(best), lowest

    moves, costs = jax.vmap(attempt)(dampings)
    best, cost = jnp.argmin(costs), residual @ residual
    lower = costs[best] < cost
    return DampedStep(
        theta=jnp.where(lower, theta + moves[best], theta),
        damping=jnp.where(lower, dampings[best], 100.0 * damping),
        left=jnp.where(lower, costs[best] / cost, 1.0),
        promised=jnp.ones((), theta.dtype),
    )
