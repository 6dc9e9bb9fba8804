"""What functions take for numbers: whole ones count, and lists are arrays."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

Number = float | int
"""One number that is never traced."""

Numbers = Sequence[Any] | np.ndarray | jax.Array
"""Several, nested lists among them."""

Field = Float[Array, "..."]
"""A number for each cell of a grid."""
