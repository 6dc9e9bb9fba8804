"""StochasticForceInference on the same recordings, where it is installed.

It is given a basis as rich as theirs who publish with it, its defaults otherwise.

References:
    Frishman and Ronceray, Phys. Rev. X 10, 021009 (2020).
"""

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

FOURIER = 6
"""Harmonics of the basis on a ring: 13 functions."""


BUMPS = 11
"""Functions of the height above a wall, for the drift and for each diffusion."""


class PeerRing(NamedTuple):
    """What the peer says of a ring.

    Attributes:
        drift: at the places asked for.
        diffusion: one number.
    """

    drift: Float[np.ndarray, " place"]
    diffusion: float


class PeerWall(NamedTuple):
    """What the peer says of a bead above a wall, at the heights asked for.

    Attributes:
        along: D along the wall [um²/s].
        across: D normal to it [um²/s].
        force: normal to it, from drift, D and its slope [pN].
    """

    along: Float[np.ndarray, " height"]
    across: Float[np.ndarray, " height"]
    force: Float[np.ndarray, " height"]


def is_installed() -> bool:
    """Whether there is a peer to ask."""
    return importlib.util.find_spec("SFI") is not None


def infer_ring(
    times: Float[np.ndarray, " frame"],
    tracks: Float[np.ndarray, "frame track"],
    period: float,
    places: Float[np.ndarray, " place"],
) -> PeerRing:
    """Drift and diffusion on a ring, by its linear estimator with Fourier functions."""
    turn = 2 * np.pi / period

    def waves(x: Array) -> Array:
        phases = turn * x[0] * jnp.arange(1, FOURIER + 1.0)
        parts = jnp.ones(1), jnp.cos(phases), jnp.sin(phases)
        return jnp.concatenate(parts)[None]

    inference = _inference(times, tracks[..., None])
    inference.compute_diffusion_constant()
    inference.infer_force_linear(_basis(waves, 1, 2 * FOURIER + 1))
    weights = np.asarray(inference.force_coefficients)
    columns = np.asarray(jax.vmap(waves)(jnp.asarray(places)[:, None]))[:, 0]
    diffusion = float(np.ravel(np.asarray(inference.diffusion_average))[0])
    return PeerRing(columns @ weights, diffusion)


def infer_wall(
    times: Float[np.ndarray, " frame"],
    positions: Float[np.ndarray, "frame 3"],
    places: Float[np.ndarray, " height"],
    heat: float,
    finest: float,
) -> PeerWall:
    """Force and diffusions at heights, by its linear estimators with Gaussian bumps.

    The bumps are as far apart as they are wide in the logarithm of the height, and not
    finer than `finest` near the wall.

    Args:
        times: of the frames [s].
        positions: heights above the wall in the last column [um].
        places: heights asked for [um].
        heat: $k_B T$ [pN um].
        finest: width of the lowest bump [um].
    """
    lowest = float(np.min(positions[:, 2]))

    def stretch(height: Array) -> Array:
        return jnp.arcsinh((height - lowest) / finest)

    top = float(stretch(jnp.asarray(np.max(positions[:, 2]))))
    centres, width = jnp.linspace(0.0, top, BUMPS), top / (BUMPS - 1)

    def bumps(height: Array) -> Array:
        return jnp.exp(-0.5 * ((stretch(height) - centres) / width) ** 2)

    def drift(x: Array) -> Array:
        return jnp.array([0.0, 0.0, 1.0])[:, None] * bumps(x[2])[None]

    def diffusion(x: Array) -> Array:
        along, across = jnp.diag(jnp.array([1.0, 1.0, 0.0])), jnp.diag(jnp.eye(3)[2])
        parts = [axes[..., None] * bumps(x[2])[None, None] for axes in (along, across)]
        return jnp.concatenate(parts, axis=-1)

    inference = _inference(times, positions[:, None])
    inference.compute_diffusion_constant()
    inference.infer_force_linear(_basis(drift, 1, BUMPS, dim=3))
    inference.infer_diffusion_linear(_basis(diffusion, 2, 2 * BUMPS, dim=3))
    along, across = np.split(np.asarray(inference.diffusion_coefficients), 2)
    values = np.asarray(jax.vmap(bumps)(jnp.asarray(places)))
    slopes = np.asarray(jax.vmap(jax.jacfwd(bumps))(jnp.asarray(places)))
    normal = values @ across
    moved = values @ np.asarray(inference.force_coefficients) - slopes @ across
    return PeerWall(values @ along, normal, heat * moved / normal)


def _inference(times: np.ndarray, positions: np.ndarray) -> Any:
    tool: Any = importlib.import_module("SFI")
    tracks = tool.TrajectoryCollection.from_arrays(X=positions, t=times)
    return tool.OverdampedLangevinInference(tracks)


def _basis(
    function: Callable[[Array], Array], rank: int, count: int, *, dim: int = 1
) -> Any:
    make = importlib.import_module("SFI.statefunc").make_basis
    return make(function, dim=dim, rank=rank, n_features=count)
