"""Our own contestants: the paper's recipe, the default recipe, and the noisy fit."""

import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.fit.contestants import Effort
from benchmarks.fit.problem import Problem, Trained, network_arrays
from pinav.dynamics import FixedStep
from pinav.fitting import (
    Fit,
    FitProgress,
    TrajectoryLoss,
    fit,
    fit_bayes,
    kernel_environment,
    paper_recipe,
)
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import (
    ModelChoice,
    learned_part,
    summarise_for,
    summarise_for_matching,
)
from pinav.forces import KernelPotential
from pinav.learning.matching import matching
from pinav.learning.recipes import Curriculum
from pinav.scenarios import scenario
from pinav.trajectories import Trajectories, load


def _data(problem: Problem) -> tuple[Trajectories, Any]:
    """The trajectories, and the swimmer whose environment is to be replaced."""
    jax.config.update("jax_enable_x64", val=True)
    data = load(problem.file)
    return data, scenario(data.provenance["scenario"]).swimmer


def _model(name: str, known: Any, seed: int, data: Trajectories) -> Any:
    choice = ModelChoice(name, seed=seed)
    return build(choice, known, summarise_for(choice, data))


class Curve:
    """RMSE after each chunk of a fit, and when.

    Attributes:
        began: time at which the process was launched [s].
        count: number of observed entries behind the sum of squares.
        points: seconds and RMSE so far.
    """

    def __init__(self, began: float, count: int):
        self.began, self.count = began, count
        self.points: list[tuple[float, float]] = []

    def __call__(self, progress: FitProgress) -> None:
        """Take note of one chunk: its last loss, and the time."""
        self.add(progress.losses[0, -1])

    def add(self, loss: float) -> None:
        """Take note of a sum of squares."""
        now = time.time() - self.began
        self.points.append((now, float(np.sqrt(loss / self.count))))


def _fit(problem: Problem, data, model, recipe, *, exact: bool) -> tuple[Fit, Trained]:
    curve = Curve(problem.began, data.num_observed)
    found = fit(
        model,
        data,
        recipe,
        trainable=learned_part,
        objective=TrajectoryLoss(FixedStep(substeps=2 if exact else 1)),
        dtype=jnp.float64 if exact else jnp.float32,
        on_chunk=curve,
        throw=False,
    )
    curve.add(found.losses[-1])
    points = np.array(curve.points)
    return found, Trained({}, found.losses.size - 1, curve=points)


def _network(found: Fit, trained: Trained) -> Trained:
    environment = found.model.environment  # pyright: ignore[reportAttributeAccessIssue]
    layers = [(layer.weight, layer.bias) for layer in environment.network.layers]
    features = environment.features
    arrays = network_arrays(layers, features.center, features.scale)
    return trained._replace(arrays=arrays)


def paper_network(problem: Problem, seed: int, effort: Effort) -> Trained:
    """The paper's network and recipe: Adam, then L-BFGS, in float32."""
    data, known = _data(problem)
    recipe = paper_recipe(effort.adam_steps, effort.lbfgs_steps)
    return _network(
        *_fit(
            problem, data, _model("paper-ude", known, seed, data), recipe, exact=False
        )
    )


def network(problem: Problem, seed: int, effort: Effort) -> Trained:
    """The paper's network, our default recipe."""
    return _network(*_by_default("ude", problem, seed, effort))


def kernel(problem: Problem, seed: int, effort: Effort) -> Trained:
    """A kernel potential, our default recipe."""
    found, trained = _by_default("kernel-potential", problem, seed, effort)
    return trained._replace(arrays=kernel_arrays(found.model))


def _by_default(
    name: str, problem: Problem, seed: int, effort: Effort
) -> tuple[Fit, Trained]:
    """The first attempt of the default recipe, as commands compose it."""
    data, known = _data(problem)
    choice = ModelChoice(name, seed=seed)
    model = build(choice, known, summarise_for_matching(choice, known, data))
    settings = Curriculum(effort.gauss_newton_steps)
    recipe = matching(settings, data, model).recipes[0]
    return _fit(problem, data, model, recipe, exact=True)


def kernel_arrays(swimmer) -> dict[str, np.ndarray]:
    """A swimmer with a kernel potential as named arrays."""
    environment = swimmer.environment
    return {
        "weights": np.asarray(environment.weights),
        "centers": np.asarray(environment.centers),
        "width": np.asarray(environment.width),
        "damping": np.asarray(swimmer.drag.damping),
        "gain": np.asarray(swimmer.propulsion.gain),
    }


def _noisy(problem: Problem, columns: int, *, constants: bool) -> Trained:
    """`fit_bayes` of a kernel potential to the first columns of the states."""
    data, known = _data(problem)
    observed = np.broadcast_to(np.arange(4) < columns, data.states.shape)
    data = Trajectories.from_arrays(
        list(data.times), list(data.states), channels=data.channels, observed=observed
    )
    model = eqx.tree_at(
        lambda swimmer: swimmer.environment,
        known,
        kernel_environment(KernelPotential, data),
    )
    if not constants:
        found = fit_bayes(model, data)
        return Trained(kernel_arrays(found.model), found.iterations)

    def learned(swimmer):
        return swimmer.drag.damping, swimmer.propulsion.gain

    found = fit_bayes(eqx.tree_at(learned, model, (0.1, 0.0)), data, learn=learned)
    return Trained(kernel_arrays(found.model), found.iterations)


def states(problem: Problem, seed: int, effort: Effort) -> Trained:
    """All four states, drag and thrust known."""
    return _noisy(problem, 4, constants=False)


def positions(problem: Problem, seed: int, effort: Effort) -> Trained:
    """Positions alone, drag and thrust known."""
    return _noisy(problem, 2, constants=False)


def positions_and_constants(problem: Problem, seed: int, effort: Effort) -> Trained:
    """Positions alone; drag and thrust are learned from 0.1 and 0."""
    return _noisy(problem, 2, constants=True)
