"""Media whose drag is not that of a fluid at rest: fibrous, porous, streaming."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from pinav.forces import (
    AbstractFlow,
    AbstractTensorField,
    BrinkmanTensor,
    ConstantDirector,
    InFlow,
    LinearDrag,
    PoiseuilleFlow,
    ShearFlow,
    TensorDrag,
    UniaxialTensor,
    WavyDirector,
)
from pinav.scenarios.crossings import DAMPING, MANY, RING, paper_swimmer, planar_system
from pinav.systems import RingStarts, System


def anisotropic_drag(
    key: PRNGKeyArray | None = None, count: int | None = None
) -> System:
    """The paper's barrier in aligned fibres, at 30 degrees to the x axis.

    The drag is 0.24 along and 0.48 across them; the ratio of 2 is that of slender
    bodies. Starts, thrust, times and noise are those of `barrier_crossings`. Expected:
    swimmers turn towards the fibres while they slow down.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
        count: number of trajectories; 8 unless given.
    """
    tensor = UniaxialTensor(0.24, 0.48, ConstantDirector(np.pi / 6))
    return _scenario("anisotropic-drag", tensor, key, count)


def varying_director(
    key: PRNGKeyArray | None = None, count: int | None = None
) -> System:
    """As `anisotropic_drag`, with a director that sways by 45 degrees about 30.

    It sways along x with a wavelength of 12. Expected: no constant tensor explains the
    data.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
        count: number of trajectories; 16 unless given.
    """
    director = WavyDirector(np.pi / 6, np.pi / 4, [2 * np.pi / 12, 0.0])
    tensor = UniaxialTensor(0.24, 0.48, director)
    return _scenario("varying-director", tensor, key, count, MANY)


def porous(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
    """The paper's barrier with four dense regions of a gel around it.

    Brinkman drag: 0.36 in the clear fluid, 2.8 times that in the middle of a region of
    width 1.5, where the swimmer's radius is 1.5 screening lengths. Starts, thrust,
    times and noise are those of `barrier_crossings`. Expected: swimmers that enter a
    dense region slow down there and leave it late.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
        count: number of trajectories; 16 unless given.
    """
    tensor = BrinkmanTensor(
        clear=DAMPING,
        radius=0.5,
        screening=jnp.full(4, 3.0),
        centers=jnp.array([[1.0, 3.0], [8.0, 1.0], [9.5, 7.5], [3.0, 9.5]]),
        width=1.5,
    )
    return _scenario("porous", tensor, key, count, MANY)


def shear(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
    """The paper's barrier in a shear flow of rate 0.06, at rest on the line y = 5.

    Drag acts on the velocity relative to the fluid. Starts, thrust, times and noise are
    those of `barrier_crossings`. Expected: swimmers above y = 5 are carried to the
    right, those below to the left, up to 10 length units.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
        count: number of trajectories; 16 unless given.
    """
    return _in_flow("shear", ShearFlow(rate=0.06, origin=5.0), key, count)


def poiseuille(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
    """The paper's barrier in a channel flow of speed 0.6 between y = -5 and y = 15.

    Drag acts on the velocity relative to the fluid. Starts, thrust, times and noise are
    those of `barrier_crossings`. Expected: all swimmers are carried to the right, those
    in the middle of the channel farthest; the flow presses them against the barrier.

    Args:
        key: random key of the starts; `jax.random.key(0)` unless given.
        count: number of trajectories; 16 unless given.
    """
    flow = PoiseuilleFlow(peak=0.6, middle=5.0, half_width=10.0)
    return _in_flow("poiseuille", flow, key, count)


def _scenario(
    name: str,
    tensor: AbstractTensorField,
    key: PRNGKeyArray | None,
    count: int | None,
    rule: RingStarts = RING,
) -> System:
    truth = paper_swimmer(drag=TensorDrag(tensor))
    return planar_system(name, truth, rule, key, count)


def _in_flow(
    name: str, flow: AbstractFlow, key: PRNGKeyArray | None, count: int | None
) -> System:
    truth = paper_swimmer(drag=InFlow(LinearDrag(DAMPING), flow))
    return planar_system(name, truth, MANY, key, count)
