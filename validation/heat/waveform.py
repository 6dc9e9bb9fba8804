"""A field that changes smoothly, for the orders of the steppers in time."""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float, Int

from pinav.arguments import Scalar
from pinav.thermal.protocols import AbstractProtocol


class Waveform(AbstractProtocol):
    """A smooth amplitude.

    Attributes:
        function: amplitude [A m⁻¹] at a time [s].
        edges: begin, times at which it is not smooth, and end [s].
        frequency: of the field [Hz].
    """

    function: Callable[[Float[Array, ""]], Float[Array, ""]]
    edges: tuple[float, ...] = eqx.field(static=True)
    frequency: Scalar

    def amplitude(
        self, t: Float[Array, ""], interval: Int[Array, ""]
    ) -> Float[Array, ""]:
        return self.function(t)
