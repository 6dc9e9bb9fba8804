"""Trajectories of a system with observation noise, and states smoothed from them."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Float64, PRNGKeyArray

from pinav import __version__
from pinav.errors import InputError
from pinav.forces import AbstractCommandedForce
from pinav.scenarios.paths import SUBSTEPS, divide_times, true_paths
from pinav.systems import System, system_text
from pinav.trajectories.degradation import MotionBlur
from pinav.trajectories.trajectories import Trajectories
from pinav.trajectories.trajectory import Trajectory

COMMAND_UNITS: dict[str, str] = {
    "frequency": "Hz",
    "heading": "rad",
    "gamma": "rad",
    "psi": "rad",
    "field_x": "1",
    "field_y": "1",
    "field_z": "1",
    "acoustic_frequency": "Hz",
}
"""The commands that recordings may have, and their units."""


def simulate(system: System, *, key: PRNGKeyArray | None = None) -> Trajectories:
    """Solve the truth from every start of a system and observe it, with its noise.

    The provenance holds the system as the text of its file, where a file can state it.

    Args:
        key: random key of observation noise and Brownian motion; needed only for these.

    Raises:
        InputError: JAX or the system is in float32, a noise has no key, or the system
            states no true environment, no starts or no times.
    """
    system.check_simulated()
    if jnp.result_type(float) != jnp.float64 or system.starts.dtype != jnp.float64:
        raise InputError(
            "simulate: expected float64; call jax.config.update("
            '"jax_enable_x64", True) before the system is made'
        )
    shape = (len(system.starts), len(system.times), len(system.channels))
    noise = _observation_noise(system, key, shape)
    # Heat kicks a swimmer within an exposure, which therefore has parts.
    parts = SUBSTEPS if system.observation.exposure > 0 else 1
    states, method = true_paths(system, key, parts=parts)
    provenance = {
        "scenario": system.name,
        "system": _text(system),
        "noise": system.noise,
        "key": None if key is None else jax.random.key_data(key).tolist(),
        **method,
        "pinav": __version__,
    }
    commands = commands_of(system, system.times)
    return Trajectories.from_arrays(
        system.times,
        _expose(system, states, parts) + noise,
        channels=system.channels,
        commands=commands,
        units={**system.units, **{name: COMMAND_UNITS[name] for name in commands}},
        provenance=provenance,
    )


def _text(system: System) -> str | None:
    try:
        text = system_text(system)
    except InputError:  # a network, or a class that stands in no file
        return None
    return None if ".py:" in text else text  # data must not run a file of Python


def commands_of(
    system: System, times: Float[ArrayLike, "*shape"]
) -> dict[str, Float[np.ndarray, "*shape"]]:
    """Commands of the system's programme at some times; empty without one."""
    propulsion = system.swimmer.propulsion
    if not isinstance(propulsion, AbstractCommandedForce) or propulsion.unbound:
        return {}
    frequency, heading = jnp.vectorize(propulsion.programme)(jnp.asarray(times))
    return {"frequency": np.asarray(frequency), "heading": np.asarray(heading)}


def _expose(
    system: System, states: Float64[np.ndarray, "trajectory part state"], parts: int
) -> Float64[np.ndarray, "trajectory time state"]:
    """The states as a camera averages them, which is before its noise."""
    exposure = system.observation.exposure
    if exposure == 0:
        return states
    blur, random = MotionBlur(float(exposure)), np.random.default_rng(0)
    times = divide_times(system.times, parts)
    sharp = Trajectories.from_arrays(times, states, channels=system.channels)
    blurred = [blur(piece, sharp.channels, random).states for piece in sharp]
    return np.stack(blurred)[:, ::parts]


def _observation_noise(
    system: System, key: PRNGKeyArray | None, shape: tuple[int, ...]
) -> np.ndarray:
    if system.noise == 0:
        return np.zeros(shape)
    if key is None:
        raise InputError(
            f"simulate: system {system.name!r} adds noise of {system.noise}; "
            "pass key=jax.random.key(seed)"
        )
    return system.noise * np.asarray(jax.random.normal(key, shape))


WINDOW, DEGREE = 11, 3
"""Observed samples in each local fit, and degree of its polynomial."""


def smooth_states(
    trajectories: Trajectories, dim: int | None = None
) -> Float[np.ndarray, "trajectory time state"]:
    r"""Every state by a cubic through the observed samples around it.

    On regular, complete data this is the Savitzky-Golay filter; times may be
    irregular and samples missing. In a state $y = (x, v)$ a velocity that was never
    observed is the derivative of its position. Padding repeats the last state.

    Args:
        dim: number of positions among the channels, half of them by default; the others
            are velocities.

    Raises:
        InputError: a channel has too few observations in one trajectory, and is not
            the velocity of an observed position.

    References:
        Savitzky and Golay, Anal. Chem. 36, 1627 (1964).
    """
    dim = len(trajectories.channels) // 2 if dim is None else dim
    states = np.empty_like(trajectories.states)
    for index, piece in enumerate(trajectories):
        length = len(piece.times)
        for column in range(states.shape[2]):
            states[index, :length, column] = _channel(
                trajectories.channels, index, piece, column, dim
            )
        states[index, length:] = states[index, length - 1]
    return states


def _channel(
    channels: tuple[str, ...], index: int, piece: Trajectory, column: int, dim: int
) -> Float[np.ndarray, " time"]:
    """One channel of one trajectory: from itself, or as a derivative."""
    source, order = column, 0
    if not piece.observed[:, column].any() and column >= dim:
        source, order = column - dim, 1
    is_observed = piece.observed[:, source]
    if is_observed.sum() <= order + 1:
        raise InputError(
            f"channel {channels[column]!r} of trajectory {index}: {is_observed.sum()} "
            f"observations of {channels[source]!r} do not determine it; drop the "
            "trajectory, or observe positions"
        )
    return local_polynomial(piece.times, piece.states[:, source], is_observed, order)


def local_polynomial(
    times: Float[np.ndarray, " time"],
    values: Float[np.ndarray, " time"],
    observed: Bool[np.ndarray, " time"],
    order: int = 0,
) -> Float[np.ndarray, " time"]:
    """Value, or derivative of that `order`, of a local fit at each time.

    Args:
        observed: mask of observed values; more than `order`.
        order: 0 for the value, 1 for the first derivative.
    """
    seen_times, seen_values = times[observed], values[observed]
    count = min(WINDOW, len(seen_times))
    middle = np.searchsorted(seen_times, times)
    first = np.clip(middle - count // 2, 0, len(seen_times) - count)
    window = first[:, None] + np.arange(count)
    offsets = seen_times[window] - times[:, None]
    scale = np.abs(offsets).max(axis=1, keepdims=True)
    powers = np.arange(min(DEGREE, count - 1) + 1)
    vandermonde = (offsets / scale)[..., None] ** powers
    coefficients = np.linalg.pinv(vandermonde) @ seen_values[window][..., None]
    return coefficients[:, order, 0] / scale[:, 0] ** order
