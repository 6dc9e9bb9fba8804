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


class PeerRing(NamedTuple):
    """What the peer says of a ring.

    Attributes:
        drift: at the places asked for.
        diffusion: one number.
    """

    drift: Float[np.ndarray, " place"]
    diffusion: float


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


def _inference(times: np.ndarray, positions: np.ndarray) -> Any:
    tool: Any = importlib.import_module("SFI")
    tracks = tool.TrajectoryCollection.from_arrays(X=positions, t=times)
    return tool.OverdampedLangevinInference(tracks)


def _basis(function: Callable[[Array], Array], rank: int, count: int) -> Any:
    make = importlib.import_module("SFI.statefunc").make_basis
    return make(function, dim=1, rank=rank, n_features=count)
