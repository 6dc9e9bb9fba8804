"""Knowledge of the environment before a flight: the truth, or an earlier fit."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import AbstractSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import Posterior
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.strategies import axes_of
from pinav.navigation.belief.given import BeliefPrior, GivenForce, take_for_granted
from pinav.navigation.belief.kernels import Points
from pinav.navigation.predictors import TabulatedModel, split_rates, tabulate_model
from pinav.navigation.task.steering import SteeredSwimmer, physics_only
from pinav.navigation.task.task import Task, steered_swimmer

PLACES = 256
"""Places of the data at most at which the fit is told how well it knows the force."""

DISTRUST = 0.05
"""Error of a fit that its posterior does not know, over the greatest thrust."""


def environment_rate(task: Task, model: SteeredSwimmer) -> GivenForce:
    """The environment of a model, as a contribution to the rate of a swimmer at rest.

    Raises:
        InputError: the environment changes in time.
    """
    table = tabulate_model(task, model).table
    if len(table.values) > 1:
        raise InputError(
            f"task {task.name!r}: learning on the way expected an environment that "
            "does not change in time"
        )
    without = tabulate_model(task, physics_only(model)).table
    rate = np.asarray(table.values - without.values, float)[0, ..., :2]
    return GivenForce.of(axes_of(table.grid), rate)


def with_prior_of(
    adaptive: AdaptiveController,
    swimmer: AbstractSwimmer,
    posterior: Posterior,
    places: Points,
) -> AdaptiveController:
    """The controller that begins with what a fit of earlier trajectories found.

    The fitted force is the first guess everywhere; what the posterior knows of its
    error is taken over where there were data. A structured force may be sure of itself
    far from them; that certainty is not, so that the swimmer looks for itself.

    Args:
        places: where the data were [L].

    Raises:
        InputError: the fit has inertia and the swimmer of the task has none, or the
            other way round; it is not planar; its environment changes in time.
    """
    task, dim = adaptive.task, places.shape[1]
    if isinstance(swimmer, Swimmer) != task.inertial or dim != task.dim:
        kinds = {True: "with inertia", False: "without inertia"}
        raise InputError(
            f"prior: expected a fit of a swimmer {kinds[task.inertial]} in {task.dim} "
            f"dimensions, as task {task.name!r} has it, got one "
            f"{kinds[isinstance(swimmer, Swimmer)]} in {dim}"
        )
    rate = environment_rate(task, steered_swimmer(task, swimmer))
    chosen = np.linspace(0, len(places) - 1, min(len(places), PLACES)).astype(int)
    rows = posterior.force_jacobians(places[chosen])
    if not task.inertial:
        rows = mobilities(adaptive.physics, places[chosen]) @ rows
    rows = rows.reshape(-1, rows.shape[-1])
    covariance = rows @ posterior.covariance @ rows.T
    covariance += (DISTRUST * adaptive.thrust) ** 2 * np.eye(len(rows))
    prior = BeliefPrior(rate, places[chosen], covariance)
    first = adaptive.believe(adaptive.first_frame)
    return dataclasses.replace(adaptive, known=prior.lead(first))


def with_truth(adaptive: AdaptiveController) -> AdaptiveController:
    """The oracle: a controller that knows the true force, and estimates its state."""
    task = adaptive.task
    belief = take_for_granted(
        environment_rate(task, task.truth),
        adaptive.first_frame,
        motion=adaptive.motion,
        longest=task.step,
    )
    return dataclasses.replace(adaptive, known=belief)


def mobilities(
    physics: TabulatedModel, places: Points
) -> Float[np.ndarray, "point 2 2"]:
    """Mobility at places, of tables of a swimmer without inertia."""
    channels = jax.jit(jax.vmap(lambda x: physics.table(0.0, x)))(jnp.asarray(places))
    return np.asarray(split_rates(channels)[1], float)
