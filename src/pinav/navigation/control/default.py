"""The controller that a task gets unless another is asked for."""

from collections.abc import Sequence

from pinav.navigation.control.compensation import (
    DelayCompensation,
    DriftEstimation,
    Timing,
)
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.control.costs import ArrivalCost, TrackingCost
from pinav.navigation.control.gradient_mpc import Shooting
from pinav.navigation.control.mppi import PathIntegral
from pinav.navigation.control.prediction import Courses, Downhill
from pinav.navigation.model.predictors import AbstractPredictor, Drifting
from pinav.navigation.model.tabulated import Terrain, terrain
from pinav.navigation.planning.plan import check_places, time_to_go
from pinav.navigation.task.objectives import Reach
from pinav.navigation.task.steering import SteeredSwimmer
from pinav.navigation.task.task import Task


def controller(
    task: Task,
    model: SteeredSwimmer,
    *,
    samples: Sequence[SteeredSwimmer] = (),
    aversion: float = 4.0,
    drift: float | None = None,
) -> AbstractController:
    """Plan and control a task with a model: the truth of the task is not used.

    To reach a place: path integral control towards the plan's time-to-go. To follow a
    path: shooting. Both inside a filter of drift and sensor noise where the task has a
    noisy sensor or a `drift` is given, and a compensation of the delay if there is one.

    Args:
        task: what is to be done, and within which limits.
        model: what is believed: a fitted model, physics alone, or the truth.
        samples: of the model's posterior, none or at least two: where they disagree,
            time costs more.
        aversion: cost of time where their spread is as great as the thrust.
        drift: standard deviation of a constant rate that the model does not know, and
            that is estimated on the way [L T⁻¹], or [L T⁻²] with inertia; 0 for none.
            Unless given, none.

    Raises:
        InputError: the task cannot be done with the model: see `time_to_go`.
    """
    check_places(task)
    ground = terrain(task, model, samples=samples, aversion=aversion)
    filtered = task.sensor_noise > 0 or bool(drift)
    predictor = Drifting(ground.predictor) if filtered else ground.predictor
    steered = _steered(task, model, ground, predictor)
    timing = Timing(task.step, task.delay)
    if task.delay > 0:
        steered = DelayCompensation(steered, predictor, timing)
    if filtered:
        steered = DriftEstimation(
            steered,
            predictor,
            timing,
            noise=task.noise,
            sensor_noise=task.sensor_noise,
            prior=drift or 0.0,
        )
    return steered


def _steered(
    task: Task, model: SteeredSwimmer, ground: Terrain, predictor: AbstractPredictor
) -> AbstractController:
    """What decides, without delay and with a good sensor."""
    if isinstance(task.objective, Reach):
        plan = time_to_go(task, model, ground=ground)
        courses = Courses(predictor, ground.drive, task.step, STEPS)
        return PathIntegral(courses, ArrivalCost(plan), Downhill(plan))
    courses = Courses(predictor, ground.drive, task.step, TRACKING_STEPS)
    cost = TrackingCost(task.objective, ground.surroundings)
    return Shooting(courses, cost)


STEPS = 20
"""Steps that the control of an arrival looks ahead."""

TRACKING_STEPS = 10
"""Steps that the control of a path looks ahead."""
