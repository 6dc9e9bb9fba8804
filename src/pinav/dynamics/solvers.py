"""Solvers as values: how y' = f(t, y) is integrated and how its gradient is taken.

| solver | forward | gradient |
|---|---|---|
| `FixedStep` | one explicit Runge-Kutta step per sample | discretise, then optimise |
| `Adaptive` | diffrax at a tolerance | that of its diffrax adjoint |
| `ForwardOnly` | the steps of `Adaptive` | none in reverse |
"""

import abc
from collections.abc import Callable
from typing import Any, TypeVar, cast

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from pinav.arguments import Scalar, State, check_positive
from pinav.forces import ScheduledThrust

VectorField = Callable[[Scalar, State], State]
"""Right-hand side f(t, y); a pytree, so that its leaves can be differentiated."""


Times = Float[Array, " time"]
"""Times at which the state is saved [T]."""


Path = tuple[Float[Array, "time state"], Bool[Array, ""]]
"""States at the times, and whether the solver reached the last of them."""


class AbstractSolver(eqx.Module):
    """Integrates a vector field from `ts[0]` and saves the state at every time."""

    @abc.abstractmethod
    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        """States at `ts` [T], and whether the solver reached the last of them.

        It reached the last time also when the states on the way are not finite.
        """


class Adaptive(AbstractSolver):
    """diffrax at a tolerance: for truth, for scoring, and for comparison in fits.

    Attributes:
        rtol: relative tolerance.
        method: diffrax solver.
        adjoint: diffrax adjoint, such as `diffrax.BacksolveAdjoint()`.
        max_steps: steps after which the solver gives up.

    Raises:
        InputError: a tolerance is not positive.
    """

    rtol: float = eqx.field(static=True, default=1e-11)
    atol: float = eqx.field(static=True, default=1e-11)
    method: diffrax.AbstractERK = diffrax.Dopri8()
    adjoint: diffrax.AbstractAdjoint = diffrax.RecursiveCheckpointAdjoint()
    max_steps: int = eqx.field(static=True, default=100_000)

    def __check_init__(self) -> None:
        check_positive(self, "rtol", "atol")

    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        solution = diffrax.diffeqsolve(
            TERM,
            self.method,
            ts[0],
            ts[-1],
            None,
            y0,
            args=vector_field,
            saveat=diffrax.SaveAt(ts=ts),
            stepsize_controller=step_size_controller(self, vector_field),
            adjoint=self.adjoint,
            max_steps=self.max_steps,
            throw=False,
        )
        success = solution.result == diffrax.RESULTS.successful
        return cast(Array, solution.ys), success


TERM = diffrax.ODETerm(lambda t, y, field: field(t, y))  # pyright: ignore
"""A vector field that is given as the argument."""


def step_size_controller(
    solver: Adaptive, vector_field: VectorField
) -> diffrax.AbstractStepSizeController:
    """Of the tolerances; steps end where the thrust of a vector field jumps."""
    controller = diffrax.PIDController(rtol=solver.rtol, atol=solver.atol)
    jumps = jump_times(vector_field)
    if jumps is None:
        return controller
    # A step across a jump is rejected some twenty times before it is short enough.
    return diffrax.ClipStepSizeController(controller, jump_ts=jumps)


def jump_times(model: PyTree) -> Float[Array, " jump"] | None:
    """Times at which the thrust of a model jumps [T]; None where it does not."""

    def is_thrust(part: Any) -> bool:
        return isinstance(part, ScheduledThrust)

    thrusts = filter(is_thrust, jax.tree.leaves(model, is_leaf=is_thrust))
    times = [jax.lax.stop_gradient(thrust.jumps) for thrust in thrusts]
    return jnp.sort(jnp.concatenate(times)) if times else None


Carry = TypeVar("Carry")

Saved = Any
"""States at the times; inside of a loop what equinox puts in their place."""

ROUNDING = 100
"""Last digits of a time by which a step may miss the end."""


class _Progress(eqx.Module):
    """What a step changes; `diffrax.diffeqsolve` keeps the same."""

    t0: Float[Array, ""]
    t1: Float[Array, ""]
    y: State
    solver: PyTree
    controller: PyTree
    made_jump: Array
    num_saved: Array
    num_steps: Array
    ys: Saved


class ForwardOnly(AbstractSolver):
    """The steps of `Adaptive` without what derivatives of them need.

    The compiled program is half as large and is kept on disk: that of
    `diffrax.diffeqsolve` calls back into Python where its times are wrong, and such
    programs are compiled anew in each process. The states are the same up to the
    tolerance.

    Attributes:
        solver: method, tolerances and number of steps; its adjoint is not used.
    """

    solver: Adaptive = Adaptive()

    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        def is_under_way(now: _Progress) -> Array:
            return (now.t0 < ts[-1]) & (now.num_steps < self.solver.max_steps)

        def step(now: _Progress) -> _Progress:
            return self._step(now, vector_field, ts)

        start = self._start(vector_field, y0, ts)
        end = _loop(is_under_way, step, start, lambda now: now.ys)
        return end.ys, end.t0 >= ts[-1]

    @property
    def _method(self) -> diffrax.AbstractERK:
        """The method with its stages in a plain loop."""
        method = self.solver.method
        return eqx.tree_at(
            lambda m: m.scan_kind, method, "lax", is_leaf=lambda leaf: leaf is None
        )

    def _start(self, vector_field: VectorField, y0: State, ts: Times) -> _Progress:
        method = self._method
        controller = step_size_controller(self.solver, vector_field)
        order = cast(int, method.order(TERM))  # None of stochastic methods alone
        t1, state = controller.init(
            TERM, ts[0], ts[-1], y0, None, vector_field, method.func, order
        )
        t1 = jnp.minimum(t1, ts[-1])
        begun = ts <= ts[0]
        return _Progress(
            t0=ts[0],
            t1=t1,
            y=y0,
            solver=method.init(TERM, ts[0], t1, y0, vector_field),
            controller=state,
            made_jump=jnp.zeros((), bool),
            num_saved=begun.sum(),
            num_steps=jnp.zeros((), int),
            ys=jnp.where(begun[:, None], y0, jnp.inf),
        )

    def _step(self, now: _Progress, vector_field: VectorField, ts: Times) -> _Progress:
        """Try a step; where its error is small, save what it passes and go on."""
        method = self._method
        controller = step_size_controller(self.solver, vector_field)
        y, error, dense, solver, _ = method.step(
            TERM, now.t0, now.t1, now.y, vector_field, now.solver, now.made_jump
        )
        error = jnp.where(jnp.isnan(error), jnp.inf, error)
        order = cast(int, method.order(TERM))  # None of stochastic methods alone
        keep, t0, t1, made_jump, state, _ = controller.adapt_step_size(
            now.t0, now.t1, now.y, y, vector_field, error, order, now.controller
        )
        last = ts[-1]
        t0 = jnp.minimum(t0, last)
        almost = last - ROUNDING * jnp.finfo(ts.dtype).eps * jnp.abs(last)
        t1 = jnp.where(t1 > almost, jnp.where(keep, last, (t0 + last) / 2), t1)
        path = method.interpolation_cls(t0=now.t0, t1=now.t1, **dense)

        def is_passed(saved: tuple[Array, Saved]) -> Array:
            index, _ = saved
            return (index < len(ts)) & (ts[index] <= now.t1) & keep

        def save(saved: tuple[Array, Saved]) -> tuple[Array, Saved]:
            index, ys = saved
            return index + 1, ys.at[index].set(path.evaluate(ts[index]))

        before = now.num_saved, now.ys
        num_saved, ys = _loop(is_passed, save, before, lambda saved: saved[1])
        y, solver, made_jump = jax.tree.map(
            lambda new, old: jnp.where(keep, new, old),
            (y, solver, made_jump),
            (now.y, now.solver, now.made_jump),
        )
        return _Progress(
            t0, t1, y, solver, state, made_jump, num_saved, now.num_steps + 1, ys
        )


def _loop(
    condition: Callable[[Carry], Array],
    body: Callable[[Carry], Carry],
    start: Carry,
    saved: Callable[[Carry], Saved],
) -> Carry:
    """A while loop that writes what it saved in place; under `vmap`, too.

    Of a batch in `jax.lax.while_loop`, every turn copies the states of all times.
    """
    return eqxi.while_loop(condition, body, start, buffers=saved, kind="lax")
