r"""Gauss-Newton on trajectory residuals, from one-step matching to the full rollout.

Rollouts restart from the data every `window` samples; one sample is one-step
matching, all of them the full rollout. All steps are linearised at once, and the
Jacobian of the residuals follows by $J_{k+1} = A_k J_k + B_k$, with J set to zero
where the rollout restarts. The Jacobian of a trained network has a numerical rank of
some tens, so one random projection captures it, and any damping costs nothing more.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from pinav.arguments import Scalar, State, check_positive
from pinav.dynamics import RK4, FixedStep
from pinav.fitting.matching.damped_steps import (
    DAMPINGS,
    NETWORK_DAMPING,
    DampedStep,
    LinearisedResiduals,
    damped_step,
    full_step,
    pointwise,
)
from pinav.fitting.matching.phases import AbstractPhase, Loss
from pinav.fitting.matching.windows import Windows
from pinav.fitting.outcome import Outcome


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


def _number(value: ArrayLike) -> Float[Array, ""]:
    return jnp.asarray(value, float)


class AbstractDampedPhase(AbstractPhase):
    """A phase whose steps are damped, and which no longer moves once it has ended."""

    side_by_side: ClassVar[bool] = False

    @abc.abstractmethod
    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        """Parameters and state after a step of a phase that has not ended."""

    def step(
        self, loss: Loss, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState, Float[Array, ""]]:
        return jax.lax.cond(
            state.done,
            lambda: (params, state, state.value),
            lambda: (*self.take_step(loss, params, state), state.value),
        )

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
    chunk_steps: ClassVar[int] = 1

    @abc.abstractmethod
    def best_step(
        self, windows: Windows, theta: Float[Array, " parameter"], state: DampedState
    ) -> DampedStep:
        """The best of several steps from these parameters."""

    @property
    def num_steps(self) -> int:
        return self.steps

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
    target: Float[Array, ""] = eqx.field(converter=_number)
    patience: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=2)
    converged: Float[Array, ""] = eqx.field(converter=_number, default=0.0)
    damping: Float[Array, ""] = eqx.field(converter=_number, default=1e-2)
    steps: int = eqx.field(static=True, default=20)
    rank: int = eqx.field(static=True, default=64)
    chord_steps: int = eqx.field(static=True, default=5)
    num_dampings: int = eqx.field(static=True, default=5)
    linearisation: FixedStep = FixedStep()

    def __check_init__(self) -> None:
        check_positive(self, "steps", "rank", "chord_steps", "num_dampings")

    @property
    def name(self) -> str:
        return f"L = {int(self.window)}"

    def best_step(
        self, windows: Windows, theta: Float[Array, " parameter"], state: DampedState
    ) -> DampedStep:
        starts, residual, surrogate = windows.surrogate(theta)
        jacobian = windows.jacobian(theta, starts)
        return damped_step(
            LinearisedResiduals(surrogate, theta, residual, jacobian, state.damping),
            rank=self.rank,
            num_dampings=self.num_dampings,
            chord_steps=self.chord_steps,
        )


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
    target: Float[Array, ""] = eqx.field(converter=_number)
    samples: Int[Array, "sample 2"] | None = None
    prior_root: Float[Array, "parameter direction"] | None = None
    least_damping: Float[Array, ""] = eqx.field(converter=_number, default=0.0)
    damping: Float[Array, ""] = eqx.field(converter=_number, default=1e-2)
    patience: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=3)
    converged: Float[Array, ""] = eqx.field(converter=_number, default=0.0)
    steps: int = eqx.field(static=True, default=20)
    linearisation: FixedStep = FixedStep(RK4)

    def __check_init__(self) -> None:
        check_positive(self, "steps")

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
        if root is not None and root.shape[0] != theta.shape[0]:
            root = None  # constants train, too
        problem = LinearisedResiduals(
            residuals, theta, residuals(theta), jacobian, damping
        )
        return full_step(problem, directions=root)

    def _rows_that_count(
        self, windows: Windows, rows: Float[Array, "residual ..."]
    ) -> Float[Array, "row ..."]:
        """The rows of the samples that count."""
        if self.samples is None:
            return rows
        data = windows.problem.observations.states[:, 1:]
        each = rows.reshape(*data.shape, *rows.shape[1:])
        return each[tuple(self.samples.T)].reshape(-1, *rows.shape[1:])


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

    targets: Rates = eqx.field(converter=lambda rates: jax.tree.map(jnp.asarray, rates))
    steps: int = eqx.field(static=True, default=40)
    patience: int = eqx.field(static=True, default=3)
    chunk_steps: ClassVar[int] = 5

    def __check_init__(self) -> None:
        check_positive(self, "steps")

    @property
    def name(self) -> str:
        return "Rates"

    @property
    def num_steps(self) -> int:
        return self.steps

    def init(self, loss: Loss, params: PyTree, value: Float[Array, ""]) -> DampedState:
        damping = jnp.asarray(NETWORK_DAMPING, value.dtype)
        return DampedState.begin(damping, value)

    def outcome(self, state: DampedState) -> Int[Array, ""]:
        return jnp.asarray(Outcome.COMPLETED)

    def take_step(
        self, problem: Any, params: PyTree, state: DampedState
    ) -> tuple[PyTree, DampedState]:
        theta, unravel = ravel_pytree(params)
        targets = jnp.asarray(self.targets.rates)

        def rate(theta: Float[Array, " parameter"], t: Scalar, y: State) -> State:
            return problem.model(unravel(theta))(t, y)[-targets.shape[1] :]

        points = jnp.asarray(self.targets.times), jnp.asarray(self.targets.states)
        size = jnp.sqrt(jnp.mean(targets**2, axis=0))
        residuals, jacobian = pointwise(rate, theta, points, targets, size)
        before = residuals(theta)
        step = full_step(
            LinearisedResiduals(residuals, theta, before, jacobian, state.damping)
        )
        slow = jnp.where(step.left < SLOW_RATES, 0, state.slow + 1)
        error = jnp.sqrt(jnp.mean(residuals(step.theta) ** 2))
        done = (slow >= self.patience) | (error < MATCHED)
        after = (step.damping, slow, done)
        state = eqx.tree_at(lambda s: (s.damping, s.slow, s.done), state, after)
        return unravel(step.theta), state


SLOW_RATES = 0.95
"""Share of the squares that a slow step leaves: steps are cheap, and networks that see
the whole state gain a few per cent for twenty steps before they gain the rest."""

MATCHED = 1e-6
"""Relative error of the rates that needs no further step: splines are less exact."""
