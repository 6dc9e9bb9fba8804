"""A task of `pinav heat`: checked when it is made, computed when it is run."""

import abc
import dataclasses

import numpy as np

from pinav.commands.heat.metrics import HeatMetrics
from pinav.thermal.images import Image
from pinav.thermal.probes import ProbeData

RESULTS = "results.npz"
READINGS = "probes.csv"
IMAGES = ("temperature", "dose", "dead", "frame/reading", "frame/fit")
"""Arrays that are written as NIfTI, too, where the labels are; a file is named for the
last word."""


@dataclasses.dataclass(frozen=True)
class TaskResult:
    """What a task computed.

    Attributes:
        metrics: numbers for tables and scripts.
        arrays: what the figures show.
        readings: of the case's probes, if it has any.
        image: of the case's voxels, if it has any.
    """

    metrics: HeatMetrics
    arrays: dict[str, np.ndarray]
    readings: ProbeData | None = None
    image: Image | None = None


class AbstractTask(abc.ABC):
    """A task of one case.

    Whatever can be refused is refused when a task is made, before a folder exists.
    """

    @abc.abstractmethod
    def run(self) -> TaskResult:
        """Compute.

        Raises:
            FitError: no result was found.
        """
