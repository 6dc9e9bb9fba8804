"""Swimmers as dynamical systems y' = f(t, y), and the commands that drive them.

Truth, UDE and physics-only baseline are one class, `Swimmer` with inertia or
`OverdampedSwimmer` without, holding different values; the network-only baseline is
`NeuralDynamics`.
"""

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Float, PRNGKeyArray, PyTree

from pinav.arguments import Scalar, State, dimension
from pinav.errors import InputError
from pinav.forces import (
    AbstractCommandedForce,
    AbstractFlow,
    AbstractForce,
    AbstractTensorField,
    ZeroFlow,
    ZeroForce,
    as_tensor,
    tanh_network,
)

Model = TypeVar("Model", bound=PyTree)


class AbstractDynamics(eqx.Module):
    """Right-hand side of an ordinary differential equation for the state y."""

    @abc.abstractmethod
    def __call__(self, t: Scalar, y: State) -> State:
        """Rate of change of the state `y` at time `t` [T]."""


class AbstractSwimmer(AbstractDynamics):
    """A swimmer of known physics in an environment, which is the unknown."""

    propulsion: eqx.AbstractVar[AbstractForce]
    environment: eqx.AbstractVar[AbstractForce]

    def with_environment(self: Model, environment: AbstractForce) -> Model:
        """The swimmer in another environment."""
        return dataclasses.replace(self, environment=environment)

    def without_environment(self: Model) -> Model:
        """The swimmer with its known physics alone."""
        return self.with_environment(ZeroForce())


class Swimmer(AbstractSwimmer):
    r"""A swimmer with inertia, $\dot x = v$, $\dot v = $ sum of three forces.

    Its state stacks position and velocity, y = (x, v), in any dimension. Mass is
    absorbed in the coefficients, so forces are accelerations [L T⁻²].

    Attributes:
        propulsion: what the operator commands.
        drag: what the fluid takes.
        environment: the unknown: a barrier in truth, `NeuralForce` in the UDE,
            `ZeroForce` in the physics-only baseline.
        known_force: any other force that is known, such as gravity.

    References:
        PI-NAV paper, eq. (2).
    """

    propulsion: AbstractForce
    drag: AbstractForce
    environment: AbstractForce
    known_force: AbstractForce = ZeroForce()

    def __call__(self, t: Scalar, y: State) -> State:
        x, v = jnp.split(y, 2)
        acceleration = (
            self.propulsion(t, x, v) + self.drag(t, x, v) + self.environment(t, x, v)
        )
        return jnp.concatenate([v, acceleration + self.known_force(t, x, v)])


class OverdampedSwimmer(AbstractSwimmer):
    r"""A swimmer without inertia, $\dot x = u(t, x) + M(x) (F_p + F_e)$.

    Its state is the position alone, y = x, in any dimension. This is the limit of
    `Swimmer` with flow for strong drag, $M = 1/\eta$; real microswimmers are there,
    because their velocity relaxes within microseconds. The velocity is not a state,
    so forces are called with v = 0: drag belongs into the mobility, not among them.

    Attributes:
        propulsion: what the operator commands [F].
        environment: the unknown [F].
        mobility: $M$ [L T⁻¹ F⁻¹], positive; a number means isotropic.
        flow: $u(t, x)$, which carries the swimmer.
        known_force: any other force that is known, such as gravity [F].

    Raises:
        InputError: `mobility` is a number <= 0.

    References:
        Purcell, Am. J. Phys. 45, 3 (1977).
    """

    propulsion: AbstractForce
    environment: AbstractForce
    mobility: AbstractTensorField = eqx.field(
        metadata=dimension("L T-1 F-1"), converter=as_tensor
    )
    flow: AbstractFlow = ZeroFlow()
    known_force: AbstractForce = ZeroForce()

    def __call__(self, t: Scalar, y: State) -> State:
        at_rest = jnp.zeros_like(y)
        force = self.propulsion(t, y, at_rest) + self.environment(t, y, at_rest)
        force = force + self.known_force(t, y, at_rest)
        return self.flow(t, y) + self.mobility(y, force)


class NeuralDynamics(AbstractDynamics):
    """The black box: a network of state and time gives the whole rate of change.

    Attributes:
        network: the multilayer perceptron; its weights are what trains.
        center: subtracted from (y, t); fixed, never trained.
        scale: divides the difference; fixed, never trained.
    """

    network: eqx.nn.MLP
    center: tuple[float, ...] = eqx.field(static=True)
    scale: tuple[float, ...] = eqx.field(static=True)

    @property
    def parameters(self) -> PyTree:
        """The leaves that train."""
        return self.network

    def __call__(self, t: Scalar, y: State) -> State:
        inputs = jnp.append(y, jnp.asarray(t, y.dtype))
        center, scale = (jnp.asarray(a, y.dtype) for a in (self.center, self.scale))
        return self.network((inputs - center) / scale)


def paper_black_box(key: PRNGKeyArray) -> NeuralDynamics:
    """The network-only baseline: 5-32-32-4 tanh on raw (x, y, vx, vy, t).

    The paper does not print its architecture; this is its UDE network with the
    inputs and outputs that a black box needs.
    """
    network = tanh_network(5, 4, width=32, depth=2, key=key)
    return NeuralDynamics(network, center=(0.0,) * 5, scale=(1.0,) * 5)


def with_dtype(model: Model, dtype: jnp.dtype | type) -> Model:
    """The model with every inexact array cast to `dtype`."""
    return jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, model
    )


def takes_commands(model: PyTree) -> bool:
    """Whether a part of the model is driven by the commands of each trajectory."""
    return any(map(_unbound, _parts(model)))


def drive_by_arrays(
    model: Model,
    times: Float[ArrayLike, " time"],
    commands: Mapping[str, Float[ArrayLike, " time"]],
) -> Model:
    """The model, each propulsion that takes commands driven by these.

    A model that takes none comes back as it is. Commands hold until the next one; the
    result may be differentiated by the parameters of the propulsion.

    Args:
        times: when each command was given [T], such as those of a `Trajectory`.
        commands: what was commanded, by name.

    Raises:
        InputError: a command that the propulsion needs was not recorded.
    """
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
