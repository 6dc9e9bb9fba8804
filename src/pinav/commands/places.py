"""Points and discs as words of the command line."""

import math

from pinav.errors import InputError


def numbers(option: str, text: str, *counts: int) -> tuple[float, ...]:
    """Numbers with commas between them.

    Args:
        option: what the message calls them.
        text: such as "0.5,1".
        counts: how many there may be.

    Raises:
        InputError: they are not so many finite numbers.
    """
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in counts or not all(map(math.isfinite, values)):
        example = ",".join("123456"[: counts[0]])
        raise InputError(
            f"{option}: expected {' or '.join(map(str, counts))} numbers with commas "
            f"between them, such as {example}, got {text!r}"
        )
    return values
