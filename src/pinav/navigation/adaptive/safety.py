r"""A last filter between control and swimmer: no command without a way out.

A command is let through if, after it, there is a sequence of commands that keeps the
tube of some time ahead out of every forbidden place: the predicted mean path and three
standard deviations of state and force about it, later fewer, as one over the time. A
swimmer with inertia may need that long to stop; with the full width the tube would fill
every gate in which nothing is known yet, although the swimmer sees more on the way and
steers by it. Each such sequence is one heading held at full thrust, or none
at all; zero frequency has no privilege, for a force may push. The best one is kept in
reserve. If there is none, the swimmer does what keeps the tube furthest from forbidden
places.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Planar, State
from pinav.navigation.adaptive.strategies import MEAN_FORCE
from pinav.navigation.belief.belief import Belief
from pinav.navigation.control.controller import Observation, TrajectoryPrediction
from pinav.navigation.predictors import TabulatedModel, TimeCost
from pinav.navigation.task.steering import Command, thrusts_of

DEVIATIONS = 3.0
"""Half width of a tube, in standard deviations."""


ESCAPES = 16
"""Headings of the sequences in reserve."""

FULL = 1 / 3
"""How long it has that width, in parts of the time for which it is looked at."""

PIECES = 8
"""Steps in which its width is predicted."""

MOST = 80
"""Steps in which its middle is predicted, at most."""


CLOCK = 1e-6
"""Share of a piece that is no delay but rounding."""


@dataclasses.dataclass(frozen=True, eq=False)
class CommandVerdict:
    """The decision of the filter on a command.

    Attributes:
        margin: least distance of the tube from forbidden places [L].
        changed: whether it is another than the controller's.
    """

    command: Command
    margin: float
    changed: bool


def check_command(
    command: Command,
    observation: Observation,
    belief: Belief,
    prediction: TrajectoryPrediction,
    physics: TabulatedModel,
    time_cost: TimeCost,
    thrust: float,
    horizon: float,
) -> CommandVerdict:
    """Let a command through, or give a safer one.

    Args:
        observation: the state when it comes into force.
        thrust: greatest thrust [L T⁻²], or velocity [L T⁻¹] without inertia.
        horizon: how far the tube goes [T].
    """
    near = float(_clearance(time_cost, observation.state))
    if near > farthest(np.asarray(observation.state), thrust, horizon):
        return CommandVerdict(command, near, changed=False)
    # The tables of the last plan are older than the belief, by half a time unit.
    predictor = MEAN_FORCE.tables(belief, physics, thrust).predictor
    # A camera may be far quicker than a swimmer that takes minutes to cross the arena.
    step = max(prediction.step, horizon / MOST)
    prediction = dataclasses.replace(prediction, predictor=predictor, step=step)
    tube = tube_radii(belief, command, prediction, horizon, observation)
    controls, after, instead = _margins(
        prediction, observation, command, time_cost, jnp.asarray(tube)
    )
    others = np.asarray(instead)
    margins = np.append(float(jnp.max(after)), others)
    best = choose_command(margins, np.append(np.inf, others))
    if best == 0:
        return CommandVerdict(command, float(margins[0]), changed=False)
    safer = prediction.command(observation, controls[best - 1])
    return CommandVerdict(safer, float(margins[best]), changed=True)


def farthest(
    state: Float[np.ndarray, " state"], thrust: float, horizon: float
) -> float:
    """Distance within which a forbidden place matters at all [L].

    The way at the present speed, that by twice the thrust (so much may a force add),
    and a tube as wide.
    """
    if len(state) == 2:
        return 4 * thrust * horizon
    return float(np.linalg.norm(state[2:])) * horizon + 2.5 * thrust * horizon**2


def tube_radii(
    belief: Belief,
    command: Command,
    prediction: TrajectoryPrediction,
    horizon: float,
    observation: Observation,
) -> Float[np.ndarray, " step"]:
    """Half width of the tube after each step [L], until the horizon.

    What is not known of state and force widens it from the last frame on, pending
    commands included.
    """
    actuator = prediction.control_map.actuator
    given = jnp.stack([observation.pending[-1], command])
    waiting, wanted = np.asarray(thrusts_of(actuator, given))
    ends = np.linspace(0, horizon, PIECES + 1)
    delay = float(observation.time) - belief.time
    delayed = math.ceil(delay / ends[1] - CLOCK)
    thrusts = np.repeat([waiting, wanted], [delayed, PIECES], axis=0)
    durations = np.repeat([delay / max(delayed, 1), ends[1]], [delayed, PIECES])
    ahead = belief.ahead(thrusts, durations)
    states = [belief.state, *ahead][delayed:]
    greatest = [np.linalg.eigvalsh(s.covariance[:2, :2])[-1] for s in states]
    count = max(round(horizon / prediction.step), 1)
    times = prediction.step * np.arange(1, count + 1)
    deviations = DEVIATIONS * np.minimum(1.0, FULL * horizon / times)
    return deviations * np.interp(times, ends, np.sqrt(np.maximum(greatest, 0.0)))


@eqx.filter_jit
def _clearance(time_cost: TimeCost, state: State) -> Float[Array, ""]:
    return time_cost.clearance(state[:2])


@eqx.filter_jit
def _margins(
    prediction: TrajectoryPrediction,
    observation: Observation,
    command: Command,
    time_cost: TimeCost,
    tube: Float[Array, " step"],
) -> tuple[Float[Array, "escape 2"], Float[Array, " escape"], Float[Array, " escape"]]:
    """Escapes, and the least margin of each after the command and instead of it."""
    drive = prediction.control_map
    directions = drive.controls(ESCAPES)
    escapes = jnp.concatenate([directions, jnp.zeros((1, 2))])
    count = tube.shape[0]

    def margin(controls: Float[Array, "step 2"], first: Command) -> Float[Array, ""]:
        moved = prediction.predictor.step(
            observation.time, observation.state, first, prediction.step
        )
        later = Observation(observation.time + prediction.step, moved, first[None])
        _, ys = prediction(later, controls)
        distances = jax.vmap(time_cost.clearance)(ys[:, :2])
        return jnp.min(distances - tube)

    def escape(control: Planar) -> tuple[Float[Array, ""], Float[Array, ""]]:
        rest = jnp.tile(control[None], (count - 1, 1))
        unchanged = drive.command(control, observation.pending[-1], prediction.step)
        return margin(rest, command), margin(rest, unchanged)

    after, instead = jax.vmap(escape)(escapes)
    return escapes, after, instead


def choose_command(
    margins: Float[np.ndarray, " command"], lead: Float[np.ndarray, " command"]
) -> int:
    """The place of the command to give; the earlier one where two are alike.

    Of the commands after which a tube can be kept out of forbidden places it is the one
    that leads on most. Where there is none it is the one that keeps farthest away.

    Args:
        margins: least distance of the tube from forbidden places along the best way out
            after each command [L]; negative where every way out meets one.
        lead: how far each leads on, in any unit.
    """
    clear = margins >= 0
    if not clear.any():
        return int(np.argmax(margins))
    return int(np.argmax(np.where(clear, lead, -np.inf)))
