"""StochasticForceInference as a contestant, where it is installed.

It sees positions alone, and finds drag and thrust beside the force: the gradient of a
radial basis, from which its criterion PASTIS selects. It assumes a stochastic motion
and is given the noise.

References:
    Frishman and Ronceray, Phys. Rev. X 10, 021009 (2020); Brueckner, Ronceray and
    Broedersz, Phys. Rev. Lett. 125, 058103 (2020).
"""

import importlib
import importlib.util
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import FitError
from pinav.forces import KernelPotential, LinearDrag, kernel_centers
from pinav.trajectories import Trajectories

PROCESS_NOISE = 1e-6
"""Diffusion [L² T⁻³] that the method must assume where the motion has none."""


class RadialBasis(eqx.Module):
    """Where the functions stand whose gradients make the force.

    Attributes:
        spacing: between their centres [L].
        width: of each [L].
    """

    spacing: float
    width: float

    @classmethod
    def of(cls, positions: Float[np.ndarray, "sample dim"]) -> "RadialBasis":
        """A basis as fine, for the extent, as our kernels are at first."""
        spacing = float(np.ptp(positions, axis=0).max()) / ACROSS
        return cls(spacing, 1.25 * spacing)

    def centers(
        self, positions: Float[np.ndarray, "sample dim"]
    ) -> Float[np.ndarray, "center dim"]:
        """Points of a grid within one spacing of the data."""
        return kernel_centers(positions, spacing=self.spacing, margin=self.spacing)


ACROSS = 12
"""Intervals of the basis along the data."""


def infer_force(
    known: Swimmer | OverdampedSwimmer,
    trajectories: Trajectories,
    noise: float,
    basis: RadialBasis | None = None,
) -> Swimmer:
    """The swimmer with the force, drag and thrust that the other tool finds.

    Args:
        known: of its thrust the direction alone is used.
        trajectories: complete, at the same times.
        noise: standard deviation of the observed positions [L].
        basis: as fine as the extent of the data asks for unless given.

    Raises:
        FitError: the tool is not installed, or the swimmer has no inertia.
    """
    if not isinstance(known, Swimmer):
        raise FitError("StochasticForceInference is asked for swimmers with inertia")
    if importlib.util.find_spec("SFI") is None:
        raise FitError(
            "StochasticForceInference is not installed; pip install 'pinav[peers]'"
        )
    positions = trajectories.states[..., :2]
    points = positions.reshape(-1, 2)
    basis = RadialBasis.of(points) if basis is None else basis
    centers, at_rest = basis.centers(points), jnp.zeros(2)
    thrust = np.asarray(known.propulsion(0.0, at_rest, at_rest))
    direction = thrust / np.linalg.norm(thrust)
    functions = _functions(jnp.asarray(centers), basis.width, jnp.asarray(direction))
    weights = _infer_coefficients(
        positions, trajectories.times[0], noise, functions, len(centers) + 2
    )
    learned = (
        LinearDrag(float(weights[-2])),
        KernelPotential(jnp.asarray(weights[:-2]), jnp.asarray(centers), basis.width),
    )
    propulsion: Any = known.propulsion
    gain = float(propulsion.gain * weights[-1] / np.linalg.norm(thrust))
    return eqx.tree_at(
        lambda s: (s.propulsion.gain, s.drag, s.environment), known, (gain, *learned)
    )


def _functions(centers: Array, width: float, direction: Array) -> Any:
    """Gradients of the radial basis, drag and thrust."""
    make = importlib.import_module("SFI.statefunc").make_basis

    def radial(x: Array) -> Array:
        offsets = (x[None] - centers) / width
        bumps = jnp.exp(-0.5 * jnp.sum(offsets**2, axis=1))
        return (bumps[:, None] * offsets / width).T

    return (
        make(radial, dim=2, rank=1, n_features=len(centers))
        & make(lambda x, *, v: -v, dim=2, rank=1, needs_v=True)
        & make(lambda x: direction + 0.0 * x, dim=2, rank=1)
    )


def _infer_coefficients(
    positions: np.ndarray, times: np.ndarray, noise: float, functions: Any, count: int
) -> Float[np.ndarray, " function"]:
    """Coefficients by the parametric estimator, then sparse selection."""
    tool: Any = importlib.import_module("SFI")
    tracks = tool.TrajectoryCollection.from_arrays(
        X=np.swapaxes(positions, 0, 1), t=times
    )
    inference = tool.UnderdampedLangevinInference(tracks)
    inference.infer_force(
        functions,
        eiv=False,
        Lambda=noise**2 * jnp.eye(2),
        D=PROCESS_NOISE * jnp.eye(2),
    )
    inference.sparsify_force(criterion="PASTIS")
    weights = np.zeros(count)
    weights[np.asarray(inference.force_support)] = inference.force_coefficients
    return weights
