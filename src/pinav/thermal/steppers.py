r"""How temperature advances, and laws that jump, of which no method has a slope.

`RKL2` is explicit, for grids of any dimension, `Rosenbrock` implicit along one axis.
Both evaluate perfusion at every stage and are of second order, also where the power
changes with time.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar, check_range
from pinav.errors import InputError
from pinav.settings import POSITIVE
from pinav.thermal.bioheat import (
    COLDEST,
    WARMEST,
    Bioheat,
    HeatBalance,
    Rates,
    fastest_rate,
)
from pinav.thermal.perfusion import BLEND, AbstractPerfusion
from pinav.thermal.quantities import Field, Number, Numbers

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
        check_range(self, POSITIVE, "longest")

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


LOOKED_INTO, PARTS = 8, 101
"""Intervals of temperature with the largest changes, and points within each."""

POINTS = LOOKED_INTO * PARTS
"""Temperatures at which a law is looked at, half of `BLEND` apart."""

SUDDEN = 0.05
"""Share of the change nearby that a jump has within half a millikelvin; of a law that
rises over `BLEND` it is 0.005."""

SMALLEST_JUMP = 1e-4
"""Share of the largest perfusion below which no jump counts: it changes no temperature
that is measured."""


def refuse_jumps(model: Bioheat) -> None:
    """Refuse a model whose perfusion jumps at some temperature.

    Raises:
        InputError: it does.
    """
    law, shape = model.perfusion, model.grid.shape
    edges = np.linspace(COLDEST, WARMEST, POINTS)
    coarse, largest = map(np.asarray, _changes(law, shape, edges))
    steepest = np.argsort(coarse)[-LOOKED_INTO:]
    nearby = np.convolve(coarse, np.ones(3), mode="same")[steepest]
    places = np.linspace(edges[steepest], edges[steepest + 1], PARTS, axis=1)
    fine, _ = map(np.asarray, _changes(law, shape, places.reshape(-1)))
    # the last change of a row leads to another interval
    changes = np.append(fine, 0.0).reshape(LOOKED_INTO, PARTS)[:, :-1]
    sudden = changes > np.maximum(SUDDEN * nearby, SMALLEST_JUMP * largest)[:, None]
    if sudden.any():
        place = np.unravel_index(np.argmax(sudden * changes), changes.shape)
        raise InputError(
            f"perfusion: expected a law without jumps, got one that changes by "
            f"{changes[place]:.3g} kg/(m³ s) at {places[place]:.2f} °C; no derivative "
            f"sees a jump: let it rise over {BLEND:g} K"
        )


@eqx.filter_jit
def _changes(
    law: AbstractPerfusion, shape: tuple[int, ...], temperatures: Numbers
) -> tuple[Float[Array, " interval"], Float[Array, ""]]:
    """Largest change of any cell from one temperature to the next, and its largest."""

    def step(before: Array, celsius: Array) -> tuple[Array, tuple[Array, Array]]:
        after = law(jnp.full(shape, celsius))
        return after, (jnp.max(jnp.abs(after - before)), jnp.max(after))

    at = jnp.asarray(temperatures, float)
    first = law(jnp.full(shape, at[0]))
    _, (changes, values) = jax.lax.scan(step, first, at[1:])
    return changes, jnp.max(values)


GAMMA = 1 - 1 / np.sqrt(2.0)
"""For which the method is L-stable."""


class Rosenbrock(AbstractStepper):
    r"""The two-stage Rosenbrock method ROS2, linearly implicit and L-stable.

    $(1 - \gamma\Delta t J) k_1 = f(T) + \gamma\Delta t f_t$ and
    $(1 - \gamma\Delta t J) k_2 = f(T + \Delta t k_1) - 2 k_1 - \gamma\Delta t f_t$,
    $\gamma = 1 - 1/\sqrt2$, change $\Delta t (3 k_1 + k_2)/2$. Two tridiagonal solves
    and no iteration, whatever the perfusion; it does not ring after a switch, so that
    no starting steps are needed. For radial grids.

    Attributes:
        longest: time step [s].

    Raises:
        InputError: `longest` is not positive.

    References:
        Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci. Comput. 20, 1456 (1999).
    """

    longest: Number = eqx.field(static=True, default=7.5)

    def __check_init__(self) -> None:
        check_range(self, POSITIVE, "longest")

    @property
    def nodes(self) -> Float[np.ndarray, " node"]:
        return np.array([0.0, 1.0])

    def longest_step(self, model: Bioheat) -> float:
        axes = len(model.grid.shape)
        if axes != 1:
            raise InputError(
                f"Rosenbrock: expected a grid with one axis, got {axes}; use RKL2()"
            )
        return self.longest

    def change(
        self, balance: HeatBalance, temperature: Field, dt: Scalar, levels: Levels
    ) -> Rates:
        level, later = levels

        def rates(at: Field) -> Rates:
            return balance.rates(at, level)

        def solve(right: Field) -> Field:
            # both stages share one matrix, that at the begin: ROS2 keeps its order
            scaled = capacity * right
            return balance.solve(capacity + weight * slope, scaled, conduct=weight)

        weight, capacity = GAMMA * dt, 1 / balance.inverse_capacity
        slope = balance.sink_slope(temperature) * balance.volumes
        # How the sources change over the step, without which a Rosenbrock method loses
        # its order where the rates depend on time.
        heating = GAMMA * (balance.heating(later) - balance.heating(level))
        brought = jnp.zeros(3).at[0].set(jnp.sum(heating))
        drift = Rates(heating * balance.inverse_capacity, brought)
        start, along = jax.linearize(rates, temperature)
        k1 = solve(start.temperature + drift.temperature)
        end = balance.rates(temperature + dt * k1, later)
        k2 = solve(end.temperature - 2 * k1 - drift.temperature)
        # heat flows are further components of the same stages, so that they balance
        e1 = start.energy + weight * along(k1).energy + drift.energy
        e2 = end.energy + weight * along(k2).energy - drift.energy - 2 * e1
        return Rates(0.5 * dt * (3 * k1 + k2), 0.5 * dt * (3 * e1 + e2))
