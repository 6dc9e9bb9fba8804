r"""Protocol optimisation: the largest dose in a target under constraints.

Every quantity is a differentiable function of a run; SciPy's sequential quadratic
programming gets exact gradients. The amplitudes decide when heat arrives, the placement
of particles where; both can be design variables.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from pinav.errors import FitError, InputError
from pinav.fitting import Outcome
from pinav.thermal.design import Constraint, DesignVariable, Quantity, Run
from pinav.thermal.protocols import Schedule, plan_steps
from pinav.thermal.quantities import Number
from pinav.thermal.solve import Solution, default_stepper, run
from pinav.thermal.starts import AT_REST, AbstractStart, HeatState
from pinav.thermal.steppers import AbstractStepper, refuse_jumps

VIOLATION, ACTIVE = 0.01, 0.02
"""Excess over a bound that is not accepted, and distance at which a bound is
active: in kelvins, or fractions of a dose or of a field limit."""

FEASIBLE = 1e-3
"""Excess that rounding and a finite number of steps leave."""

ROUNDS = 3
"""Rounds of quadratic programming, each from the best feasible run so far."""


class ConstraintValue(eqx.Module):
    """A constraint at the optimum.

    Attributes:
        value: largest value of the constrained quantity.
        active: whether the quantity is at its bound, and so decides the result.
    """

    name: str = eqx.field(static=True)
    value: Number
    bound: Number
    unit: str = eqx.field(static=True)
    active: bool = eqx.field(static=True)


class Optimum(eqx.Module):
    """Result of `optimise`.

    Attributes:
        value: the maximised quantity.
        start_value: the same at the start.
        numbers: design variables between 0 and 1, all in one row.
        outcome: stalled when the iterations ran out on a slope.
    """

    run: Run
    solution: Solution
    value: Number
    start_value: Number
    constraints: tuple[ConstraintValue, ...]
    numbers: Float[np.ndarray, " number"]
    evaluations: int
    outcome: Outcome = eqx.field(static=True)


def optimise(
    start: Run,
    variables: Sequence[DesignVariable],
    *,
    maximise: Quantity,
    subject_to: Sequence[Constraint],
    stepper: AbstractStepper | None = None,
    begin: AbstractStart = AT_REST,
    initial: Float[np.ndarray, " number"] | None = None,
    max_iterations: int = 60,
    tolerance: Number = 1e-5,
) -> Optimum:
    """Find the run of largest `maximise` that satisfies all constraints.

    Args:
        start: the run that the design variables change.
        maximise: a quantity of a run, such as `log_d90`.
        stepper: as of `solve`.
        begin: where every run begins, as of `solve`; in the middle of the protocol,
            too.
        initial: design variables to start from, such as the `numbers` of a plan for
            similar tissue; those of the variables unless given.
        tolerance: change of the objective at which it ends.

    Raises:
        InputError: there is no design variable, a start for another number of them, or
            a law of perfusion that jumps.
        FitError: the constraints are not satisfied.
    """
    if not variables:
        raise InputError("optimise variables: expected one or more, got none")
    refuse_jumps(start.model)
    stepper = default_stepper(start.model) if stepper is None else stepper
    state = begin.state(start.model)
    problem = _Problem(
        start=start,
        variables=tuple(variables),
        maximise=maximise,
        constraints=tuple(subject_to),
        stepper=stepper,
        schedule=plan_steps(
            start.protocol, stepper.longest_step(start.model), start=float(state.time)
        ),
        begin=state,
    )
    begin_numbers = _start_numbers(variables, initial)
    memory = _Memory(problem)
    start_value = float(memory.at(begin_numbers).values[0])
    numbers, converged = _search(memory, begin_numbers, max_iterations, tolerance)
    best = memory.at(numbers)
    trial = problem.trial(jnp.asarray(numbers))
    optimum = Optimum(
        run=trial,
        solution=best.solution,
        value=float(best.values[0]),
        start_value=start_value,
        constraints=_constraint_values(problem, trial, best.solution),
        numbers=numbers,
        evaluations=memory.count,
        outcome=Outcome.CONVERGED if converged else Outcome.STALLED,
    )
    excess = float(np.max(best.values[1:], initial=0.0))
    if excess > VIOLATION:
        names = ", ".join(c.name for c in optimum.constraints if c.value > c.bound)
        raise FitError(
            f"no run was found that satisfies: {names}; relax the bound, free more "
            "design variables, or start elsewhere"
        )
    return optimum


def _start_numbers(
    variables: Sequence[DesignVariable], initial: np.ndarray | None
) -> Float[np.ndarray, " number"]:
    flat = np.concatenate([variable.start for variable in variables])
    if initial is None:
        return flat
    if np.shape(initial) != flat.shape:
        raise InputError(
            f"optimise initial: expected {flat.size} numbers, those of the variables, "
            f"got shape {np.shape(initial)}"
        )
    return np.asarray(initial, float)


def _search(
    memory: "_Memory",
    initial: Float[np.ndarray, " number"],
    max_iterations: int,
    tolerance: Number,
) -> tuple[Float[np.ndarray, " number"], bool]:
    """The best numbers, and whether the last round ended by itself."""
    numbers, converged = initial, False
    for _ in range(ROUNDS):
        # SLSQP may end at an infeasible point or before the optimum; the best feasible
        # run of a round is a better start than its last iterate.
        result = scipy.optimize.minimize(
            lambda x: -memory.at(x).values[0],
            numbers,
            jac=lambda x: -memory.at(x).jacobian[0],
            bounds=[(0.0, 1.0)] * len(initial),
            constraints=[
                {
                    "type": "ineq",
                    "fun": lambda x: -memory.at(x).values[1:],
                    "jac": lambda x: -memory.at(x).jacobian[1:],
                }
            ],
            method="SLSQP",
            options={"maxiter": max_iterations, "ftol": tolerance},
        )
        converged = bool(result.success)
        if memory.best is None:
            numbers = np.clip(result.x, 0.0, 1.0)
            continue
        numbers = memory.best
        if converged:
            break
    return numbers, converged


class _Problem(eqx.Module):
    start: Run
    variables: tuple[DesignVariable, ...]
    maximise: Quantity
    constraints: tuple[Constraint, ...]
    stepper: AbstractStepper
    schedule: Schedule
    begin: HeatState

    def trial(self, numbers: Float[Array, " number"]) -> Run:
        trial, place = self.start, 0
        for variable in self.variables:
            count = len(variable.start)
            trial = variable.apply(numbers[place : place + count], trial)
            place += count
        return trial

    def values(
        self, numbers: Float[Array, " number"]
    ) -> tuple[Float[Array, " value"], Solution]:
        """The objective, then the excess of every constraint; and the solution."""
        trial = self.trial(numbers)
        solution = run(
            trial.model,
            trial.protocol,
            self.schedule,
            stepper=self.stepper,
            observe=jnp.max,
            start=self.begin,
        )
        parts = [self.maximise(trial, solution).reshape(1)]
        for one in self.constraints:
            parts.append(one.excess(one.quantity(trial, solution)).reshape(-1))
        return jnp.concatenate(parts), solution


class _Evaluation(NamedTuple):
    values: Float[np.ndarray, " value"]
    jacobian: Float[np.ndarray, "value number"]
    solution: Solution


@eqx.filter_jit
def _evaluate(problem: _Problem, numbers: Array) -> tuple[Array, Array, Solution]:
    """Values, their Jacobian with one tangent for each number, and the solution."""

    def evaluate(at: Array) -> tuple[Array, tuple[Array, Solution]]:
        values, solution = problem.values(at)
        return values, (values, solution)

    jacobian, (values, solution) = jax.jacfwd(evaluate, has_aux=True)(numbers)
    return values, jacobian, solution


class _Memory:
    """The last evaluation, as SciPy asks for value and gradient apart, and the best."""

    def __init__(self, problem: _Problem) -> None:
        self.problem, self.count = problem, 0
        self.place: np.ndarray | None = None
        self.last: _Evaluation
        self.best: np.ndarray | None = None
        self.best_value = -np.inf

    def at(self, numbers: np.ndarray) -> _Evaluation:
        if self.place is None or not np.array_equal(numbers, self.place):
            found = _evaluate(self.problem, jnp.asarray(numbers))
            values, jacobian = map(np.asarray, found[:2])
            self.last = _Evaluation(values, jacobian, found[2])
            self.place, self.count = np.array(numbers), self.count + 1
            value, *excesses = self.last.values
            if max(excesses, default=-1.0) <= FEASIBLE and value > self.best_value:
                self.best, self.best_value = np.clip(numbers, 0.0, 1.0), value
        return self.last


def _constraint_values(
    problem: _Problem, trial: Run, solution: Solution
) -> tuple[ConstraintValue, ...]:
    values = []
    for one in problem.constraints:
        value = one.quantity(trial, solution)
        active = abs(float(jnp.max(one.excess(value)))) <= ACTIVE
        values.append(
            ConstraintValue(
                one.name, float(jnp.max(value)), float(one.bound), one.unit, active
            )
        )
    return tuple(values)
