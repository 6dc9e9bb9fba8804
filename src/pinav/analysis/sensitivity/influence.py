r"""Effect of each trajectory and each known constant on a Bayesian fit.

At the solution the sum of squares of every trajectory $i$, its start eliminated, is a
quadratic with $H_i = R_i^\top R_i$ and gradient $R_i^\top r_i$. With the covariance
$C$ of the parameters, the hyperparameters held, and $h_i = R_i C R_i^\top/\sigma^2$,

$$\Delta_i\theta = C R_i^\top (I - h_i)^{-1} r_i / \sigma^2$$

is the change that leaving trajectory $i$ out makes, exact where the model is linear;
without $h_i$ it is the infinitesimal jackknife. A constant $c$ that the fit was given
moves the parameters by $d\theta/dc = -C H_{\theta c}/\sigma^2$ (implicit function
theorem); one that it learned by the regression $C_{\theta c}/C_{cc}$.

References:
    Cook, Technometrics 19, 15 (1977); Pregibon, Ann. Stat. 9, 705 (1981); Giordano et
    al., AISTATS 2019, "A Swiss Army infinitesimal jackknife".
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from pinav.dynamics import FixedStep
from pinav.errors import FitError, InputError
from pinav.fitting import Hyperparameters, ParametricModel, ravel_model
from pinav.fitting.bayes.neural import FitSpecification, function_prior
from pinav.fitting.bayes.parameters import learned_environment
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.local_model import selected_entries
from pinav.fitting.engine.multiple_shooting import linearise
from pinav.fitting.engine.posterior import force_jacobians, linear_rollout
from pinav.fitting.evidence.quadratic import Quadratic, eliminate_flat, joint_posterior
from pinav.forces import AbstractLearnedForce
from pinav.trajectories import Trajectories

Pick = Callable[[Any], PyTree]
"""Picks a number of a model, or several."""

Hessian = Float[np.ndarray, "parameter parameter"]
"""Normal matrix of the parameters, or their covariance."""


class Influence(eqx.Module):
    r"""Changes of the parameters, to be followed to a force or to a rollout.

    Parameters are those that the fit learned, and the constants it was given.

    Attributes:
        removals: change of them where one trajectory is left out.
        constants: change of them per unit of each constant, the data fitted anew.
        leverages: $\mathrm{tr}\,h_i$, how many parameters a trajectory determines.
        distances: Cook's $\Delta_i^\top C^{-1} \Delta_i$ over the sum of all leverages.
    """

    free: ParametricModel
    theta: Float[np.ndarray, " parameter"]
    removals: Float[np.ndarray, "trajectory parameter"]
    constants: dict[str, Float[np.ndarray, " parameter"]]
    leverages: Float[np.ndarray, " trajectory"]
    distances: Float[np.ndarray, " trajectory"]

    def force_changes(
        self, points: ArrayLike, changes: Float[np.ndarray, "change parameter"]
    ) -> Float[np.ndarray, "change point dim"]:
        """First-order change of the force [L T⁻²] on a swimmer at rest at points [L].

        Args:
            changes: of the parameters, such as `removals`.
        """
        with jax.enable_x64(new_val=True):
            places = jnp.asarray(points, jnp.float64)
            times = jnp.zeros(len(places))
            slopes = force_jacobians(self.free, jnp.asarray(self.theta), places, times)
        return np.moveaxis(np.asarray(slopes) @ changes.T, -1, 0)

    def final_changes(
        self,
        y0: ArrayLike,
        ts: ArrayLike,
        changes: Float[np.ndarray, "change parameter"],
    ) -> Float[np.ndarray, "change state"]:
        """First-order change of the last state of a rollout.

        Args:
            changes: of the parameters, such as `removals`.
        """
        with jax.enable_x64(new_val=True):
            _, columns = linear_rollout(
                self.free,
                jnp.asarray(self.theta),
                jnp.asarray(y0, jnp.float64),
                jnp.asarray(ts, jnp.float64),
                FixedStep(),
            )
        return changes @ np.asarray(columns)[-1, :, : len(self.theta)].T


def influence(
    model: Any,
    trajectories: Trajectories,
    states: Float[np.ndarray, "trajectory time state"],
    hyperparameters: Hyperparameters,
    *,
    learn: Pick = lambda _: (),
    constants: Mapping[str, Pick] | None = None,
    kernels: AbstractLearnedForce | None = None,
) -> Influence:
    """Effect of each trajectory, and each constant, on a fit of `fit_bayes`.

    Hyperparameters are held: they would change a little, too.

    Args:
        constants: numbers of the model by name, learned or not.
        kernels: of the process that is the prior of a network, with the terms beside
            them, from `fit.linear.weights.process`; those with which fits begin unless
            given.

    Raises:
        InputError: there is one trajectory, or a constant is not a single number.
        FitError: a trajectory alone determines some parameter.
    """
    if len(trajectories) < 2:
        raise InputError(
            "influence trajectories: expected two or more, got 1; there is none to "
            "leave out"
        )
    with jax.enable_x64(new_val=True):
        request = FitSpecification(model, trajectories, learn, None, FixedStep())
        weights, environment = None, learned_environment(model)
        linear = environment is None or environment.is_linear
        if not linear and len(hyperparameters.shape):
            weights = function_prior(request, states, hyperparameters, kernels)
        problem = request.problem(model, states=states, weights=weights)
        return _influence(problem, model, hyperparameters, learn, dict(constants or {}))


def _influence(
    problem: BayesProblem,
    model: Any,
    chosen: Hyperparameters,
    learn: Pick,
    constants: dict[str, Pick],
) -> Influence:
    picked = tuple(constants.values())
    free, theta = ravel_model(
        model, lambda m: (*_learned_leaves(m, learn), *(pick(m) for pick in picked))
    )
    learned = selected_entries(free, len(theta), lambda m: _learned_leaves(m, learn))
    places = {name: _place(name, free, theta, constants[name]) for name in constants}
    each = _linearise_each(problem, free, theta)
    hessian = np.sum([hessian for hessian, _ in each], axis=0)
    covariance = np.zeros_like(hessian)
    covariance[np.ix_(learned, learned)] = _covariance(
        problem, hessian[np.ix_(learned, learned)], chosen
    )
    removed = [
        _removal(normal, gradient, covariance, chosen.noise, index)
        for index, (normal, gradient) in enumerate(each)
    ]
    removals, leverages, distances = map(np.array, zip(*removed, strict=True))
    slopes = {
        name: _slope(covariance, hessian, place, chosen.noise, known=not learned[place])
        for name, place in places.items()
    }
    return Influence(
        free=free,
        theta=np.asarray(theta),
        removals=removals,
        constants=slopes,
        leverages=leverages,
        distances=distances / leverages.sum(),
    )


def _learned_leaves(model: Any, learn: Pick) -> tuple[PyTree, ...]:
    """Learned leaves: weights of the environment, and those that `learn` picks."""
    environment, picked = learned_environment(model), learn(model)
    weights = (
        () if environment is None else (environment.parameters, environment.geometry)
    )
    return *weights, *(picked if isinstance(picked, tuple | list) else (picked,))


def _place(
    name: str, free: ParametricModel, theta: Float[Array, " parameter"], pick: Pick
) -> int:
    places = np.flatnonzero(selected_entries(free, len(theta), pick))
    if len(places) != 1:
        raise InputError(
            f"influence constants: {name} is {len(places)} numbers; expected one"
        )
    return int(places[0])


def _linearise_each(
    problem: BayesProblem, free: ParametricModel, theta: Float[Array, " parameter"]
) -> list[tuple[Hessian, Float[np.ndarray, " parameter"]]]:
    each, states = [], jnp.asarray(problem.states)
    for index in range(len(states)):
        rows = slice(index, index + 1)
        data = jax.tree.map(lambda array, rows=rows: array[rows], problem.observations)
        linear = linearise(free, theta, states[rows], data, problem.solver)
        each.append((np.asarray(linear.hessian), np.asarray(linear.gradient)))
    return each


def _covariance(
    problem: BayesProblem, hessian: Hessian, chosen: Hyperparameters
) -> Hessian:
    nothing = np.zeros(len(hessian))
    whole = Quadratic(problem.theta, hessian, nothing, 0.0, problem.num_free, 0.0)
    quadratic, block = eliminate_flat(whole, problem.flat)
    mean, covariance = problem.weights.posterior(quadratic, chosen)
    return joint_posterior(block, mean, covariance, chosen.noise)[1]


def _removal(
    hessian: Hessian,
    gradient: Float[np.ndarray, " parameter"],
    covariance: Hessian,
    noise: float,
    index: int,
) -> tuple[Float[np.ndarray, " parameter"], float, float]:
    """Change of the parameters, leverage, and distance."""
    values, vectors = np.linalg.eigh(hessian)
    kept = values > 1e-14 * values[-1]
    roots, vectors = np.sqrt(values[kept]), vectors[:, kept]
    rows = roots[:, None] * vectors.T / noise
    residuals = vectors.T @ gradient / roots / noise
    gain = covariance @ rows.T
    leverage = rows @ gain
    left = np.eye(len(leverage)) - leverage
    if np.linalg.eigvalsh(left)[0] < 1e-8:
        raise FitError(
            f"influence: without trajectory {index} the data do not determine all "
            "parameters; learn fewer constants"
        )
    pulled = np.linalg.solve(left, residuals)
    distance = float(pulled @ leverage @ pulled)
    return gain @ pulled, float(np.trace(leverage)), distance


def _slope(
    covariance: Hessian, hessian: Hessian, place: int, noise: float, *, known: bool
) -> Float[np.ndarray, " parameter"]:
    """Change of all parameters per unit of the one at `place`."""
    if not known:
        return covariance[:, place] / covariance[place, place]
    slope = -covariance @ hessian[:, place] / noise**2
    slope[place] = 1.0
    return slope
