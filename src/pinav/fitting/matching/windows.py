"""Rollouts in windows as functions of the flat parameters, and their derivatives."""

import functools
import operator
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from pinav.arguments import Scalar, State
from pinav.dynamics import FixedStep
from pinav.errors import InputError

Ends = Float[Array, "trajectory step state"]
"""States before or after each step."""

BATCH = 4
"""Trajectories whose steps are linearised at once."""


COLOURED = 0.5
"""Correlation of neighbouring residuals above which they are no noise."""


class Windows(eqx.Module):
    """Windowed rollouts of a model as a function of its flat parameters."""

    problem: Any
    solver: FixedStep
    restart: Bool[Array, "trajectory step"]
    unravel: Any = eqx.field(static=True)

    @classmethod
    def of(
        cls, problem: Any, params: PyTree, window: Int[Array, ""], solver: FixedStep
    ) -> "Windows":
        if not isinstance(problem.objective.solver, FixedStep):
            raise InputError(
                "GaussNewton: expected an objective with a FixedStep solver, got "
                f"{type(problem.objective.solver).__name__}; pass "
                "TrajectoryLoss(FixedStep())"
            )
        observed = problem.observations.observed
        index = jnp.arange(observed.shape[1] - 1)
        # A window can begin only where the whole state was observed.
        known = jnp.all(observed[:, :-1], axis=-1)
        restart = known & ((index % window) == 0)[None]
        return cls(problem, solver, restart, ravel_pytree(params)[1])

    @property
    def count(self) -> Float[Array, ""]:
        """Number of observed entries, in the precision of the fit."""
        data = self.problem.observations
        return jnp.sum(data.observed, dtype=data.states.dtype)

    def rollouts(
        self,
        theta: Float[Array, " parameter"],
        solver: FixedStep,
        restart: Bool[Array, "trajectory step"],
    ) -> tuple[Ends, Ends]:
        """State before and after each step, from the data wherever it restarts."""
        model = self.problem.model(self.unravel(theta))

        def one(
            times: Float[Array, " time"],
            states: Float[Array, "time state"],
            restart: Bool[Array, " step"],
        ) -> tuple[Float[Array, "step state"], Float[Array, "step state"]]:
            def record(y: State, inputs: tuple[Array, ...]) -> tuple[State, Any]:
                t0, t1, state, again = inputs
                start = jnp.where(again, state, y)
                end = solver.looped_step(model, start, t0, t1)
                return end, (start, end)

            inputs = (times[:-1], times[1:], states[:-1], restart)
            return jax.lax.scan(record, states[0], inputs)[1]

        data = self.problem.observations
        return jax.vmap(one)(data.times, data.states, restart)

    def surrogate(
        self, theta: Float[Array, " parameter"]
    ) -> tuple[
        Ends,
        Float[Array, " residual"],
        Callable[[Float[Array, " parameter"]], Float[Array, " residual"]],
    ]:
        """Start of each step, residuals there, and a cheap function for them nearby.

        The residuals are those of the objective's solver. Nearby, the solver of the
        linearisation gives the change, which leaves the solution where it is (defect
        correction).
        """
        starts, ends = self.rollouts(theta, self.problem.objective.solver, self.restart)
        # The cheap solver is off by its own error, which hardly changes over a step.
        correction = ends - self.rollouts(theta, self.solver, self.restart)[1]

        def residuals(theta: Float[Array, " parameter"]) -> Float[Array, " residual"]:
            nearby = self.rollouts(theta, self.solver, self.restart)[1]
            return self._differences(nearby + correction).reshape(-1)

        return starts, self._differences(ends).reshape(-1), residuals

    def full_error(
        self, theta: Float[Array, " parameter"]
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Root-mean-square residual without restarts; whether neighbours are alike."""
        nowhere = jnp.zeros_like(self.restart)
        _, ends = self.rollouts(theta, self.problem.objective.solver, nowhere)
        residuals = self._differences(ends)
        squares = jnp.sum(residuals**2)
        # Errors of a model are alike from sample to sample, white noise is not.
        neighbours = jnp.sum(residuals[:, 1:] * residuals[:, :-1])
        return jnp.sqrt(squares / self.count), neighbours > COLOURED * squares

    def jacobian(
        self, theta: Float[Array, " parameter"], starts: Ends
    ) -> Float[Array, "residual parameter"]:
        """Derivative of the residuals, by all local sensitivities at once."""

        def step(
            both: tuple[Float[Array, " parameter"], State], t0: Scalar, t1: Scalar
        ) -> State:
            theta, y = both
            return self.solver.step(self.problem.model(self.unravel(theta)), y, t0, t1)

        def local(y: State, t0: Scalar, t1: Scalar) -> Any:
            return jax.jacrev(step)((theta, y), t0, t1)  # both from the same sweep

        def one(inputs: tuple[Array, ...]) -> Float[Array, "step state parameter"]:
            times, starts, restart, observed = inputs
            sources, matrices = jax.vmap(local)(starts, times[:-1], times[1:])
            # A restart forgets what came before it.
            matrices = jnp.where(restart[:, None, None], 0.0, matrices)
            rows = _sensitivities(matrices, sources)
            return jnp.where(observed[1:, :, None], rows, 0.0)

        # A few trajectories at a time: the sources of all would need as much memory
        # as the Jacobian itself, and more time than they cost in turns.
        data = self.problem.observations
        each = data.times, starts, self.restart, data.observed
        rows = jax.lax.map(one, each, batch_size=BATCH)
        return rows.reshape(-1, theta.shape[0])

    def propagated_defects(
        self, theta: Float[Array, " parameter"]
    ) -> Callable[[Float[Array, " parameter"]], Float[Array, " residual"]]:
        """Errors of rollouts to first order, linearised about the data.

        The defect of a step is where it leads from one sample, less the next sample;
        $e_{k+1} = A_k e_k + d_k$, from zero wherever the rollout restarts. The
        matrices are those of `theta`, the defects those of the parameters asked for.
        """
        data = self.problem.observations
        inputs = data.states[:, :-1], data.times[:, :-1], data.times[:, 1:]

        def of_all(function: Callable[..., Array]) -> Array:
            return jax.vmap(jax.vmap(function))(*inputs)

        def matrix(y: State, t0: Scalar, t1: Scalar) -> Float[Array, "state state"]:
            model = self.problem.model(self.unravel(theta))
            return jax.jacfwd(lambda y: self.solver.step(model, y, t0, t1))(y)

        matrices = jnp.where(self.restart[..., None, None], 0.0, of_all(matrix))

        def errors(theta: Float[Array, " parameter"]) -> Float[Array, " residual"]:
            model = self.problem.model(self.unravel(theta))
            step = self.problem.objective.solver.looped_step
            defects = self._differences(of_all(lambda *at: step(model, *at)))
            rows = jax.vmap(_sensitivities)(matrices, defects[..., None])[..., 0]
            return jnp.where(data.observed[:, 1:], rows, 0.0).reshape(-1)

        return errors

    def _differences(self, ends: Ends) -> Ends:
        data = self.problem.observations
        return jnp.where(data.observed[:, 1:], ends - data.states[:, 1:], 0.0)


def _sensitivities(
    matrices: Float[Array, "step state state"],
    sources: Float[Array, "step state column"],
) -> Float[Array, "step state column"]:
    """J[k+1] = A[k] J[k] + B[k] from zero, rows as sums of scaled rows."""

    def advance(
        before: Float[Array, "state column"], inputs: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        matrix, source = inputs
        rows = (matrix[:, i, None] * before[i][None] for i in range(before.shape[0]))
        after = functools.reduce(operator.add, rows, source)
        return after, after

    return jax.lax.scan(advance, jnp.zeros_like(sources[0]), (matrices, sources))[1]
