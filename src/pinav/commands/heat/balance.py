"""The heat balance along a radius as numbers, which the explorer's page integrates."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.heat.build import CaseModel
from pinav.thermal.bioheat import Bioheat, HeatBalance
from pinav.thermal.protocols import Piecewise

WARMTH = np.linspace(15.0, 75.0, 241)
"""Temperatures [°C] at which the heat that blood takes is tabulated."""

AMPLITUDES = 65
"""Amplitudes at which the levels of the sources are tabulated, zero included."""

REACH = 1.5
"""The greatest amplitude of the table, in units of the protocol's."""


def balance_arrays(
    setup: CaseModel, model: Bioheat, protocol: Piecewise
) -> dict[str, np.ndarray]:
    """All that a run along a radius needs, by the names that the page knows.

    Args:
        setup: the case, for its start.
        model: the tissue.
        protocol: the field.
    """
    balance = HeatBalance.of(model)
    cells = balance.volumes.shape[0]
    ends = jnp.full((1,), float(model.blood.arterial))
    low, high = model.sides[0].outside(ends, ends)
    most = max(REACH * float(protocol.largest), 1.0)
    amplitudes = np.linspace(0.0, most, AMPLITUDES)

    def levels(amplitude: Float[Array, ""]) -> Float[Array, " source"]:
        each = [s.level(amplitude, protocol.frequency) for s in model.sources]
        return jnp.stack(each) if each else jnp.zeros(0)

    def sink(celsius: Float[Array, ""]) -> Float[Array, " cell"]:
        return balance.sink(jnp.full(cells, celsius)) * balance.volumes

    numbers = {
        "inverse_capacity": balance.inverse_capacity,
        "conductances": balance.conductances[0],
        "outside": jnp.stack([low.reshape(()), high.reshape(())]),
        "volumes": balance.volumes,
        "metabolic": balance.metabolic,
        "shapes": jnp.stack(balance.shapes),
        "amplitudes": amplitudes,
        "levels": jax.vmap(levels)(jnp.asarray(amplitudes)),
        "warmth": WARMTH,
        "sink": jax.vmap(sink)(jnp.asarray(WARMTH)),
        "start": setup.start.state(model).temperature,
    }
    return {f"balance/{name}": np.asarray(value) for name, value in numbers.items()}
