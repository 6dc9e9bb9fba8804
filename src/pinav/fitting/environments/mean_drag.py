"""Swimmers whose drag is learned, from the drag that was known before."""

import dataclasses

import jax.numpy as jnp

from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.fitting.environments.choice import KnownSwimmer
from pinav.fitting.environments.summary import DataSummary
from pinav.forces import CholeskyTensor, LinearDrag, TensorDrag, tensor_matrix


def with_tensor_drag(swimmer: KnownSwimmer, summary: DataSummary) -> KnownSwimmer:
    """The swimmer with a tensor to learn as its drag; isotropic at first."""
    matrix = mean_drag(swimmer, summary) * jnp.eye(summary.dim)
    return dataclasses.replace(swimmer, drag=TensorDrag(CholeskyTensor.of(matrix)))


def with_linear_drag(swimmer: KnownSwimmer, summary: DataSummary) -> KnownSwimmer:
    """The swimmer with a number to learn as its drag."""
    drag = LinearDrag(mean_drag(swimmer, summary))
    return dataclasses.replace(swimmer, drag=drag)


def mean_drag(swimmer: KnownSwimmer, summary: DataSummary | None = None) -> float:
    """Drag averaged over all directions, in the middle of the data [T⁻¹].

    Args:
        swimmer: the known physics.
        summary: of the data; their middle is the origin unless given.

    Raises:
        InputError: the swimmer has no drag that depends on its velocity alone.
    """
    drag = swimmer.drag if isinstance(swimmer, Swimmer) else None
    if isinstance(drag, LinearDrag):
        return float(drag.damping)
    if isinstance(drag, TensorDrag):
        dim = 2 if summary is None else summary.dim
        middle = jnp.zeros(dim) if summary is None else jnp.asarray(summary.mean[:dim])
        return float(jnp.trace(tensor_matrix(drag.tensor, middle)) / dim)
    raise InputError(
        "learning the drag needs physics with inertia and a drag in a fluid at rest, "
        f"got {type(swimmer if drag is None else drag).__name__}; leave the drag out"
    )
