r"""A model on a task's arena, as tables: what plan and controllers work with."""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.dynamics import Swimmer
from pinav.navigation.model.predictors import (
    ControlMap,
    InertialTable,
    OverdampedTable,
    TimeCost,
    split_rates,
)
from pinav.navigation.model.tables import (
    FieldTable,
    Grid,
    at_rest,
    force_spread,
    sample_times,
    tabulate,
    tabulate_over_time,
)
from pinav.navigation.task.steering import SteeredSwimmer
from pinav.navigation.task.task import Task

HEADINGS = 24
"""Directions in which the greatest thrust is looked for."""


class TabulatedModel(eqx.Module):
    """A model of the swimmer on a task's arena, as tables."""

    table: FieldTable
    predictor: InertialTable | OverdampedTable
    control_map: ControlMap
    time_cost: TimeCost


def tabulate_model(
    task: Task,
    model: SteeredSwimmer,
    *,
    samples: Sequence[SteeredSwimmer] = (),
    risk_aversion: float = 4.0,
    margin: float | None = None,
    points: int | None = None,
    times: int = 41,
) -> TabulatedModel:
    r"""Tables of a model on a task's arena.

    Args:
        task: the arena, the walls, the limits; its truth is not used.
        model: what is believed.
        samples: of the posterior of the model, none or at least two: their spread makes
            uncertain regions cost more.
        risk_aversion: cost of time where that spread is as great as the thrust.
        margin: from walls, over which time costs more [L]; half the tolerance or what
            the noise asks for unless given.
        points: of the tables, along the longer side; 81 in the plane and 41 in space
            unless given.
        times: of the tables of a model that changes in time.

    Raises:
        InputError: the model is not finite on the arena; fewer than two samples.
    """
    usual = 81 if task.dim == 2 else 41
    grid = Grid.over(task.arena, usual if points is None else points, margin=2)
    table = tabulate_over_time(model, grid, task.time_limit, times)
    inertial = isinstance(model.dynamics, Swimmer)
    predictor = (InertialTable if inertial else OverdampedTable)(table, model.actuator)
    drive = ControlMap.of(model.actuator, task.limits, task.dim)
    at_times = sample_times(at_rest((*samples, model)[0]), grid, task.time_limit, times)
    if samples:
        spread = force_spread([tabulate(one, grid, at_times) for one in samples])
        thrust = greatest_rate(table, drive, inertial=inertial)
        spread = eqx.tree_at(lambda s: s.values, spread, spread.values / thrust)
    else:
        # Zeros instead of none, at as many times as samples would have: one compiled
        # program serves all models.
        nothing = jnp.zeros_like(table.values[: len(at_times), ..., :1])
        spread = dataclasses.replace(table, values=nothing, lasting=None)
    time_cost = TimeCost(
        task.keep_out,
        task.arena,
        noise_margin(task) if margin is None else margin,
        4.0,
        spread,
        risk_aversion,
    )
    return TabulatedModel(table, predictor, drive, time_cost)


def noise_margin(task: Task) -> float:
    """Distance from walls that the noise of a task asks for [L].

    Three standard deviations of where it takes a swimmer during one time unit or, where
    the position itself is noisy, five control steps; of the sensor; and a little more,
    by the size of the arena.
    """
    reaction = 5 * task.step + task.delay
    noise = math.sqrt(reaction**3 / 3 if task.inertial else reaction)
    return 3 * math.hypot(task.noise * noise, task.sensor_noise) + task.extent / 140


def greatest_rate(
    table: FieldTable, drive: ControlMap, *, inertial: bool
) -> Float[Array, ""]:
    """Greatest acceleration, or velocity, that thrust gives."""
    thrusts = drive.thrusts(HEADINGS)
    if not inertial:
        _, mobility = split_rates(table.first)
        thrusts = jnp.einsum("...ab,hb->...ha", mobility, thrusts)
    return jnp.max(jnp.linalg.norm(thrusts, axis=-1))
