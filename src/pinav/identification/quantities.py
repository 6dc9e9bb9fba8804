"""How the report of an identification names the numbers that it estimates."""

from typing import NamedTuple


class Quantity(NamedTuple):
    """An estimated number as a reader knows it.

    Attributes:
        title: its name in the table.
        unit: with `{length}` and `{time}` for those of the recording.
        meaning: a phrase; empty where the title says all.
        positive: its logarithm was fitted.
    """

    title: str
    unit: str
    meaning: str = ""
    positive: bool = False


SPEED = "{length}/{time}"

QUANTITIES = {
    "gain": Quantity("gain", "{length}", "displacement per turn of the field"),
    "gain x/y": Quantity("gain x/y", "1", "ratio of the gains along both axes"),
    "heading offset": Quantity(
        "heading offset", "rad", "angle from the commanded heading to the motion"
    ),
    "corner": Quantity(
        "corner frequency", "Hz", "where the gain begins to fall", positive=True
    ),
    "residual": Quantity(
        "residual gain", "1", "part that remains far above the corner frequency"
    ),
    "delay": Quantity("delay", "{time}", "from a command to its effect"),
    "lag": Quantity(
        "lag",
        "{time}",
        "time constant with which the motion follows the command",
        positive=True,
    ),
    "drift x": Quantity("drift x", SPEED),
    "drift y": Quantity("drift y", SPEED),
    "still": Quantity(
        "wandering without a command",
        SPEED,
        "standard deviation of the wandering velocity",
        positive=True,
    ),
    "driven": Quantity(
        "wandering under a command",
        SPEED,
        "what a command of 1 Hz adds to it, in quadrature",
        positive=True,
    ),
    "memory": Quantity(
        "memory of the wandering", "{time}", "its correlation time", positive=True
    ),
    "noise": Quantity(
        "position error",
        "{length}",
        "of the mean position of a block of time",
        positive=True,
    ),
    "slow": Quantity(
        "changing drift", SPEED, "standard deviation of its velocity", positive=True
    ),
    "slow memory": Quantity(
        "memory of the changing drift",
        "{time}",
        "its correlation time",
        positive=True,
    ),
    "gain wander": Quantity(
        "wandering of the gain",
        "{length}",
        "its standard deviation, along the heading and across",
        positive=True,
    ),
    "gain memory": Quantity(
        "memory of the gain", "{time}", "its correlation time", positive=True
    ),
}
"""By the names of the estimates."""
