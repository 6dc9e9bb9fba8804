"""Perfusion laws that jump: no derivative sees a jump, so fits and plans miss it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.errors import InputError
from pinav.thermal.bioheat import COLDEST, WARMEST, Bioheat
from pinav.thermal.perfusion import BLEND, AbstractPerfusion
from pinav.thermal.quantities import Numbers

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
