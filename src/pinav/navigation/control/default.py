"""The controller that a task gets unless another is asked for."""

from collections.abc import Sequence

from pinav.navigation.control.compensation import (
    DelayCompensation,
    StateEstimation,
    Timing,
)
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.control.mppi import GradientMPC, PathIntegral
from pinav.navigation.control.prediction import (
    ArrivalCost,
    GradientGuide,
    TrackingCost,
    TrajectoryPrediction,
)
from pinav.navigation.model.tabulated import TabulatedModel, tabulate_model
from pinav.navigation.planning.plan import check_places, time_to_go
from pinav.navigation.task.objectives import ReachGoal
from pinav.navigation.task.steering import SteeredSwimmer
from pinav.navigation.task.task import Task


def controller(
    task: Task,
    model: SteeredSwimmer,
    *,
    samples: Sequence[SteeredSwimmer] = (),
    risk_aversion: float = 4.0,
) -> AbstractController:
    """Plan and control a task with a model: the truth of the task is not used.

    To reach a place: path integral control towards the plan's time-to-go. To follow a
    path: shooting. Both inside a filter where the task has a noisy sensor, and a
    compensation of the delay if there is one.

    Args:
        task: what is to be done, and within which limits.
        model: what is believed: a fitted model, physics alone, or the truth.
        samples: of the model's posterior, none or at least two: where they disagree,
            time costs more.
        risk_aversion: cost of time where their spread is as great as the thrust.

    Raises:
        InputError: the task cannot be done with the model: see `time_to_go`.
    """
    check_places(task)
    tables = tabulate_model(task, model, samples=samples, risk_aversion=risk_aversion)
    predictor = tables.predictor
    steered = _undelayed_controller(task, model, tables)
    timing = Timing(task.step, task.delay)
    # The filter stands outside: it must see observations as they are, not ahead.
    if task.delay > 0:
        steered = DelayCompensation(steered, predictor, timing)
    if task.sensor_noise > 0:
        steered = StateEstimation(
            steered,
            predictor,
            timing,
            noise=task.noise,
            sensor_noise=task.sensor_noise,
            dim=task.dim,
        )
    return steered


def _undelayed_controller(
    task: Task, model: SteeredSwimmer, tables: TabulatedModel
) -> AbstractController:
    """The controller without delay and with a good sensor."""

    def predict(steps: int) -> TrajectoryPrediction:
        return TrajectoryPrediction(
            tables.predictor, tables.control_map, task.step, steps
        )

    if isinstance(task.objective, ReachGoal):
        plan = time_to_go(task, model, tables=tables)
        return PathIntegral(predict(STEPS), ArrivalCost(plan), GradientGuide(plan))
    cost = TrackingCost(task.objective, tables.time_cost)
    return GradientMPC(predict(TRACKING_STEPS), cost)


STEPS = 20
"""Steps that the control of an arrival looks ahead."""

TRACKING_STEPS = 10
"""Steps that the control of a path looks ahead."""
