"""Points and discs as words of the command line."""

import math

from pinav.errors import InputError


def numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    """Numbers with commas between them.

    Args:
        option: what the message calls them.
        text: such as "0.5,1".
        count: how many are expected.

    Raises:
        InputError: they are not so many finite numbers.
    """
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        example = ",".join("1234"[:count])
        raise InputError(
            f"{option}: expected {count} numbers with commas between them, such as "
            f"{example}, got {text!r}"
        )
    return values
