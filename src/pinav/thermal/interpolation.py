r"""Values between the centres of cells, linear in the thermal resistance.

Along $x$ the flux $-k\,\partial T/\partial x$ is continuous where $k$ jumps, so that
temperature is linear in $\rho = \int dx/k$ across the jump, not in $x$. A cell's
temperature is that of the middle of its resistance. A cell whose conductivity lies
between those of its neighbours is cut: with $1/k$ averaged by volume, the share of each
neighbour's material says where the jump is.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.thermal.quantities import Number


class ResistanceScale(eqx.Module):
    """Thermal resistance along a line of cells.

    Attributes:
        places: faces and jumps of the conductivity within cells [m].
        resistances: up to these places [m² K W⁻¹].
        values: up to the middle of each cell's resistance.
    """

    places: Float[np.ndarray, " place"]
    resistances: Float[np.ndarray, " place"]
    values: Float[np.ndarray, " cell"]

    @classmethod
    def of(
        cls,
        edges: Float[np.ndarray, " face"],
        conductivity: Float[np.ndarray, " cell"],
    ) -> "ResistanceScale":
        """That of cells between edges [m], of a conductivity each [W m⁻¹ K⁻¹]."""
        resistivity, sizes = 1 / np.asarray(conductivity, float), np.diff(edges)
        faces = np.append(0.0, np.cumsum(resistivity * sizes))
        before, after = resistivity[:-2], resistivity[2:]
        change = np.where(before == after, 1.0, before - after)
        fraction = (resistivity[1:-1] - after) / change
        cut = (before != after) & (fraction > 0) & (fraction < 1)
        jumps = edges[1:-2] + fraction * sizes[1:-1]
        at_jumps = faces[1:-2] + fraction * sizes[1:-1] * before
        places = np.append(edges, jumps[cut])
        order = np.argsort(places)
        return cls(
            places=places[order],
            resistances=np.append(faces, at_jumps[cut])[order],
            values=0.5 * (faces[1:] + faces[:-1]),
        )

    def at(self, place: Number) -> float:
        """Resistance up to a place [m]."""
        return float(np.interp(place, self.places, self.resistances))

    def weights(self, place: Number) -> Float[np.ndarray, " cell"]:
        """Weights of the cells in the value at a place [m]."""
        return linear_weights(self.at(place), self.values)


def linear_weights(
    at: Number, nodes: Float[np.ndarray, " node"]
) -> Float[np.ndarray, " node"]:
    """Weights of linear interpolation, continued beyond the first and last node."""
    index = int(np.clip(np.searchsorted(nodes, at) - 1, 0, len(nodes) - 2))
    fraction = (at - nodes[index]) / (nodes[index + 1] - nodes[index])
    weights = np.zeros(len(nodes))
    weights[index], weights[index + 1] = 1 - fraction, fraction
    return weights
