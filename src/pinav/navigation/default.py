"""The controller that a task gets unless another is asked for."""

from collections.abc import Sequence

from pinav.navigation.controllers import AbstractController
from pinav.navigation.costs import ArrivalCost
from pinav.navigation.courses import Courses, Downhill
from pinav.navigation.mppi import PathIntegral
from pinav.navigation.plan import time_to_go
from pinav.navigation.steering import SteeredSwimmer
from pinav.navigation.task import Task
from pinav.navigation.terrain import terrain


def controller(
    task: Task,
    model: SteeredSwimmer,
    *,
    samples: Sequence[SteeredSwimmer] = (),
    aversion: float = 4.0,
) -> AbstractController:
    """Plan and control a task with a model: the truth of the task is not used.

    Args:
        task: what is to be done, and within which limits.
        model: what is believed: a fitted model, physics alone, or the truth.
        samples: of the model's posterior, none or at least two: where they disagree,
            time costs more.
        aversion: cost of time where their spread is as great as the thrust.

    Raises:
        InputError: the task cannot be done with the model: see `time_to_go`.
    """
    ground = terrain(task, model, samples=samples, aversion=aversion)
    plan = time_to_go(task, model, ground=ground)
    courses = Courses(ground.predictor, ground.drive, task.step)
    return PathIntegral(courses, ArrivalCost(plan), Downhill(plan))
