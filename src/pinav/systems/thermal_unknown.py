"""The unknown in thermal motion in a file, in the words of `pinav fit`."""

import dataclasses

import equinox as eqx

from pinav.errors import InputError
from pinav.systems.codec import TOML, Context, decode, number

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
    def of_table(cls, table: TOML, context: Context) -> "ThermalUnknown":
        """The settings of the table [unknown]; its `period` is a table of numbers.

        Raises:
            InputError: a value is none that the key may have.
        """
        periods = table.get("period", {})
        if not isinstance(periods, dict):
            raise InputError(
                "unknown.period: expected numbers by coordinate, such as "
                f"{{ x = 6.2832 }}, got {periods!r}"
            )
        words = [
            f"{name}={number(f'unknown.period.{name}', one)!r}"
            for name, one in periods.items()
        ]
        kinds = {field.name: field.type for field in dataclasses.fields(cls)}
        stated = {**table, "period": words}
        return cls(
            **{
                name: decode(f"unknown.{name}", kinds[name], value, context)
                for name, value in stated.items()
            }
        )

    def table(self) -> TOML:
        """The table [unknown] that states it."""
        values = {name: value for name, value in vars(self).items() if value}
        for name in ("coordinates", "warp"):
            if name in values:
                values[name] = list(values[name])
        if self.period:
            values["period"] = dict(map(split_period, self.period))
        return values


FIELDS = tuple(ThermalUnknown.__dataclass_fields__)
"""Keys of [unknown] beside the model."""
