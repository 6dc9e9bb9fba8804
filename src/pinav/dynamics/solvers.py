"""Solvers as values: how y' = f(t, y) is integrated and how its gradient is taken.

| solver | forward | gradient |
|---|---|---|
| `FixedStep` | one explicit Runge-Kutta step per sample | discretise, then optimise |
| `Adaptive` | diffrax at a tolerance | that of its diffrax adjoint |
| `ForwardOnly` | the steps of `Adaptive` | none in reverse |
"""

import abc
from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Bool, Float

from pinav.arguments import Scalar, State

VectorField = Callable[[Scalar, State], State]
"""Right-hand side f(t, y); a pytree, so that its leaves can be differentiated."""


Times = Float[Array, " time"]
"""Times at which the state is saved [T]."""


Path = tuple[Float[Array, "time state"], Bool[Array, ""]]
"""States at the times, and whether the solver reached the last of them."""


class AbstractSolver(eqx.Module):
    """Integrates a vector field from `ts[0]` and saves the state at every time."""

    @abc.abstractmethod
    def solve(self, vector_field: VectorField, y0: State, ts: Times) -> Path:
        """States at `ts` [T], and whether the solver reached the last of them.

        It reached the last time also when the states on the way are not finite.
        """
