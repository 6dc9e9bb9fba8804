r"""Gaussian-process priors of profiles: forces along one coordinate.

A profile changes its width along its coordinate: a wall is steep at its foot and flat
behind it, a hill has a summit and tails. A process that is smooth without end takes
what it sees of such a profile in one place for what it must be in another, and its band
is too sure; Matern's processes have few derivatives, so that each place tells of its
own neighbourhood.

References:
    Stein, Interpolation of Spatial Data (1999), section 1.7; Rasmussen and Williams,
    Gaussian Processes for Machine Learning (2006), section 4.2.
"""

import functools

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float

from pinav.forces.priors import AbstractPrior, Gram, Matrix, Shape

Places = Float[np.ndarray, " kernel"]


def _exact(values: Float[ArrayLike, " kernel"]) -> Places:
    return np.asarray(values, float)


class ProfilePrior(AbstractPrior):
    r"""Prior of a profile: a process of few derivatives that may fade, down to a floor.

    $K_{ij} = (D_i D_j + \varphi^2) M(|\rho_i - \rho_j| / \ell)$ with the envelope
    $D_i = \exp(-(\rho_i - m)^2 / 2 R^2)$ and Matern's covariance of order 7/2,
    $M(r) = (1 + a + \tfrac25 a^2 + \tfrac1{15} a^3) e^{-a}$, $a = \sqrt7\, r$. Where
    the data end, an envelope that they chose knows nothing, and without the floor its
    band would be too sure.

    Its shape is $\log \ell$, $\log R$, and $m$ from the middle, all in widths.

    Attributes:
        places: $\rho$ of the kernels [L].
        width: of a kernel [L].
        floor: $\varphi$, below which no standard deviation falls, relative to where it
            is largest.
    """

    places: Places = eqx.field(converter=_exact)
    width: float = eqx.field(converter=float)
    floor: float = 0.01

    @property
    def start(self) -> Shape:
        return np.array([0.5, np.log(0.5 * self._extent), 0.0])

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        half, longest = 0.5 * self._extent, np.log(10 * self._extent)
        return np.array([(-1.2, longest), (0.0, longest), (-half, half)])

    def covariance(self, shape: Shape) -> Matrix:
        alike, _, _ = _matern(self._distances, shape[0])
        envelope, _ = self._envelope(shape)
        return alike * (np.outer(envelope, envelope) + self.floor**2)

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        alike, a, fade = _matern(self._distances, shape[0])
        by_scale = a * a * (3 + 3 * a + a * a) / 15 * fade
        envelope, by_place = self._envelope(shape)
        faded = np.outer(envelope, envelope)
        # Both kernels of a pair have an envelope, and the pull is symmetric.
        by_envelope = 2 * (pull * alike * faded).sum(axis=1)
        return np.array(
            [
                np.vdot(pull, by_scale * (faded + self.floor**2)),
                by_envelope @ by_place**2 * np.exp(2 * shape[1]),
                by_envelope @ by_place,
            ]
        )

    def _envelope(self, shape: Shape) -> tuple[Places, Places]:
        """The envelope, and the derivative of its logarithm by its middle."""
        offsets, reach = self._scaled_places - shape[2], np.exp(shape[1])
        return np.exp(-0.5 * (offsets / reach) ** 2), offsets / reach**2

    @property
    def _scaled_places(self) -> Places:
        middle = (self.places.min() + self.places.max()) / 2
        return (self.places - middle) / self.width

    @property
    def _distances(self) -> Gram:
        return _gaps(np.ascontiguousarray(self._scaled_places).tobytes())

    @property
    def _extent(self) -> float:
        return max(float(np.ptp(self._scaled_places)), 1.0)


@functools.lru_cache(maxsize=32)
def _gaps(places: bytes) -> Gram:
    """Distances between places; a search asks for the same ones a thousand times."""
    numbers = np.frombuffer(places)
    gaps = np.abs(np.subtract.outer(numbers, numbers))
    gaps.flags.writeable = False
    return gaps


def _matern(distances: Gram, log_scale: float) -> tuple[Gram, Gram, Gram]:
    """Matern's covariance of order 7/2, its argument, and the exponential in it."""
    a = np.sqrt(7.0) / np.exp(log_scale) * distances
    fade, squares = np.exp(-a), a * a
    return (1 + a + 0.4 * squares + squares * a / 15) * fade, a, fade


class DistancePrior(AbstractPrior):
    r"""Prior of a profile of a distance: $\rho_i \rho_j$ times a `ProfilePrior`.

    The force of a smooth potential grows with the distance. With an infinite length
    scale the envelope about zero leaves the force of a Gaussian, where a search begins.
    """

    base: ProfilePrior

    @property
    def start(self) -> Shape:
        return self.starts[0]

    @property
    def starts(self) -> list[Shape]:
        """Envelopes of several reaches: swimmers may be flung far out of a hill."""
        low, high = self.bounds[2]
        reaches = np.log(np.array(REACHES) * (high - low))
        return [np.array([SMOOTH, reach, 0.99 * low]) for reach in reaches]

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        return self.base.bounds

    def covariance(self, shape: Shape) -> Matrix:
        return self.base.covariance(shape) * self._scales

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        return self.base.pullback(shape, pull * self._scales)

    @property
    def _scales(self) -> Gram:
        places = self.base.places / self.base.places.max()
        return np.outer(places, places)


SMOOTH, REACHES = 1.5, (0.3, 0.1, 0.05)
"""Logarithm of the length scale, in widths of a kernel, at which profiles begin, and
reaches of the envelope, as shares of the extent of the kernels."""
