r"""Protocol optimisation: most dose in a target under limits that are kept.

Every quantity is a function of a run and differentiable; SciPy's sequential quadratic
programming gets exact gradients. When heat arrives is a matter of the amplitudes, where
it arrives of the particles: both can be free.
"""

import abc
import enum
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from pinav.errors import FitError, InputError
from pinav.thermal.design_variables import AbstractFreedom, Treated
from pinav.thermal.dose import exceeded_by
from pinav.thermal.exposure_limits import AbstractLimit
from pinav.thermal.quantities import Number
from pinav.thermal.schedule import Timetable, timetable
from pinav.thermal.solve import Solution, State, default_stepper, run
from pinav.thermal.steppers import AbstractStepper

LEAST_DOSE = 1e-9
"""Added [min] to a dose before its logarithm is taken."""


class Outcome(eqx.Module):
    """A run and what it led to.

    Attributes:
        treated: tissue and field.
        solution: temperature and dose.
        hottest: highest temperature [°C] of each interval of the protocol.
    """

    treated: Treated
    solution: Solution
    hottest: Float[Array, " interval"]

    def volumes(self, share: Float[Array, "..."]) -> Float[Array, "..."]:
        """Volume [m³] of a tissue in each cell."""
        return share * self.treated.model.grid.volumes


Quantity = Callable[[Outcome], Float[Array, "..."]]


class LogD90(eqx.Module):
    """Logarithm of the CEM43 [min] that 90 % of a target exceed.

    Attributes:
        target: volume fraction of the target in each cell.
    """

    target: Float[Array, "..."]

    def __call__(self, outcome: Outcome) -> Float[Array, ""]:
        """Its value for a run."""
        dose = outcome.solution.final.dose
        found = exceeded_by(dose, outcome.volumes(self.target), 0.9)
        return jnp.log(found + LEAST_DOSE)


class AbstractConstraint(eqx.Module):
    """A quantity that may not exceed a bound.

    Attributes:
        name: what the result calls it.
        bound: upper bound.
        unit: of quantity and bound.
    """

    name: eqx.AbstractVar[str]
    bound: eqx.AbstractVar[Number]
    unit: eqx.AbstractVar[str]

    @abc.abstractmethod
    def quantity(self, outcome: Outcome) -> Float[Array, "..."]:
        """What is bounded; several numbers are all bounded."""

    def excess(self, outcome: Outcome) -> Float[Array, "..."]:
        """By how much it exceeds, such that a change of one matters."""
        return self.quantity(outcome) - self.bound


class MaxTemperature(AbstractConstraint):
    """No cell is hotter than a bound, in any interval of the protocol.

    Attributes:
        bound: highest temperature [°C].
        name: what the result calls it.
        unit: of the bound.
    """

    bound: Number
    name: str = eqx.field(static=True, default="maximum temperature")
    unit: str = eqx.field(static=True, default="°C")

    def quantity(self, outcome):
        return outcome.hottest


class HealthyDose(AbstractConstraint):
    """No cell of healthy tissue gets more dose than a bound.

    Attributes:
        bound: largest dose [CEM43 min], positive.
        share: volume fraction of the healthy tissue; cells below one half do not count.
        name: what the result calls it.
        unit: of the bound.
    """

    bound: Number
    share: Float[Array, "..."]
    name: str = eqx.field(static=True, default="healthy tissue dose")
    unit: str = eqx.field(static=True, default="min")

    def quantity(self, outcome):
        dose = jnp.where(self.share > 0.5, outcome.solution.final.dose, 0.0)
        return jnp.max(dose)

    def excess(self, outcome):
        # a dose spans many decades; its logarithm is nearly linear in the temperature
        return jnp.log((self.quantity(outcome) + LEAST_DOSE) / self.bound)


class WithinLimit(AbstractConstraint):
    """The field keeps a limit.

    Attributes:
        limit: of the field.
        name: of the limit.
        bound: of the limit.
        unit: of the limit.
        scale: one kelvin, or the bound.
    """

    limit: AbstractLimit
    name: str = eqx.field(static=True)
    bound: Number
    unit: str = eqx.field(static=True)
    scale: Number

    def quantity(self, outcome):
        return self.limit.exposure(outcome.treated.protocol)

    def excess(self, outcome):
        return (self.quantity(outcome) - self.bound) / self.scale


class AtMost(AbstractConstraint):
    """Any quantity of a run.

    Attributes:
        name: what the result calls it.
        function: the quantity.
        bound: upper bound.
        unit: of both.
        scale: change that matters, positive.
    """

    name: str = eqx.field(static=True)
    function: Quantity
    bound: Number
    unit: str = eqx.field(static=True)
    scale: Number = 1.0

    def quantity(self, outcome):
        return self.function(outcome)

    def excess(self, outcome):
        return (self.quantity(outcome) - self.bound) / self.scale


def within(limit: AbstractLimit) -> WithinLimit:
    """The constraint that the field keeps a limit."""
    scale = 1.0 if limit.unit == "°C" else limit.bound
    return WithinLimit(
        limit=limit, name=limit.name, bound=limit.bound, unit=limit.unit, scale=scale
    )


class Kept(eqx.Module):
    """A constraint at the optimum.

    Attributes:
        name: of the constraint.
        value: the largest that it bounds.
        bound: upper bound.
        unit: of both.
        active: whether it stands at its bound, and so decided the result.
    """

    name: str = eqx.field(static=True)
    value: Number
    bound: Number
    unit: str = eqx.field(static=True)
    active: bool = eqx.field(static=True)


class Optimality(enum.IntEnum):
    """How an optimisation ended."""

    CONVERGED = 0
    STALLED = 1


class Optimum(eqx.Module):
    """The best run found.

    Attributes:
        treated: tissue and field.
        solution: temperature and dose.
        value: of what was maximised.
        start_value: of it where the search began.
        kept: the constraints, and which of them are active.
        numbers: of all freedoms, between 0 and 1.
        at_bounds: how many of these stand at 0 or 1.
        evaluations: runs with their gradients.
        outcome: stalled when the iterations ran out on a slope.
    """

    treated: Treated
    solution: Solution
    value: Number
    start_value: Number
    kept: tuple[Kept, ...]
    numbers: Float[np.ndarray, " number"]
    at_bounds: int
    evaluations: int
    outcome: Optimality = eqx.field(static=True)


def optimise(
    treated: Treated,
    freedoms: Sequence[AbstractFreedom],
    *,
    maximise: Quantity,
    subject_to: Sequence[AbstractConstraint],
    stepper: AbstractStepper | None = None,
    max_iterations: int = 60,
    tolerance: Number = 1e-5,
    throw: bool = True,
) -> Optimum:
    """The run of most `maximise` that keeps all constraints.

    Args:
        treated: the run whose freedoms are changed.
        freedoms: what may change.
        maximise: a number of a run, such as `LogD90`.
        subject_to: constraints.
        stepper: as of `solve`.
        max_iterations: of the quadratic programming.
        tolerance: change of the objective at which it ends.
        throw: raise where no run was found that keeps the constraints.

    Raises:
        InputError: nothing is free.
        FitError: the constraints are not kept, and `throw` is true.
    """
    if not freedoms:
        raise InputError("optimise freedoms: expected one or more, got none")
    problem = _Problem.of(
        treated, tuple(freedoms), maximise, tuple(subject_to), stepper
    )
    start = np.concatenate([own.start for own in freedoms])
    memory = _Memory(problem, start)
    numbers, converged = _searched(memory, start, max_iterations, tolerance)
    optimum = _optimum(problem, memory, numbers, converged=converged)
    excess = float(np.max(memory.at(numbers)[0][1:], initial=0.0))
    if throw and excess > VIOLATION:
        names = ", ".join(own.name for own in optimum.kept if own.value > own.bound)
        raise FitError(
            f"no run was found that keeps: {names}; relax it, free more, or start "
            "elsewhere"
        )
    return optimum


VIOLATION, ACTIVE = 0.01, 0.02
"""Excess over a bound that is not accepted, and distance at which it counts as active:
kelvins, or shares of a dose or of a field limit."""

ROUNDS = 3
"""Of quadratic programming, each from the best run so far that keeps all bounds."""


def _searched(memory, start, max_iterations, tolerance):
    """The best numbers found, and whether the last round ended by itself."""
    numbers, converged = start, False
    for _ in range(ROUNDS):
        found = scipy.optimize.minimize(
            lambda x: -memory.at(x)[0][0],
            numbers,
            jac=lambda x: -memory.at(x)[1][0],
            bounds=[(0.0, 1.0)] * len(start),
            constraints=[
                {
                    "type": "ineq",
                    "fun": lambda x: -memory.at(x)[0][1:],
                    "jac": lambda x: -memory.at(x)[1][1:],
                }
            ],
            method="SLSQP",
            options={"maxiter": max_iterations, "ftol": tolerance},
        )
        converged = bool(found.success)
        if memory.best is None:
            numbers = np.clip(found.x, 0.0, 1.0)
            continue
        numbers = memory.best
        if converged:
            break
    return numbers, converged


class _Problem(eqx.Module):
    """Objective and constraints as one vector."""

    treated: Treated
    freedoms: tuple[AbstractFreedom, ...]
    maximise: Quantity
    constraints: tuple[AbstractConstraint, ...]
    stepper: AbstractStepper
    table: Timetable

    @classmethod
    def of(cls, treated, freedoms, maximise, constraints, stepper):
        own = default_stepper(treated.model) if stepper is None else stepper
        longest = own.longest_step(treated.model)
        table = timetable(treated.protocol, longest)
        return cls(treated, freedoms, maximise, constraints, own, table)

    def outcome(self, numbers) -> Outcome:
        treated, place = self.treated, 0
        for freedom in self.freedoms:
            count = len(freedom.start)
            treated = freedom.apply(numbers[place : place + count], treated)
            place += count
        found = run(
            treated.model,
            treated.protocol,
            self.table,
            stepper=self.stepper,
            observe=jnp.max,
            start=State.at_rest(treated.model),
        )
        intervals = jnp.asarray(self.table.intervals)
        count = len(treated.protocol.edges) - 1
        hottest = jax.ops.segment_max(found.hottest, intervals, count)
        return Outcome(treated, found, hottest)

    def values(self, numbers) -> Float[Array, " value"]:
        outcome = self.outcome(numbers)
        parts = [self.maximise(outcome).reshape(1)]
        for own in self.constraints:
            parts.append(own.excess(outcome).reshape(-1))
        return jnp.concatenate(parts)


@eqx.filter_jit
def _forward(problem, numbers):
    """Values and their Jacobian, one tangent for each number."""
    value, push = jax.linearize(problem.values, numbers)
    return value, jax.vmap(push)(jnp.eye(numbers.shape[0])).T


@eqx.filter_jit
def _backward(problem, numbers):
    """Values and their Jacobian, one sweep for each value."""
    value, pull = jax.vjp(problem.values, numbers)
    return value, jax.lax.map(lambda row: pull(row)[0], jnp.eye(value.shape[0]))


class _Memory:
    """The last evaluation, as SciPy asks for value and gradient apart, and the best."""

    def __init__(self, problem: _Problem, start: Float[np.ndarray, " number"]):
        values = eqx.filter_eval_shape(problem.values, jnp.asarray(start)).shape[0]
        self.evaluate = _forward if len(start) <= values else _backward
        self.problem, self.count = problem, 0
        self.place, self.found = None, (np.zeros(0), np.zeros((0, 0)))
        self.best, self.best_value = None, -np.inf

    def at(self, numbers):
        if self.place is None or not np.array_equal(numbers, self.place):
            found = self.evaluate(self.problem, jnp.asarray(numbers))
            self.found = tuple(np.asarray(array) for array in found)
            self.place, self.count = np.array(numbers), self.count + 1
            self._keep(numbers)
        return self.found

    def _keep(self, numbers):
        """The best numbers so far that keep all bounds."""
        value, *excesses = self.found[0]
        if max(excesses, default=-1.0) <= KEPT and value > self.best_value:
            self.best, self.best_value = np.clip(numbers, 0.0, 1.0), value


KEPT = 1e-3
"""Excess that rounding and a finite number of steps leave."""


def _optimum(problem, memory, numbers, *, converged) -> Optimum:
    start = np.concatenate([own.start for own in problem.freedoms])
    start_value = float(memory.at(start)[0][0])
    outcome = eqx.filter_jit(problem.outcome)(jnp.asarray(numbers))
    kept = []
    for own in problem.constraints:
        value = float(jnp.max(own.quantity(outcome)))
        near = abs(float(jnp.max(own.excess(outcome)))) <= ACTIVE
        kept.append(Kept(own.name, value, float(own.bound), own.unit, near))
    at_bounds = int(np.sum((numbers < 1e-6) | (numbers > 1 - 1e-6)))
    return Optimum(
        treated=outcome.treated,
        solution=outcome.solution,
        value=float(problem.maximise(outcome)),
        start_value=start_value,
        kept=tuple(kept),
        numbers=numbers,
        at_bounds=at_bounds,
        evaluations=memory.count,
        outcome=Optimality.CONVERGED if converged else Optimality.STALLED,
    )
