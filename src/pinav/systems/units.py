"""Units of length, time and force in which a system states its numbers."""

import equinox as eqx

from pinav.errors import InputError

LENGTHS = ("1", "nm", "um", "mm", "cm", "m", "px", "?")
"""Units of length; "1" is dimensionless, "?" unknown."""

TIMES = ("1", "us", "ms", "s", "min", "h", "frame", "?")
"""Units of time."""

FORCES = ("1", "fN", "pN", "nN", "uN", "mN", "N", "?")
"""Units of force, for systems without inertia."""


def velocity_unit(length: str, time: str) -> str:
    """Unit of a velocity; unknown where either is."""
    if "?" in (length, time):
        return "?"
    return length if time == "1" else f"{length}/{time}"


class Units(eqx.Module):
    """Units of length, time and force.

    Attributes:
        length: one of `LENGTHS`.
        time: one of `TIMES`.
        force: one of `FORCES`; a swimmer with inertia has accelerations instead.

    Raises:
        InputError: a unit is none of those.
    """

    length: str = eqx.field(static=True, default="1")
    time: str = eqx.field(static=True, default="1")
    force: str = eqx.field(static=True, default="1")

    def __check_init__(self) -> None:
        for name, known in (("length", LENGTHS), ("time", TIMES), ("force", FORCES)):
            if (unit := getattr(self, name)) not in known:
                raise InputError(
                    f"units.{name}: expected one of {', '.join(known)}; got {unit!r}"
                )

    @property
    def velocity(self) -> str:
        """Unit of velocity."""
        return velocity_unit(self.length, self.time)

    def of_channels(self, channels: tuple[str, ...]) -> dict[str, str]:
        """Unit of each channel, x or vx, and of time `t`."""
        units = {
            name: self.velocity if name.startswith("v") else self.length
            for name in channels
        }
        return {**units, "t": self.time}
