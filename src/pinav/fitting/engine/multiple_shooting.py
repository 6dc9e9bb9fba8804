r"""Lifted least squares: every sample state is a point of linearisation.

A rollout that depends on its start sensitively is a hard function to linearise. So it
is not rolled out: with one state $u_k$ per sample and the step $F_k$ from one sample to
the next, the constraint $u_{k+1} = F_k(u_k, \theta)$ is linearised about states that
need not fulfil it. Its solution is $u + J\,\delta\theta + \Phi\,\delta s + c$, with a
change $\delta s$ of the start and $c$ the response to the defects
$d_k = F_k(u_k) - u_{k+1}$; all three follow from one linear recursion.

References:
    Bock, Randwertproblemmethoden zur Parameteridentifizierung (1987), condensing;
    Albersmeyer and Diehl, SIAM J. Optim. 20, 1655 (2010), the lifted Newton method.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from pinav.arguments import Scalar, State
from pinav.dynamics import FixedStep, linear_recursion
from pinav.fitting.engine.local_model import ModelOfParameters, Prediction
from pinav.fitting.matching.state import Observations


class Sensitivities(eqx.Module):
    r"""Linearised solution along one trajectory of states.

    Attributes:
        columns: $J$, $\Phi$ and $c$ side by side.
        defects: $d_k$, by which each step misses the next state.
    """

    columns: Float[Array, "time state column"]
    defects: Float[Array, "step state"]


def sensitivities(
    free: ModelOfParameters,
    theta: Float[Array, " parameter"],
    states: Float[Array, "time state"],
    times: Float[Array, " time"],
    solver: FixedStep,
) -> Sensitivities:
    r"""Linearise the dynamics about `states`, whether or not they are a solution.

    With $A_k = \partial F_k/\partial u$ and $B_k = \partial F_k/\partial\theta$, all
    at once, $E_{k+1} = A_k E_k + [B_k, 0, d_k]$ from $E_0 = [0, I, 0]$.
    """
    return propagate(_step_derivatives(free, theta, states, times, solver), states)


class StepDerivatives(eqx.Module):
    """Steps from one sample to the next, and their derivatives."""

    by_parameter: Float[Array, "... step state parameter"]
    by_state: Float[Array, "... step state state"]
    ends: Float[Array, "... step state"]


FEW = 16
"""Parameters up to which forward derivatives are cheaper than reverse ones."""


def _step_derivatives(
    parametric: ModelOfParameters,
    theta: Float[Array, " parameter"],
    states: Float[Array, "time state"],
    times: Float[Array, " time"],
    solver: FixedStep,
    *,
    parameters: bool = True,
) -> StepDerivatives:
    """Along one trajectory; without derivatives by the parameters if told so."""
    derive = _derive_step(parametric, theta, solver, parameters=parameters)
    steps = jax.vmap(derive)(states[:-1], times[:-1], times[1:])
    return StepDerivatives(*steps)


StepDerivative = tuple[
    Float[Array, "state parameter"], Float[Array, "state state"], State
]
"""Derivatives of one step by the parameters and by its start, and its end."""


def _derive_step(
    parametric: ModelOfParameters,
    theta: Float[Array, " parameter"],
    solver: FixedStep,
    *,
    parameters: bool = True,
) -> Callable[[State, Scalar, Scalar], StepDerivative]:
    """Derivatives of one step as a function of its start and its two times."""

    def step(
        theta: Float[Array, " parameter"], y: State, t0: Scalar, t1: Scalar
    ) -> tuple[State, State]:
        end = solver.looped_step(parametric(theta), y, t0, t1)
        return end, end

    # One derivative by both with the end beside it: half of the code and of the work.
    is_reverse = parameters and theta.shape[0] > FEW
    derivative = jax.jacrev if is_reverse else jax.jacfwd
    slopes = derivative(step, (0, 1) if parameters else 1, has_aux=True)

    def derive(y: State, t0: Scalar, t1: Scalar) -> StepDerivative:
        jacobians, end = slopes(theta, y, t0, t1)
        nothing = jnp.zeros((*end.shape, 0), end.dtype)
        by_parameter, by_state = jacobians if parameters else (nothing, jacobians)
        return by_parameter, by_state, end

    return derive


def propagate(
    steps: StepDerivatives, states: Float[Array, "time state"]
) -> Sensitivities:
    """Sensitivities to the parameters whose effect on each step is given."""
    defects = steps.ends - states[1:]
    count, state = defects.shape
    # Columns by the parameters, by the start and of the defects obey one recursion with
    # three sources.
    nothing = jnp.zeros((count, state, state))
    sources = jnp.concatenate([steps.by_parameter, nothing, defects[..., None]], axis=2)
    start = jnp.eye(state, sources.shape[2], k=steps.by_parameter.shape[2])
    recursion = jax.vmap(linear_recursion, (1, None, 2), 2)
    return Sensitivities(recursion(start, steps.by_state, sources), defects)


class Linearisation(eqx.Module):
    r"""Sum of squared residuals as a quadratic, the starts eliminated.

    $\sum r^2 = q + 2\,g\cdot\delta\theta + \delta\theta\cdot H\,\delta\theta$, minimal
    over the changes of all starts.

    Attributes:
        hessian: $H$.
        gradient: $g$.
        squares: $q$.
        columns: see `Sensitivities`.
        start_factor: R, where $R^\top R = \Phi^\top\Phi$ over the observed entries.
        start_rows: $\delta s = -$ (these rows applied to $(\delta\theta, 1)$).
        defects: the largest defect of each channel.
    """

    hessian: Float[Array, "parameter parameter"]
    gradient: Float[Array, " parameter"]
    squares: Float[Array, ""]
    columns: Float[Array, "trajectory time state column"]
    start_factor: Float[Array, "trajectory state state"]
    start_rows: Float[Array, "trajectory state row"]
    defects: Float[Array, " state"]


def linearise(
    parametric: ModelOfParameters,
    theta: Float[Array, " parameter"],
    states: Float[Array, "trajectory time state"],
    observations: Observations,
    solver: FixedStep,
) -> Linearisation:
    """Linearise all trajectories about `states` and eliminate their starts.

    Padding, which repeats the last time and state, adds nothing. The two halves are
    compiled apart, for only the first depends on the model: laws that are tried in turn
    share the second.
    """
    times = observations.times
    steps = _all_step_derivatives(parametric, theta, states, times, solver)
    return _condense(steps, states, observations)


@eqx.filter_jit
def _all_step_derivatives(
    parametric: ModelOfParameters,
    theta: Float[Array, " parameter"],
    states: Float[Array, "trajectory time state"],
    times: Float[Array, "trajectory time"],
    solver: FixedStep,
) -> StepDerivatives:
    """Of the steps of all trajectories, a few at a time.

    What a step leaves behind for its derivative would take many times the memory of the
    result; that of a few stays in the processor's cache.
    """
    inputs = states[:, :-1], times[:, :-1], times[:, 1:]
    shape = inputs[1].shape
    count = shape[0] * shape[1]
    # A divisor, because steps that are left over would be compiled once more.
    batch = max(size for size in range(1, AT_ONCE + 1) if count % size == 0)
    few = jax.tree.map(lambda x: x.reshape(count // batch, batch, *x.shape[2:]), inputs)
    derive = jax.vmap(_derive_step(parametric, theta, solver))
    steps = jax.lax.map(lambda some: derive(*some), few)
    return StepDerivatives(*(x.reshape(*shape, *x.shape[2:]) for x in steps))


AT_ONCE = 10
"""Steps whose derivatives are taken together."""


@eqx.filter_jit
def _condense(
    steps: StepDerivatives,
    states: Float[Array, "trajectory time state"],
    observations: Observations,
) -> Linearisation:
    """Accumulate the steps and eliminate the starts (Bock's condensing)."""
    count = steps.by_parameter.shape[-1]

    def one(total: Float[Array, "n n"], inputs: tuple) -> tuple:
        steps, states, data, observed = inputs
        local = propagate(steps, states)
        reach = local.columns
        residuals = states + reach[..., -1] - data
        rows = jnp.concatenate([reach[..., :-1], residuals[..., None]], axis=2)
        rows = jnp.where(observed[..., None], rows, 0.0).reshape(-1, rows.shape[2])
        # Each trajectory's start has a flat prior, and is eliminated where it stands.
        rest, factor, start_rows = eliminate(rows, count, states.shape[1])
        return total + rest.T @ rest, (factor, start_rows, reach, local.defects)

    nothing = jnp.zeros((count + 1,) * 2, states.dtype)
    inputs = (steps, states, observations.states, observations.observed)
    total, (factors, start_rows, columns, defects) = jax.lax.scan(one, nothing, inputs)
    return Linearisation(
        hessian=total[:-1, :-1],
        gradient=total[:-1, -1],
        squares=total[-1, -1],
        columns=columns,
        start_factor=factors,
        start_rows=start_rows,
        defects=jnp.abs(defects).max(axis=(0, 1)),
    )


def eliminate(
    rows: Float[Array, "row all"], first: int, count: int
) -> tuple[
    Float[Array, "left rest"], Float[Array, "count count"], Float[Array, "count rest"]
]:
    """Minimise a sum of squares over `count` of its unknowns, from column `first` on.

    By an orthogonal factorisation: a normal matrix would have the square of its
    condition, and an unstable path makes that of a start as bad as 1e8.

    Returns:
        What is left of the other columns, the triangular factor of the eliminated ones,
        and the rows that give their unknowns, up to sign, from the rest.
    """
    chosen = rows[:, first : first + count]
    others = jnp.concatenate([rows[:, :first], rows[:, first + count :]], axis=1)
    if rows.shape[0] < count:
        padding = ((0, count - rows.shape[0]), (0, 0))
        chosen, others = jnp.pad(chosen, padding), jnp.pad(others, padding)
    # QR and no normal equations, which would square the condition of unstable starts.
    basis, factor = jnp.linalg.qr(chosen)
    along = basis.T @ others
    start_rows = jax.scipy.linalg.solve_triangular(factor, along)
    return others - basis @ along, factor, start_rows


@eqx.filter_jit
def advance(
    states: Float[Array, "trajectory time state"],
    linearisation: Linearisation,
    change: Float[Array, " parameter"],
) -> Float[Array, "trajectory time state"]:
    r"""The states after the step $\delta\theta$, each start at its best."""

    def one(
        states: Float[Array, "time state"],
        columns: Float[Array, "time state column"],
        start_rows: Float[Array, "state other"],
    ) -> Float[Array, "time state"]:
        starts = -start_rows @ jnp.append(change, 1.0)
        return states + columns @ jnp.concatenate([change, starts, jnp.ones(1)])

    return jax.vmap(one)(states, linearisation.columns, linearisation.start_rows)


@eqx.filter_jit
def predict(
    free: ModelOfParameters,
    theta: Float[Array, " parameter"],
    states: Float[Array, "trajectory time state"],
    observations: Observations,
    solver: FixedStep,
) -> Prediction:
    """Linearise in the states alone: the parameters count in full.

    Costs a small part of `linearise`, because no derivative by a parameter is taken.
    """

    def one(
        states: Float[Array, "time state"],
        times: Float[Array, " time"],
        data: Float[Array, "time state"],
        observed: Bool[Array, "time state"],
    ) -> tuple[Float[Array, "time state"], Float[Array, "time state"]]:
        state = states.shape[1]
        steps = _step_derivatives(free, theta, states, times, solver, parameters=False)
        columns = propagate(steps, states).columns
        is_observed = observed[..., None]
        by_start = jnp.where(is_observed, columns[..., :-1], 0.0).reshape(-1, state)
        residuals = jnp.where(observed, states + columns[..., -1] - data, 0.0)
        rows = jnp.concatenate([by_start, residuals.reshape(-1, 1)], axis=1)
        start = -eliminate(rows, 0, state)[2][:, 0]
        change = columns @ jnp.append(start, 1.0)
        moved = states + change
        return jnp.where(observed, moved - data, 0.0), moved

    return Prediction(
        *jax.vmap(one)(
            states, observations.times, observations.states, observations.observed
        )
    )


@eqx.filter_jit
def pull_back(
    linearisation: Linearisation, residuals: Float[Array, "trajectory time state"]
) -> Float[Array, " parameter"]:
    r"""$J^\top r$ with the starts eliminated from $J$.

    Args:
        residuals: $r$, zero where nothing was observed.
    """
    state = residuals.shape[-1]

    def one(
        columns: Float[Array, "time state column"],
        start_rows: Float[Array, "state other"],
        residuals: Float[Array, "time state"],
    ) -> Float[Array, " parameter"]:
        flat = columns.reshape(-1, columns.shape[-1])[:, :-1].T @ residuals.reshape(-1)
        count = flat.shape[0] - state
        return flat[:count] - start_rows[:, :count].T @ flat[count:]

    rows = (linearisation.columns, linearisation.start_rows, residuals)
    return jax.vmap(one)(*rows).sum(axis=0)
