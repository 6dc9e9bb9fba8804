"""A run: temperature, dose and energy balance over a protocol."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat, HeatBalance
from pinav.thermal.dose import cem43_segment
from pinav.thermal.protocols import AbstractProtocol
from pinav.thermal.quantities import Field, Number, Numbers
from pinav.thermal.rosenbrock import Rosenbrock
from pinav.thermal.schedule import Schedule, plan_steps
from pinav.thermal.steppers import RKL2, AbstractStepper


class State(eqx.Module):
    """Everything that a run needs to go on.

    Attributes:
        time: since the begin of the protocol [s].
        temperature: of each cell [°C].
        dose: CEM43 of each cell so far [min].
    """

    time: Float[Array, ""]
    temperature: Field
    dose: Field

    @classmethod
    def at_rest(cls, model: Bioheat) -> "State":
        """Everything at the arterial temperature, no dose."""
        arterial = jnp.full(model.grid.shape, jnp.asarray(model.blood.arterial, float))
        return cls(jnp.asarray(0.0), arterial, jnp.zeros(model.grid.shape))


class EnergyBalance(eqx.Module):
    """Where the heat of a run went [J]; per area of a slab, per length of a cylinder.

    Attributes:
        brought: by metabolism and sources.
        perfused: taken by blood.
        lost: through the sides.
        stored: in the tissue.
    """

    brought: Float[Array, ""]
    perfused: Float[Array, ""]
    lost: Float[Array, ""]
    stored: Float[Array, ""]

    @property
    def imbalance(self) -> Float[Array, ""]:
        """What is missing, relative to the largest of the four."""
        parts = jnp.stack([self.brought, self.perfused, self.lost, self.stored])
        missing = self.brought - self.perfused - self.lost - self.stored
        return jnp.abs(missing) / jnp.max(jnp.abs(parts))


class Solution(eqx.Module):
    """A run over a protocol.

    Attributes:
        times: saved times [s].
        observed: what `observe` made of the temperature at those times.
        hottest: highest temperature [°C] at the end of every step.
        final: the state at the end; a run can go on from it.
        energy: where the heat went.
    """

    times: Float[Array, " time"]
    observed: PyTree
    hottest: Float[Array, " step"]
    final: State
    energy: EnergyBalance


Observe = Callable[[Field], PyTree]
"""What of the temperature is kept at each time, such as that of probes."""


def solve(
    model: Bioheat,
    protocol: AbstractProtocol,
    *,
    stepper: AbstractStepper | None = None,
    observe: Observe = lambda temperature: temperature,
    save_every: Number | None = None,
    save_at: Numbers | None = None,
    start: State | None = None,
    cutoff: Number = 37.0,
) -> Solution:
    """Run a protocol, from rest or from a state.

    Differentiable by every number of the model and of the protocol but its times: pass
    the `Schedule` of a nearby model to `run` inside a transformation.

    Args:
        model: the tissue.
        protocol: the field over time.
        stepper: `Rosenbrock()` on radial grids and `RKL2()` on others unless given.
        observe: what of the temperature is kept; all of it unless given.
        save_every: interval between saved times [s].
        save_at: saved times [s]; the end alone unless given.
        start: where to begin; at rest unless given.
        cutoff: temperature [°C] below which no dose counts.

    Raises:
        InputError: a time is outside the protocol, the step is not stable, or the
            state has not the shape of the grid.
    """
    stepper = default_stepper(model) if stepper is None else stepper
    begin = State.at_rest(model) if start is None else start
    if begin.temperature.shape != model.grid.shape:
        raise InputError(
            f"start: expected temperatures of shape {model.grid.shape}, got "
            f"{begin.temperature.shape}"
        )
    schedule = plan_steps(
        protocol,
        stepper.longest_step(model),
        save_every=save_every,
        save_at=save_at,
        start=float(begin.time),
    )
    return run(
        model,
        protocol,
        schedule,
        stepper=stepper,
        observe=observe,
        start=begin,
        cutoff=cutoff,
    )


def default_stepper(model: Bioheat) -> AbstractStepper:
    """Implicit along one axis, explicit in two and three."""
    return Rosenbrock() if len(model.grid.shape) == 1 else RKL2.for_model(model)


@eqx.filter_jit
def run(
    model: Bioheat,
    protocol: AbstractProtocol,
    schedule: Schedule,
    *,
    stepper: AbstractStepper,
    observe: Observe,
    start: State | None = None,
    cutoff: Number = 37.0,
) -> Solution:
    """Run a protocol with a given schedule; see `solve`.

    Reverse mode keeps the states of all steps; in a very large run those between blocks
    and of one block at a time, about twice the square root of the number of steps.
    """
    balance = HeatBalance.of(model)
    start = State.at_rest(model) if start is None else start
    nodes = jnp.asarray(stepper.nodes)

    def levels(begin: Array, dt: Array, interval: Array) -> Array:
        at = begin + dt * nodes
        return jax.vmap(lambda t: model.levels(protocol, t, interval))(at)

    steps, starts = jnp.asarray(schedule.steps), jnp.asarray(schedule.starts)
    each = jax.vmap(levels)(starts, steps, jnp.asarray(schedule.intervals))

    def watch(before: Field, after: Field, dt: Scalar) -> tuple[Field, PyTree]:
        dose = cem43_segment(before, after, dt, cutoff)
        return dose, (observe(after), jnp.max(after))

    def advance(carry: State, inputs: PyTree) -> tuple[State, PyTree]:
        durations, forced = inputs
        marched = stepper.march(balance, carry.temperature, durations, forced, watch)
        after = State(carry.time, marched.temperature, carry.dose + marched.total)
        return after, (marched.kept, marched.flows)

    # one block where reverse mode may keep the states of all steps
    block = len(schedule.steps)
    if start.temperature.size * block > stepper.kept_values:
        block, advance = schedule.block, jax.checkpoint(advance)
    shape = len(schedule.steps) // block, block
    blocks = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), (steps, each))
    end, (kept, flows) = jax.lax.scan(advance, start, blocks)
    observed, hottest = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), kept)
    # observed after every step and picked here: a scan cannot save at some steps alone
    saved = jnp.asarray(schedule.saved)
    return Solution(
        times=jnp.asarray(schedule.times),
        observed=jax.tree.map(lambda a: a[saved], observed),
        hottest=hottest,
        final=State(jnp.asarray(schedule.times[-1]), end.temperature, end.dose),
        energy=EnergyBalance(
            *jnp.sum(flows, axis=0),
            stored=balance.stored_heat(start.temperature, end.temperature),
        ),
    )


def probes_at(model: Bioheat, points: Any) -> Observe:
    """Temperatures at points [m], as an `observe`.

    Raises:
        InputError: a point is outside the grid.
    """
    return Probes(model.grid.interpolation(points))


class Probes(eqx.Module):
    """Temperatures at points, by linear interpolation.

    Attributes:
        weights: of the cells, for each point.
    """

    weights: Float[Array, "point ..."]

    def __call__(self, temperature: Field) -> Float[Array, " point"]:
        """Temperatures of the points [°C]."""
        flat = self.weights.reshape(self.weights.shape[0], -1)
        return flat @ temperature.reshape(-1)
