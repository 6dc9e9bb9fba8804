"""The commands of a trajectory drive a model: `commanded`."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Float, PyTree

from pinav.dynamics.swimmers import Model
from pinav.errors import InputError
from pinav.forces import AbstractCommandedForce


@runtime_checkable
class Commands(Protocol):
    """What has commands at times, such as a `Trajectory`."""

    @property
    def times(self) -> Any:
        """When each command was given [T]."""
        ...

    @property
    def commands(self) -> Mapping[str, Any]:
        """What was commanded, by name."""
        ...


def takes_commands(model: PyTree) -> bool:
    """Whether a part of the model is driven by the commands of each trajectory."""
    return any(map(_unbound, _parts(model)))


def drive_by_commands(model: Model, trajectory: Commands) -> Model:
    """The model, each propulsion that takes commands driven by those of a trajectory.

    A model that takes none comes back as it is. Commands hold until the next one; the
    result may be differentiated by the parameters of the propulsion.

    Args:
        model: the dynamics.
        trajectory: one trajectory, or anything with `times` and `commands`.

    Raises:
        InputError: a command that the propulsion needs was not recorded.
    """
    return drive_by_arrays(model, trajectory.times, trajectory.commands)


def drive_by_arrays(
    model: Model,
    times: Float[ArrayLike, " time"],
    commands: Mapping[str, Float[ArrayLike, " time"]],
) -> Model:
    """`commanded` by plain arrays, to be batched by `jax.vmap`."""
    if not takes_commands(model):
        return model
    times = jnp.asarray(times)
    held = {name: jnp.asarray(values) for name, values in commands.items()}
    return jax.tree.map(
        lambda part: part.drive_by(times, held) if _unbound(part) else part,
        model,
        is_leaf=_unbound,
    )


def unbound(model: PyTree) -> AbstractCommandedForce:
    """The propulsion of a model that takes commands.

    Raises:
        InputError: there is none.
    """
    for part in _parts(model):
        if _unbound(part):
            return part
    raise InputError("model: expected a propulsion that takes commands, got none")


def _parts(model: PyTree) -> list[Any]:
    return jax.tree.leaves(model, is_leaf=_unbound)


def _unbound(part: Any) -> bool:
    return isinstance(part, AbstractCommandedForce) and part.unbound
