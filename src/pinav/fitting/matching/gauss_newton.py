r"""Gauss-Newton on trajectory residuals, from one-step matching to the full rollout.

Rollouts restart from the data every `window` samples; one sample is one-step
matching, all of them the full rollout. All steps are linearised at once, and the
Jacobian of the residuals follows by $J_{k+1} = A_k J_k + B_k$, with J set to zero
where the rollout restarts. The Jacobian of a trained network has a numerical rank of
some tens, so one random projection captures it, and any damping costs nothing more.
"""

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
from pinav.fitting.matching.phases import AbstractPhase
from pinav.fitting.outcome import Outcome

BATCH = 4
"""Trajectories whose steps are linearised at once."""


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

    def _take_step(self, windows: "Windows", params, state):
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

COLOURED = 0.5
"""Correlation of neighbouring residuals above which they are no noise."""


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


class Windows(eqx.Module):
    """Windowed rollouts of a model as a function of its flat parameters."""

    problem: Any
    solver: FixedStep
    restart: Bool[Array, "trajectory step"]
    unravel: Any = eqx.field(static=True)

    @classmethod
    def of(
        cls, problem, params: PyTree, window: Int[Array, ""], solver: FixedStep
    ) -> "Windows":
        if not isinstance(problem.objective.solver, FixedStep):
            raise InputError(
                "GaussNewton: expected an objective with a FixedStep solver, got "
                f"{type(problem.objective.solver).__name__}; pass "
                "TrajectoryLoss(FixedStep())"
            )
        observed = problem.observations.observed
        index = jnp.arange(observed.shape[1] - 1)
        known = jnp.all(observed[:, :-1], axis=-1)
        restart = known & ((index % window) == 0)[None]
        return cls(problem, solver, restart, ravel_pytree(params)[1])

    @property
    def count(self) -> Float[Array, ""]:
        """Number of observed entries, in the precision of the fit."""
        data = self.problem.observations
        return jnp.sum(data.observed, dtype=data.states.dtype)

    def rollouts(self, theta, solver, restart):
        """State before and after each step, from the data wherever it restarts."""
        model = self.problem.model(self.unravel(theta))

        def one(times, states, restart):
            def record(y, inputs):
                t0, t1, state, again = inputs
                start = jnp.where(again, state, y)
                end = solver.looped_step(model, start, t0, t1)
                return end, (start, end)

            inputs = (times[:-1], times[1:], states[:-1], restart)
            return jax.lax.scan(record, states[0], inputs)[1]

        data = self.problem.observations
        return jax.vmap(one)(data.times, data.states, restart)

    def surrogate(self, theta):
        """Start of each step, residuals there, and a cheap function for them nearby.

        The residuals are those of the objective's solver. Nearby, the solver of the
        linearisation gives the change, which leaves the solution where it is (defect
        correction).
        """
        starts, ends = self.rollouts(theta, self.problem.objective.solver, self.restart)
        correction = ends - self.rollouts(theta, self.solver, self.restart)[1]

        def residuals(theta):
            nearby = self.rollouts(theta, self.solver, self.restart)[1]
            return self._differences(nearby + correction).reshape(-1)

        return starts, self._differences(ends).reshape(-1), residuals

    def full_error(self, theta) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Root-mean-square residual without restarts; whether neighbours are alike."""
        nowhere = jnp.zeros_like(self.restart)
        _, ends = self.rollouts(theta, self.problem.objective.solver, nowhere)
        residuals = self._differences(ends)
        squares = jnp.sum(residuals**2)
        neighbours = jnp.sum(residuals[:, 1:] * residuals[:, :-1])
        return jnp.sqrt(squares / self.count), neighbours > COLOURED * squares

    def jacobian(self, theta, starts) -> Float[Array, "residual parameter"]:
        """Derivative of the residuals, by all local sensitivities at once."""

        def step(both, t0, t1):
            theta, y = both
            return self.solver.step(self.problem.model(self.unravel(theta)), y, t0, t1)

        def local(y, t0, t1):
            return jax.jacrev(step)((theta, y), t0, t1)  # both from the same sweep

        def one(inputs):
            times, starts, restart, observed = inputs
            sources, matrices = jax.vmap(local)(starts, times[:-1], times[1:])
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

        def of_all(function):
            return jax.vmap(jax.vmap(function))(*inputs)

        def matrix(y, t0, t1):
            model = self.problem.model(self.unravel(theta))
            return jax.jacfwd(lambda y: self.solver.step(model, y, t0, t1))(y)

        matrices = jnp.where(self.restart[..., None, None], 0.0, of_all(matrix))

        def errors(theta):
            model = self.problem.model(self.unravel(theta))
            step = self.problem.objective.solver.looped_step
            defects = self._differences(of_all(lambda *at: step(model, *at)))
            rows = jax.vmap(_sensitivities)(matrices, defects[..., None])[..., 0]
            return jnp.where(data.observed[:, 1:], rows, 0.0).reshape(-1)

        return errors

    def _differences(self, ends):
        data = self.problem.observations
        return jnp.where(data.observed[:, 1:], ends - data.states[:, 1:], 0.0)


def _sensitivities(matrices, sources):
    """J[k+1] = A[k] J[k] + B[k] from zero, rows as sums of scaled rows."""

    def advance(before, inputs):
        matrix, source = inputs
        rows = (matrix[:, i, None] * before[i][None] for i in range(before.shape[0]))
        after = sum(rows, source)
        return after, after

    return jax.lax.scan(advance, jnp.zeros_like(sources[0]), (matrices, sources))[1]


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
        return chord(
            lambda z: residuals(theta + right @ z),
            (residual, left, scale),
            damping,
            chord_steps,
        )

    moves, costs = jax.vmap(attempt)(dampings)
    best, cost = jnp.argmin(costs), residual @ residual
    lower = costs[best] < cost
    return DampedStep(
        theta=jnp.where(lower, theta + right @ moves[best], theta),
        damping=jnp.where(lower, dampings[best], 100.0 * damping),
        left=costs[best] / cost,
        promised=_promised(residual, left, scale, dampings[0]) / cost,
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


def _promised(residual, left, scale, damping):
    """By how much the linear model says that a damped step lowers the squares."""
    along = left.T @ residual
    kept = damping / (scale**2 + damping)
    return along @ along - (kept * along) @ (kept * along)


def chord(residuals, linear, damping, num_steps):
    """Best of several steps with the Jacobian held, and its sum of squares."""
    residual, left, scale = linear

    def iterate(state, _):
        z, current, best, lowest = state
        gradient = scale * (left.T @ current) + damping * z
        z = z - gradient / (scale**2 + damping)
        current = residuals(z)
        cost = current @ current
        lower = cost < lowest
        best, lowest = jnp.where(lower, z, best), jnp.where(lower, cost, lowest)
        return (z, current, best, lowest), None

    zero = jnp.zeros_like(scale)
    start = (zero, residual, zero, jnp.asarray(jnp.inf, scale.dtype))
    (_, _, best, lowest), _ = jax.lax.scan(iterate, start, length=num_steps + 1)
    return best, lowest
