"""The units of data, the order of the dynamics, and the unit of a force."""

import re
from collections.abc import Mapping
from fractions import Fraction

from pinav.errors import InputError

ORDER = "order"
"""Entry of the units that says of which order in time the dynamics are."""

FORCE = "force"
"""Entry of the units that says in which a force is, where that is no velocity."""


def with_order(
    units: Mapping[str, str], order: int, force: str = "1"
) -> Mapping[str, str]:
    """The units of data, and the order of the dynamics that were fitted to them.

    Args:
        units: of each channel.
        order: 2 where a force is an acceleration, 1 where it is a velocity.
        force: its unit where the mobility makes a velocity of it.
    """
    forces = {FORCE: force} if order == 1 and force != "1" else {}
    return {**units, ORDER: str(order), **forces}


def force_unit(units: Mapping[str, str], *, lengths: int = 1) -> str:
    """Unit of a mass-specific force, from those of position and time.

    A velocity for dynamics of first order (`with_order`) unless their mobility takes a
    force in a unit of its own, such as pN; else an acceleration; "?"
    where the data do not state a unit.

    Args:
        units: of each channel.
        lengths: power of the length; 2 for an energy.
    """
    return model_unit(f"L{lengths} T-2", units)


def model_unit(dimension: str, units: Mapping[str, str]) -> str:
    """The unit of a number of a model, from those of position and time.

    Args:
        dimension: of dynamics of second order, of which a mass-specific force is an
            acceleration, L T-2; without inertia that is a velocity L T-1, or a force F.
        units: of each channel, and the order (`with_order`).
    """
    words = dimension.split()
    if units.get(ORDER) == "1" and "T-2" in words:
        words.remove("T-2")
        words = ["F L-1", *words] if FORCE in units else [*words, "T-1"]
    length, time = units.get("x", "1"), units.get("t", "1")
    return unit_of(" ".join(words), {"L": length, "T": time, "F": units.get(FORCE, "")})


_POWER = re.compile(
    r"([^\W\d_]+|[1?])(?:(-?\d+(?:/[1-9]\d*)?)|\^\((-?\d+/[1-9]\d*)\))?"
)
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def powers_of(dimension: str) -> list[tuple[str, Fraction]]:
    """The symbols of a dimension such as "L2 T-1 Hz^(-1/4)", each with its power.

    Raises:
        InputError: a word is no symbol with a power.
    """
    powers = []
    for word in dimension.split():
        match = _POWER.fullmatch(word)
        if match is None:
            raise InputError(
                f"dimension {dimension!r}: expected powers of symbols, such as L2 T-1 "
                f"or Hz^(-1/4), got {word!r}"
            )
        powers.append((match[1], Fraction(match[2] or match[3] or 1)))
    return powers


def unit_of(dimension: str, units: Mapping[str, str]) -> str:
    """The unit of a quantity, such as "um² s⁻¹" of the dimension "L2 T-1".

    Args:
        dimension: powers of symbols such as L (length), T (time) and F (force), or of
            units that are no symbol, such as rad; "1" of a plain number, "?" unknown.
        units: by symbol; "1" is dimensionless.

    Returns:
        The unit; "1" where it has none, "?" where it is not known.
    """
    powers: dict[str, Fraction] = {}
    for symbol, power in powers_of(dimension):
        unit = units.get(symbol, symbol)
        if unit == "?":
            return "?"
        if unit != "1":
            powers[unit] = powers.get(unit, Fraction()) + power
    parts = [unit + _exponent(power) for unit, power in powers.items() if power]
    return " ".join(parts) or "1"


def _exponent(power: Fraction) -> str:
    if power.denominator > 1:
        return f"^({power})"
    return "" if power == 1 else str(power).translate(_SUPERSCRIPTS)
