"""A run: temperature, dose and energy balance over a protocol."""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from pinav.thermal.bioheat import Bioheat, HeatBalance
from pinav.thermal.dose import Arrhenius, cem43_segment
from pinav.thermal.protocols import AbstractProtocol, Schedule, plan_steps
from pinav.thermal.quantities import Field, Number, Numbers
from pinav.thermal.starts import AT_REST, AbstractStart, HeatState
from pinav.thermal.steppers import RKL2, AbstractStepper, Rosenbrock


class EnergyBalance(eqx.Module):
    """Heat of a run [J], that of a slab per area, of a cylinder per length.

    Attributes:
        perfused: taken by blood.
        lost: through the sides.
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
        observed: what `observe` made of the temperature at those times.
        observed_dose: what `observe_dose` made of the dose at those times.
        hottest: highest temperature [°C] at the end of every step.
        final: the state at the end; a run can go on from it.
        energy: where the heat went.
    """

    times: Float[Array, " time"]
    observed: PyTree
    observed_dose: PyTree
    hottest: Float[Array, " step"]
    final: HeatState
    energy: EnergyBalance


Observe = Callable[[Field], PyTree]
"""What of the temperature is kept at each time, such as that of probes."""


def solve(
    model: Bioheat,
    protocol: AbstractProtocol,
    *,
    stepper: AbstractStepper | None = None,
    observe: Observe = lambda temperature: temperature,
    observe_dose: Observe = lambda dose: None,
    save_every: Number | None = None,
    save_at: Numbers | None = None,
    start: AbstractStart = AT_REST,
    damage: Arrhenius | None = None,
) -> Solution:
    """Run a protocol, from rest, a steady state or a state of another run.

    Differentiable by every number of the model and of the protocol but its times: pass
    the `Schedule` of a nearby model to `run` inside a transformation.

    Args:
        stepper: `Rosenbrock()` on radial grids and `RKL2()` on others unless given.
        observe: what of the temperature is kept; all of it unless given.
        observe_dose: what of the dose so far [CEM43 min] is kept; nothing unless given.
        save_every: interval between saved times [s].
        save_at: saved times [s]; the end alone unless given.
        start: where to begin; at rest unless given.
        damage: law of damage that is accumulated beside the dose.

    Raises:
        InputError: a time is outside the protocol, the step is not stable, or the
            state has not the shape of the grid.
    """
    stepper = default_stepper(model) if stepper is None else stepper
    begin = start.state(model)
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
        observe_dose=observe_dose,
        start=begin,
        damage=damage,
    )


def default_stepper(model: Bioheat) -> AbstractStepper:
    """Implicit along one axis, explicit in two and three."""
    return Rosenbrock() if len(model.grid.shape) == 1 else RKL2.for_model(model)


MANY_VALUES = 150_000_000
"""Temperatures of a run up to which reverse mode keeps those of all steps: 1.2 GB."""


@eqx.filter_jit
def run(
    model: Bioheat,
    protocol: AbstractProtocol,
    schedule: Schedule,
    *,
    stepper: AbstractStepper,
    observe: Observe,
    observe_dose: Observe = lambda dose: None,
    start: AbstractStart = AT_REST,
    damage: Arrhenius | None = None,
) -> Solution:
    """Run a protocol with a given schedule; see `solve`.

    Reverse mode keeps the states of all steps; in a very large run those between blocks
    and of one block at a time, about twice the square root of the number of steps.
    """
    balance, begin = HeatBalance.of(model), _with_damage(start.state(model), damage)

    # backwards each step is computed anew: its stages would take more time to keep
    @partial(jax.checkpoint, prevent_cse=False)
    def step(state: HeatState, inputs: PyTree) -> tuple[HeatState, PyTree]:
        dt, forced = inputs
        before = state.temperature
        change = stepper.change(balance, before, dt, forced)
        after = before + change.temperature
        dose, harm = state.dose + cem43_segment(before, after, dt), state.damage
        if damage is not None and harm is not None:
            harm = harm + damage.segment(before, after, dt)
        kept = observe(after), observe_dose(dose), jnp.max(after), change.energy
        return HeatState(state.time, after, dose, harm), kept

    def advance(state: HeatState, inputs: PyTree) -> tuple[HeatState, PyTree]:
        return jax.lax.scan(step, state, inputs)

    block, values = len(schedule.steps), begin.temperature.size * len(schedule.steps)
    if values > MANY_VALUES:
        block, advance = schedule.block, jax.checkpoint(advance)
    shape = len(schedule.steps) // block, block
    levels = _levels(model, protocol, schedule, stepper)
    blocks = jax.tree.map(
        lambda a: a.reshape(*shape, *a.shape[1:]), (jnp.asarray(schedule.steps), levels)
    )
    end, kept = jax.lax.scan(advance, begin, blocks)
    *observed, hottest, flows = jax.tree.map(
        lambda a: a.reshape(-1, *a.shape[2:]), kept
    )
    # observed after every step and picked here: a scan cannot save at some steps alone
    saved = jnp.asarray(schedule.saved)
    temperatures, doses = jax.tree.map(lambda a: a[saved], observed)
    warming = end.temperature - begin.temperature
    return Solution(
        times=jnp.asarray(schedule.times),
        observed=temperatures,
        observed_dose=doses,
        hottest=hottest,
        final=eqx.tree_at(lambda s: s.time, end, jnp.asarray(schedule.times[-1])),
        energy=EnergyBalance(
            *jnp.sum(flows, axis=0), stored=jnp.sum(warming / balance.inverse_capacity)
        ),
    )


def _with_damage(state: HeatState, damage: Arrhenius | None) -> HeatState:
    """The state with the damage of so far, or with none where none is followed."""
    if damage is None:
        return HeatState(state.time, state.temperature, state.dose)
    so_far = jnp.zeros_like(state.dose) if state.damage is None else state.damage
    return HeatState(state.time, state.temperature, state.dose, so_far)


def _levels(
    model: Bioheat,
    protocol: AbstractProtocol,
    schedule: Schedule,
    stepper: AbstractStepper,
) -> Float[Array, "step node source"]:
    nodes = jnp.asarray(stepper.nodes)

    def each(begin: Array, dt: Array, interval: Array) -> Array:
        field = jax.vmap(lambda t: protocol.amplitude(t, interval))(begin + dt * nodes)
        return jax.vmap(lambda h: model.levels(h, protocol.frequency))(field)

    steps, starts = jnp.asarray(schedule.steps), jnp.asarray(schedule.starts)
    return jax.vmap(each)(starts, steps, jnp.asarray(schedule.intervals))


def probes_at(model: Bioheat, points: Any) -> Observe:
    """Temperatures at points [m], as an `observe`; for a model that is not traced."""
    return Probes(
        model.grid.interpolation(points, np.asarray(model.tissue.conductivity))
    )


class Probes(eqx.Module):
    """Temperatures at points, by the weights of `AbstractGrid.interpolation`."""

    weights: Float[Array, "point ..."]

    def __call__(self, temperature: Field) -> Float[Array, " point"]:
        flat = self.weights.reshape(self.weights.shape[0], -1)
        return flat @ temperature.reshape(-1)
