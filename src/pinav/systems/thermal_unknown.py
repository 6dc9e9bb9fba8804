"""The unknown in thermal motion in a file, in the words of `pinav fit`."""

from typing import Any

import equinox as eqx
import msgspec

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
        values = {name: _checked(name, value) for name, value in table.items()}
        if "period" in values:
            periods = values["period"].items()
            values["period"] = tuple(f"{name}={one!r}" for name, one in periods)
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


_FORMS: dict[str, tuple[Any, str]] = {
    **dict.fromkeys(("diffusion", "observation", "reference"), (str, "a word")),
    **dict.fromkeys(
        ("coordinates", "warp"),
        (tuple[str, ...], 'names of coordinates, such as ["z"]'),
    ),
    "period": (dict[str, float], "numbers by coordinate, such as { x = 6.2832 }"),
}
"""Type of the value of each key in a file, and words for it."""


def _checked(name: str, value: Any) -> Any:
    kind, words = _FORMS[name]
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"unknown.{name}: expected {words}, got {value!r}") from error


FIELDS = tuple(ThermalUnknown.__dataclass_fields__)
"""Keys of [unknown] beside the model."""
