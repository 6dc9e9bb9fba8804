"""The drive of a robot, estimated while it is recorded."""

from pinav.identification.running.bank import DriveGrid as DriveGrid
from pinav.identification.running.forecast import DriveForecast as DriveForecast
from pinav.identification.running.forecast import forecast as forecast
from pinav.identification.running.running_fit import RunningFit as RunningFit
