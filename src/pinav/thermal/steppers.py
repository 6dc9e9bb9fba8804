r"""How temperature advances, and `RKL2`: explicit, for grids of any dimension.

`Rosenbrock`, implicit along one axis, is in `rosenbrock`. Both evaluate perfusion at
every stage and are of second order, also where the power changes with time.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat, HeatBalance, Rates, fastest_rate
from pinav.thermal.quantities import Field, Number

Levels = Float[Array, "node source"]
"""Levels of the sources at the nodes of a step."""

MARGIN = 0.9
"""Of the stability limit that is used."""

LONGEST = 10.0
"""Time step [s] beyond which nothing is chosen for stability's sake alone."""

STAGES = (3, 5, 7, 9, 11, 13, 15)
"""Numbers of stages among which is chosen."""


class AbstractStepper(eqx.Module):
    """A one-step method."""

    @property
    @abc.abstractmethod
    def nodes(self) -> Float[np.ndarray, " node"]:
        """Times within a step, as shares of it, at which sources are evaluated."""

    @abc.abstractmethod
    def longest_step(self, model: Bioheat) -> float:
        """Longest time step [s] to take."""

    @abc.abstractmethod
    def change(
        self, balance: HeatBalance, temperature: Field, dt: Scalar, levels: Levels
    ) -> Rates:
        """Change of the temperature [K] and heat flows [J] over a step of `dt` [s]."""


class RKL2(AbstractStepper):
    r"""Runge-Kutta-Legendre super-time-stepping of second order.

    With $s$ stages stable up to $\Delta t = (2/\lambda_{max})(s^2+s-2)/4$: the step
    grows with the square of the work. Stages run in a scan, because XLA recomputes
    stencils that are written out one after the other.

    Attributes:
        stages: $s$, odd, at least 3.
        longest: time step [s]; unless given, 10 s or as much as is stable, whichever is
            less.

    Raises:
        InputError: `stages` is even or below 3.

    References:
        Meyer, Balsara and Aslam, J. Comput. Phys. 257, 594 (2014).
    """

    stages: int = eqx.field(static=True, default=9)
    longest: Number | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if self.stages < 3 or self.stages % 2 == 0:
            raise InputError(f"RKL2.stages: expected odd and >= 3, got {self.stages}")
        check_step("RKL2.longest", self.longest)

    @classmethod
    def for_model(cls, model: Bioheat) -> "RKL2":
        """The number of stages that covers a time with the fewest evaluations."""
        rate = float(fastest_rate(model))

        def cost(stages: int) -> float:
            return stages / min(MARGIN * _stable_step(stages, rate), LONGEST)

        return cls(min(STAGES, key=cost))

    @classmethod
    def for_step(cls, model: Bioheat, longest: Number) -> "RKL2":
        """The fewest stages with which a time step [s] is stable, nine if none are."""
        rate = float(fastest_rate(model))
        enough = [s for s in STAGES if longest <= MARGIN * _stable_step(s, rate)]
        return cls(min(enough, default=9), longest)

    @property
    def nodes(self) -> Float[np.ndarray, " node"]:
        s = self.stages
        j = np.arange(s)
        c = (j**2 + j - 2) / (s**2 + s - 2)
        # c_2/4, often used for the first stage, would cost the second order
        c[:2] = 0.0, 4 / (3 * (s**2 + s - 2))
        return c

    def longest_step(self, model: Bioheat) -> float:
        limit = _stable_step(self.stages, float(fastest_rate(model)))
        if self.longest is None:
            return min(MARGIN * limit, LONGEST)
        if self.longest > limit:
            raise InputError(
                f"RKL2.longest: expected <= {limit:.4g} s, which {self.stages} stages "
                f"hold stable on this grid, got {self.longest:g} s; take more stages "
                "or a shorter step"
            )
        return self.longest

    def change(
        self, balance: HeatBalance, temperature: Field, dt: Scalar, levels: Levels
    ) -> Rates:
        rows, first = _rkl2_coefficients(self.stages)
        # heat flows are further components of the same stages, so that they balance
        initial = Rates(temperature, jnp.zeros(3))
        start = balance.rates(temperature, levels[0])
        after = jax.tree.map(lambda y, r: y + first * dt * r, initial, start)

        def stage(
            carry: tuple[Rates, Rates], inputs: PyTree
        ) -> tuple[tuple[Rates, Rates], None]:
            (mu, nu, rest, of_slope, of_start), level = inputs
            last, before = carry
            slope = balance.rates(last.temperature, level)

            def combine(
                y: Array, y_before: Array, y0: Array, rate: Array, rate0: Array
            ) -> Array:
                drift = dt * (of_slope * rate + of_start * rate0)
                return mu * y + nu * y_before + rest * y0 + drift

            following = jax.tree.map(combine, last, before, initial, slope, start)
            return (following, last), None

        (end, _), _ = jax.lax.scan(stage, (after, initial), (rows, levels[1:]))
        return Rates(end.temperature - temperature, end.energy)


def _stable_step(stages: int, rate: float) -> float:
    return 0.5 * (stages**2 + stages - 2) / rate


def _rkl2_coefficients(s: int) -> tuple[Any, float]:
    """Coefficients of the stages 2 to s, one row for each, and that of the first."""
    j = np.arange(s + 1.0)
    # The first three are equal: a choice that the order leaves free.
    b = np.where(j < 3, 1 / 3, (j**2 + j - 2) / np.where(j < 1, 1, 2 * j * (j + 1)))
    w = 4 / (s**2 + s - 2)
    j, b1, b2 = j[2:], b[1:-1], b[:-2]
    b0 = b[2:]
    mu = (2 * j - 1) / j * b0 / b1
    nu = -(j - 1) / j * b0 / b2
    mu_tilde = mu * w
    gamma = -(1 - b1) * mu_tilde  # weight of the slope at the begin of the step
    columns = np.stack([mu, nu, 1 - mu - nu, mu_tilde, gamma], axis=1)
    return jnp.asarray(columns), b[1] * w


def check_step(name: str, value: Number | None) -> None:
    """Refuse a time step [s] that is not positive."""
    if value is not None and not 0 < value < np.inf:
        raise InputError(f"{name}: expected a time > 0 s, got {value}")
