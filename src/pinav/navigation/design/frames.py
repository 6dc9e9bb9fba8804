"""Recorded trajectories as frames of a belief."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from pinav.dynamics import (
    OverdampedSwimmer,
    Swimmer,
    drive_by_commands,
)
from pinav.errors import InputError
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.design.campaign import learn
from pinav.trajectories import Trajectories, Trajectory

SPEED = 2.0
"""Standard deviation of the first velocity, over the mean speed of a trajectory."""


def believe_data(
    adaptive: AdaptiveController,
    swimmer: Swimmer | OverdampedSwimmer,
    data: Trajectories,
    position_noise: float,
) -> Belief:
    """The belief on the force after recorded trajectories.

    Args:
        adaptive: the task, and what is known of the swimmer.
        swimmer: whose propulsion drove the trajectories, by their commands where it
            takes any.
        data: the trajectories; their positions alone are used.
        position_noise: standard deviation of each coordinate [L].

    Raises:
        InputError: a trajectory has fewer than two observed positions.
    """
    belief: Belief | None = None
    for number, piece in enumerate(data):
        frames = list(frames_of(swimmer, piece, position_noise))
        if len(frames) < 2:
            raise InputError(
                f"data: trajectory {number} has fewer than two observed positions; "
                "leave it out"
            )
        places = [f.position for f in frames if f.position is not None]
        moved = np.linalg.norm(np.diff(np.stack(places), axis=0), axis=1)
        speed = SPEED * float(np.sum(moved)) / (frames[-1].time - frames[0].time)
        sd = max(speed, adaptive.rest_sd(frames[0]))
        if belief is None:
            belief = adaptive.believe(frames[0])
        belief = learn(adaptive, belief, frames, sd)
    assert belief is not None
    return belief


def frames_of(
    swimmer: Swimmer | OverdampedSwimmer, piece: Trajectory, position_noise: float
) -> Iterator[Frame]:
    """The observed positions of a trajectory, with the thrust before each."""
    driven = drive_by_commands(swimmer, piece)
    seen = np.flatnonzero(piece.observed[:, :2].all(axis=1))
    last = None
    for k in seen:
        time, position = float(piece.times[k]), piece.states[k, :2]
        thrust = np.zeros(2)
        if last is not None:
            middle = jnp.asarray((last + time) / 2)
            x = jnp.asarray(position)
            thrust = np.asarray(driven.propulsion(middle, x, jnp.zeros_like(x)), float)
        yield Frame(time, position, position_noise, thrust)
        last = time
