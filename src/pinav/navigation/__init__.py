"""Planning and control of a swimmer whose environment was learned.

A task says what is to be done; a plan and a controller do it with a model; trials say
how well.
"""

from pinav.navigation.adaptive.flight import Flight as Flight
from pinav.navigation.adaptive.flight import FlightOutcome as FlightOutcome
from pinav.navigation.adaptive.flight import SwimmerFlights as SwimmerFlights
from pinav.navigation.adaptive.flight import fly as fly
from pinav.navigation.adaptive.flight import fly_swimmer as fly_swimmer
from pinav.navigation.adaptive.flight import judge_controllers as judge_controllers
from pinav.navigation.adaptive.steering import AdaptiveController as AdaptiveController
from pinav.navigation.comparison import AbstractNavigation as AbstractNavigation
from pinav.navigation.comparison import Attempt as Attempt
from pinav.navigation.comparison import Navigation as Navigation
from pinav.navigation.comparison import OnlineNavigation as OnlineNavigation
from pinav.navigation.comparison import compare_models as compare_models
from pinav.navigation.comparison import navigate as navigate
from pinav.navigation.control.controller import AbstractController as AbstractController
from pinav.navigation.control.controller import ArrivalCost as ArrivalCost
from pinav.navigation.control.controller import GradientGuide as GradientGuide
from pinav.navigation.control.controller import Observation as Observation
from pinav.navigation.control.controller import StraightLine as StraightLine
from pinav.navigation.control.controller import TrackingCost as TrackingCost
from pinav.navigation.control.controller import (
    TrajectoryPrediction as TrajectoryPrediction,
)
from pinav.navigation.control.default import DelayCompensation as DelayCompensation
from pinav.navigation.control.default import StateEstimation as StateEstimation
from pinav.navigation.control.default import controller as controller
from pinav.navigation.control.mppi import GradientMPC as GradientMPC
from pinav.navigation.control.mppi import PathIntegral as PathIntegral
from pinav.navigation.design.candidates import Experiment as Experiment
from pinav.navigation.design.candidates import Stage as Stage
from pinav.navigation.design.candidates import Suggestion as Suggestion
from pinav.navigation.design.candidates import suggest_next as suggest_next
from pinav.navigation.planning.plan import Route as Route
from pinav.navigation.planning.plan import TimeToGo as TimeToGo
from pinav.navigation.planning.plan import time_to_go as time_to_go
from pinav.navigation.predictors import TabulatedModel as TabulatedModel
from pinav.navigation.predictors import TimeCost as TimeCost
from pinav.navigation.predictors import tabulate_model as tabulate_model
from pinav.navigation.problem import NavigationProblem as NavigationProblem
from pinav.navigation.problem import episode_keys as episode_keys
from pinav.navigation.task.catalogue import TASKS as TASKS
from pinav.navigation.task.catalogue import Way as Way
from pinav.navigation.task.catalogue import task as task
from pinav.navigation.task.catalogue import training as training
from pinav.navigation.task.steering import AbstractActuator as AbstractActuator
from pinav.navigation.task.steering import CommandLimits as CommandLimits
from pinav.navigation.task.steering import RollingActuator as RollingActuator
from pinav.navigation.task.steering import SteeredSwimmer as SteeredSwimmer
from pinav.navigation.task.steering import physics_only as physics_only
from pinav.navigation.task.task import AbstractObjective as AbstractObjective
from pinav.navigation.task.task import AbstractPath as AbstractPath
from pinav.navigation.task.task import AbstractZone as AbstractZone
from pinav.navigation.task.task import Behind as Behind
from pinav.navigation.task.task import CirclePath as CirclePath
from pinav.navigation.task.task import Course as Course
from pinav.navigation.task.task import Disc as Disc
from pinav.navigation.task.task import FigureEightPath as FigureEightPath
from pinav.navigation.task.task import FollowPath as FollowPath
from pinav.navigation.task.task import LinePath as LinePath
from pinav.navigation.task.task import ReachGoal as ReachGoal
from pinav.navigation.task.task import Rectangle as Rectangle
from pinav.navigation.task.task import Task as Task
from pinav.navigation.task.task import Wall as Wall
from pinav.navigation.task.task import steered_swimmer as steered_swimmer
from pinav.navigation.trials.closed_loop import Episodes as Episodes
from pinav.navigation.trials.closed_loop import (
    concatenate_episodes as concatenate_episodes,
)
from pinav.navigation.trials.closed_loop import run as run
from pinav.navigation.trials.closed_loop import run_many as run_many
from pinav.navigation.trials.metrics import Interval as Interval
from pinav.navigation.trials.metrics import Quantiles as Quantiles
from pinav.navigation.trials.metrics import Summary as Summary
from pinav.navigation.trials.metrics import proportion as proportion
from pinav.navigation.trials.metrics import regret as regret
from pinav.navigation.trials.metrics import summary as summary
