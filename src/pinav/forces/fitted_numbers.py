"""Constants of laws as fits reach them: numbers without bounds."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.arguments import Scalar

Starts = Float[np.ndarray, " start"]

SIZES, PLACES = 10, 16
"""Sizes and places of a law that are tried."""

HALVES = 8
"""Widths of a channel that are tried."""

BEYOND = 0.2
"""Distance beyond the data, over their extent, where a law may be placed at first."""


class Span(NamedTuple):
    """The coordinates of data, along which a law may start.

    Attributes:
        low: least coordinate [L].
        extent: from the least to the greatest one [L].
        width: of a kernel [L].
        shortest: period of the shortest wave [L].
        is_distance: True if the coordinate is one from a point, so that none is below.
    """

    low: float
    extent: float
    width: float
    shortest: float
    is_distance: bool

    def places(self) -> Starts:
        """Places within the data and beyond them [L]."""
        first = 0.0 if self.is_distance else -BEYOND
        return self.low + self.extent * np.linspace(first, 1 + BEYOND, PLACES)

    def halves(self) -> Starts:
        """Half widths of a channel [L]."""
        return np.linspace(0.0, 0.6, HALVES + 1)[1:] * self.extent

    def sizes(self) -> Starts:
        """Logarithms of the distances over which a potential may fall."""
        longest = max(0.5 * self.extent, 2 * self.width)
        return np.log(np.geomspace(self.width, longest, SIZES))

    def waves(self) -> Starts:
        """Logarithms of the lengths by which a radian of a wave is long."""
        # between neighbouring waves the phase at the rim of the data differs little
        turns = np.arange(1.0, self.extent / self.shortest, 0.5)
        return np.log(self.extent / (2 * np.pi * turns))


class Number(NamedTuple):
    """A number without bounds, of which a constant of a law is a function.

    Attributes:
        name: of the constant in tables.
        constant: of the number.
        starts: numbers from which a fit may start.
        reach: deviation of its prior in sizes of the law, where the constant is a
            length as it is; None of another number, whose deviation is one.
    """

    name: str
    constant: Callable[[Scalar], Scalar]
    starts: Callable[[Span], Starts]
    reach: float | None = None


PLACE = Number("place", lambda number: number, Span.places, 2.0)
"""A place along the coordinate."""

SIZE = Number("size", jnp.exp, Span.sizes)
"""The logarithm of the distance over which a potential falls."""

PERIOD = Number("period", lambda number: 2 * jnp.pi * jnp.exp(number), Span.waves)
"""The logarithm of a period over a full turn."""

STEEPNESS = Number("steepness", jnp.exp, lambda _: np.array([-0.5, 0.5, 1.0]))
"""The logarithm of an exponent, which is one of a Gaussian."""

FORM = Number(
    "tail",
    lambda number: 0.5 * jnp.expm1(number),
    lambda _: np.array([-1.0, 0.0, 1.1, 1.6]),
)
r"""$\log (1 + 2\kappa)$ of a tail, so that $\kappa > -1/2$ and forces are smooth."""
