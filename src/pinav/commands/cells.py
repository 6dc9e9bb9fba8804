"""Numbers of results as JSON and tables hold them."""

import enum
import math
from typing import Any, TypeVar

import msgspec
import numpy as np

Cell = float | int | str | None
"""A score: None where it is not defined, "diverged" where it is infinite."""


def as_cell(value: float | int) -> Cell:
    """A number for JSON and tables: NaN is None, infinity the word "diverged"."""
    if isinstance(value, int):
        return value
    if math.isnan(value):
        return None
    return "diverged" if math.isinf(value) else float(value)


def percent(value: Cell) -> Cell:
    """A fraction in percent; what is no number stays as it is."""
    return 100 * value if isinstance(value, float) else value


Kind = TypeVar("Kind", bound="Row")


class Row(msgspec.Struct, frozen=True):
    """A result as a file holds it; a number that is not finite is none."""

    @classmethod
    def of(cls: type[Kind], value: Any, **others: Any) -> Kind:
        """The row of a value of the library that has the fields as attributes.

        Args:
            value: such as an estimate; the attributes of its parts are taken, too.
            others: fields that are no attributes of it.
        """
        names = (name for name in cls.__struct_fields__ if name not in others)
        content = {name: _builtin(getattr(value, name)) for name in names} | others
        row = msgspec.convert(content, cls, from_attributes=True)
        return msgspec.json.decode(msgspec.json.encode(row), type=cls)


def _builtin(value: Any) -> Any:
    """The word of an enumeration, or the number of a scalar of NumPy."""
    if isinstance(value, enum.Enum):
        return str(value.value)
    return value.item() if isinstance(value, np.generic) else value


class EstimateRow(Row, frozen=True):
    """A number that was learned.

    Attributes:
        value: its best value.
        sd: its standard deviation; none where the fit has no posterior.
    """

    value: float | None
    sd: float | None
