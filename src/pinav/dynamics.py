"""Swimmers as dynamical systems y' = f(t, y), and their rollouts.

Truth, UDE and physics-only baseline are one class, `Swimmer` with inertia or
`OverdampedSwimmer` without, holding different values; the network-only baseline is
`NeuralDynamics`.
"""

import abc
import enum
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int, PRNGKeyArray, PyTree

from pinav.actuation import Scalar
from pinav.errors import InputError
from pinav.flows import AbstractFlow, ZeroFlow
from pinav.forces import AbstractForce
from pinav.learned import tanh_network
from pinav.solvers import AbstractSolver, Adaptive
from pinav.tensors import AbstractTensorField, as_tensor

Model = TypeVar("Model", bound=PyTree)


class AbstractDynamics(eqx.Module):
    """Right-hand side of an ordinary differential equation for the state y."""

    @abc.abstractmethod
    def __call__(self, t: Scalar, y: Float[Array, " state"]) -> Float[Array, " state"]:
        """Rate of change of the state `y` at time `t` [T]."""


class Swimmer(AbstractDynamics):
    r"""A swimmer with inertia, $\dot x = v$, $\dot v = $ sum of three forces.

    Its state stacks position and velocity, y = (x, v), in any dimension. Mass is
    absorbed in the coefficients, so forces are accelerations [L T⁻²].

    Attributes:
        propulsion: what the operator commands.
        drag: what the fluid takes.
        environment: the unknown: a barrier in truth, `NeuralForce` in the UDE,
            `ZeroForce` in the physics-only baseline.

    References:
        PI-NAV paper, eq. (2).
    """

    propulsion: AbstractForce
    drag: AbstractForce
    environment: AbstractForce

    def __call__(self, t, y):
        x, v = jnp.split(y, 2)
        acceleration = (
            self.propulsion(t, x, v) + self.drag(t, x, v) + self.environment(t, x, v)
        )
        return jnp.concatenate([v, acceleration])


class OverdampedSwimmer(AbstractDynamics):
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

    Raises:
        InputError: `mobility` is a number <= 0.

    References:
        Purcell, Am. J. Phys. 45, 3 (1977).
    """

    propulsion: AbstractForce
    environment: AbstractForce
    mobility: AbstractTensorField = eqx.field(converter=as_tensor)
    flow: AbstractFlow = ZeroFlow()

    def __call__(self, t, y):
        at_rest = jnp.zeros_like(y)
        force = self.propulsion(t, y, at_rest) + self.environment(t, y, at_rest)
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

    def __call__(self, t, y):
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


class Outcome(enum.IntEnum):
    """How a rollout ended."""

    SUCCESS = 0
    DIVERGED = 1
    OUT_OF_STEPS = 2


class Rollout(eqx.Module):
    """A solved trajectory.

    Attributes:
        ts: times [T].
        ys: states at those times.
        outcome: an `Outcome`: diverged when a state is not finite, out of steps
            when the solver gave up before the last time.
    """

    ts: Float[Array, " time"]
    ys: Float[Array, "time state"]
    outcome: Int[Array, ""]


def rollout(
    dynamics: AbstractDynamics,
    y0: ArrayLike,
    ts: ArrayLike,
    *,
    solver: AbstractSolver | None = None,
    throw: bool = True,
) -> Rollout:
    """Solve y' = dynamics(t, y) from `y0` at `ts[0]` and save the state at each time.

    Args:
        dynamics: the system.
        y0: initial state, a vector.
        ts: times [T], a vector: not decreasing, at least two.
        solver: how to integrate; `Adaptive()` (Dopri8 at 1e-11) unless given.
        throw: raise when the rollout does not end in `Outcome.SUCCESS`.

    Raises:
        InputError: `y0` is not a vector or `ts` has fewer than two times.
        RuntimeError: the rollout failed and `throw` is true.
    """
    y0, ts = jnp.asarray(y0), jnp.asarray(ts)
    if y0.ndim != 1:
        raise InputError(f"rollout y0: expected one state vector, got shape {y0.shape}")
    if ts.ndim != 1 or ts.shape[0] < 2:
        raise InputError(
            f"rollout ts: expected two or more times, got shape {ts.shape}"
        )
    solver = Adaptive() if solver is None else solver
    ys, reached = solver.solve(dynamics, y0, ts.astype(y0.dtype))
    finite = jnp.all(jnp.isfinite(ys)) | ~reached
    outcome = jnp.where(
        reached & finite,
        Outcome.SUCCESS,
        jnp.where(finite, Outcome.OUT_OF_STEPS, Outcome.DIVERGED),
    )
    if throw:
        ys = eqx.error_if(
            ys,
            outcome != Outcome.SUCCESS,
            "rollout failed: the state is not finite or the solver ran out of steps; "
            "pass throw=False to get what was computed",
        )
    return Rollout(ts, ys, outcome)


def with_dtype(model: Model, dtype: jnp.dtype | type) -> Model:
    """The model with every inexact array cast to `dtype`."""
    return jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, model
    )
