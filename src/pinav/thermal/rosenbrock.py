r"""The implicit method for grids with one axis, and laws that jump."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import COLDEST, WARMEST, Bioheat, HeatBalance, Rates
from pinav.thermal.perfusion import BLEND, AbstractPerfusion
from pinav.thermal.quantities import Field, Number, Numbers
from pinav.thermal.steppers import AbstractStepper, Levels, check_step

LOOKED_INTO, PARTS = 8, 101
"""Intervals of temperature with the largest changes, and points within each."""

POINTS = LOOKED_INTO * PARTS
"""Temperatures at which a law is looked at, half of `BLEND` apart."""

SUDDEN = 0.05
"""Share of the change nearby that a jump has within half a millikelvin; of a law that
rises over `BLEND` it is 0.005."""

SMALLEST_JUMP = 1e-4
"""Of the largest perfusion; less changes no temperature that is measured."""


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
        check_step("Rosenbrock.longest", self.longest)

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
