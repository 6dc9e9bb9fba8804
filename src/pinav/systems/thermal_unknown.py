"""The unknown in thermal motion in a file, in the words of `pinav fit`."""

from typing import Any

import equinox as eqx

from pinav.errors import InputError
from pinav.systems.codec import TOML

DIFFUSIONS = ("constant", "field", "tensor")
"""Forms of the diffusion."""

OBSERVATIONS = ("exact", "learn", "known")
"""Knowledge of the camera."""


def split_period(text: str) -> tuple[str, float]:
    """Coordinate and period of a text such as `x=6.2832`.

    Raises:
        InputError: it is no such text, or the period is no number > 0.
    """
    name, separator, number = text.partition("=")
    try:
        period = float(number)
    except ValueError:
        period = 0.0
    if not (name and separator and 0 < period < float("inf")):
        raise InputError(
            f"--period: expected a coordinate and a number > 0, such as x=6.2832, got "
            f"{text!r}"
        )
    return name, period


class ThermalUnknown(eqx.Module):
    """Settings of the unknown in thermal motion, as of `pinav fit`.

    Attributes:
        coordinates: coordinates of force and diffusion; all by default.
        period: such as "x=6.2832", of coordinates that repeat.
        warp: coordinates whose kernels are fine where motion is slow.
        reference: the coordinate whose zero drifts slowly.

    Raises:
        InputError: a word is unknown, or a period is none.
    """

    diffusion: str | None = eqx.field(static=True, default=None)
    observation: str | None = eqx.field(static=True, default=None)
    coordinates: tuple[str, ...] = eqx.field(static=True, default=())
    period: tuple[str, ...] = eqx.field(static=True, default=())
    warp: tuple[str, ...] = eqx.field(static=True, default=())
    reference: str | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        for name, known in (("diffusion", DIFFUSIONS), ("observation", OBSERVATIONS)):
            word = getattr(self, name)
            if word not in (None, *known):
                raise InputError(
                    f"unknown.{name}: expected one of {', '.join(known)}; got {word!r}"
                )
        for text in self.period:
            split_period(text)

    @classmethod
    def of_table(cls, table: TOML) -> "ThermalUnknown":
        """The settings of the table [unknown]; its `period` is a table of numbers.

        Raises:
            InputError: a value is none that the key may have.
        """
        values = dict(table)
        if "period" in values:
            values["period"] = _periods(values["period"])
        for name in ("coordinates", "warp"):
            if name in values:
                values[name] = _names(name, values[name])
        for name in ("diffusion", "observation", "reference"):
            if not isinstance(values.get(name, ""), str):
                raise InputError(
                    f"unknown.{name}: expected a word, got {values[name]!r}"
                )
        return cls(**values)

    def table(self) -> TOML:
        """The table [unknown] that states it."""
        values = {name: value for name, value in vars(self).items() if value}
        for name in ("coordinates", "warp"):
            if name in values:
                values[name] = list(values[name])
        if self.period:
            values["period"] = dict(map(split_period, self.period))
        return values


def _periods(value: Any) -> tuple[str, ...]:
    if not isinstance(value, dict) or not all(
        isinstance(number, float | int) for number in value.values()
    ):
        raise InputError(
            "unknown.period: expected numbers by coordinate, such as { x = 6.2832 }, "
            f"got {value!r}"
        )
    return tuple(f"{name}={float(number)!r}" for name, number in value.items())


def _names(key: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
        raise InputError(
            f'unknown.{key}: expected names of coordinates, such as ["z"], got '
            f"{value!r}"
        )
    return tuple(value)


FIELDS = tuple(ThermalUnknown.__dataclass_fields__)
"""Keys of [unknown] beside the model."""
