r"""Gaussian priors of the weights of learned forces.

That of kernels is a Gaussian process. Each has a shape, which the evidence chooses:
length scales, envelopes, relative amplitudes. The amplitude common to all weights is
not part of it.
"""

import abc
import dataclasses
import functools

import equinox as eqx
import numpy as np
import scipy.linalg
from jaxtyping import ArrayLike, Float

Shape = Float[np.ndarray, " shape"]
"""Shape of a prior: logarithms of length scales, envelopes, ratios."""

Matrix = Float[np.ndarray, "weight weight"]
"""A number for each pair of weights, such as their covariance."""

Gram = Float[np.ndarray, "kernel kernel"]
"""A number for each pair of kernels."""

Centers = Float[np.ndarray, "kernel dim"]
"""Places of kernels [L]."""

Points = Float[np.ndarray, "point dim"]
"""Places [L], or a number along each axis at each of them."""

Bounds = Float[np.ndarray, "shape 2"]
"""Least and greatest value of each entry of a shape."""

LogVariances = tuple[Float[np.ndarray, " weight"], Float[np.ndarray, "weight shape"]]
"""Logarithm of the variance of each weight, and its derivatives by the shape."""


class AbstractPrior(eqx.Module):
    """A normal distribution of weights, of unit amplitude, that depends on a shape."""

    @property
    @abc.abstractmethod
    def start(self) -> Shape:
        """Shape at which the search begins."""

    @property
    def starts(self) -> list[Shape]:
        """Shapes of which the likeliest is where a search begins; `start` first."""
        return [self.start]

    @property
    @abc.abstractmethod
    def bounds(self) -> Bounds:
        """Between which the shape is sought."""

    @property
    def broad(self) -> "AbstractPrior":
        """This prior with a lower bound on the radius of the envelope."""
        return self

    @abc.abstractmethod
    def covariance(self, shape: Shape) -> Matrix:
        """Covariance of the weights, flattened as they are."""

    @abc.abstractmethod
    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        r"""Derivative of $\sum_{ij} P_{ij} K_{ij}$ by each entry of the shape.

        A search asks for it a thousand times; the derivatives of the covariance
        themselves would be as many matrices as the shape has entries.

        Args:
            pull: $P$, symmetric.
        """


class AbstractIndependentPrior(AbstractPrior):
    """Independent weights, whose variances depend on the shape."""

    @abc.abstractmethod
    def log_variances(self, shape: Shape) -> LogVariances:
        """The logarithms at a shape."""

    def covariance(self, shape: Shape) -> Matrix:
        return np.diag(np.exp(self.log_variances(shape)[0]))

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        logarithms, slopes = self.log_variances(shape)
        return (np.diagonal(pull) * np.exp(logarithms)) @ slopes


class IsotropicPrior(AbstractIndependentPrior):
    """Independent weights of one variance: the prior of a network, without a shape.

    References:
        MacKay, Neural Computation 4, 448 (1992).
    """

    count: int

    @property
    def start(self) -> Shape:
        return np.zeros(0)

    @property
    def bounds(self) -> Bounds:
        return np.zeros((0, 2))

    def log_variances(self, shape: Shape) -> LogVariances:
        return np.zeros(self.count), np.zeros((self.count, 0))


def _as_rows(places: Float[ArrayLike, "kernel ..."]) -> Centers:
    return np.asarray(places, float).reshape(np.shape(places)[0], -1)


class AbstractProcessPrior(AbstractPrior):
    r"""Gaussian process of weights at the places of kernels.

    $K_{ij} = A_{ij}\, M(|u_i - u_j| / \ell)$ with a correlation $M$ of distances, the
    places $u$ in widths of a kernel, and amplitudes $A_{ij}$, which are one unless a
    class says otherwise. The first entry of its shape is $\log \ell$.

    Attributes:
        centers: places of the kernels, or places along a coordinate [L].
        width: of a kernel [L].
        components: weights of each kernel, independent of each other.
    """

    centers: eqx.AbstractVar[Centers]
    width: eqx.AbstractVar[float]
    components: eqx.AbstractVar[int]

    @abc.abstractmethod
    def correlation(self, distances: Gram) -> Gram:
        r"""$M(r)$ at distances in length scales."""

    @abc.abstractmethod
    def steepness(self, distances: Gram) -> Gram:
        r"""$-\mathrm{d} \log M / \mathrm{d} \log r$ at distances in length scales."""

    def amplitudes(self, shape: Shape) -> Gram | float:
        """$A_{ij}$."""
        return 1.0

    def pull_amplitudes(self, shape: Shape, pull: Gram) -> Float[np.ndarray, " rest"]:
        r"""Derivative of $\sum_{ij} P_{ij} A_{ij}$ by the rest of the shape."""
        return np.zeros(0)

    def covariance(self, shape: Shape) -> Matrix:
        gram = self.correlation(self._distances / np.exp(shape[0]))
        gram *= self.amplitudes(shape)
        return np.kron(gram, np.eye(self.components)) if self.components > 1 else gram

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        count = len(pull) // self.components
        split = pull.reshape(count, self.components, count, self.components)
        distances = self._distances / np.exp(shape[0])
        weighed = np.einsum("icjc->ij", split) * self.correlation(distances)
        by_amplitudes = self.pull_amplitudes(shape, weighed)
        weighed *= self.amplitudes(shape)
        return np.append(np.vdot(weighed, self.steepness(distances)), by_amplitudes)

    @property
    def extent(self) -> float:
        """Largest extent of the kernels along an axis, in widths, one at least."""
        largest = np.ptp(self.centers, axis=0).max(initial=0.0) / self.width
        return max(float(largest), 1.0)

    @property
    def _places(self) -> Centers:
        return _arrange(self.centers.tobytes(), self.centers.shape, self.width)[0]

    @property
    def _distances(self) -> Gram:
        return _arrange(self.centers.tobytes(), self.centers.shape, self.width)[1]


@functools.lru_cache(maxsize=16)
def _arrange(
    centers: bytes, shape: tuple[int, int], width: float
) -> tuple[Centers, Gram]:
    """Places from the middle of the kernels, and their distances, both in widths.

    A search asks for them a thousand times.
    """
    places = np.frombuffer(centers).reshape(shape)
    places = (places - _middle(places)) / width
    # One coordinate after the other: a sum along so short an axis takes ten times as
    # long.
    along = (np.subtract.outer(x, x) ** 2 for x in places.T)
    distances = np.sqrt(sum(along, np.zeros((len(places), len(places)))))
    for array in (places, distances):
        array.flags.writeable = False
    return places, distances


def _middle(centers: Centers) -> Float[np.ndarray, " dim"]:
    return (centers.min(axis=0) + centers.max(axis=0)) / 2


class StationaryPrior(AbstractProcessPrior):
    r"""Gaussian process that fades nowhere, and is rough.

    $K = e^{-r/\ell}$ of the distance r between kernels or, where the field's slope
    matters, Matern's $(1 + a) e^{-a}$ with $a = \sqrt3 r/\ell$. As $\ell$ grows these
    become a random walk of the field, or of its slope: smoothing splines, which assume
    no scale below which a field is smooth. The kernels filter what is finer than they.
    For fields in coordinates of their own, such as an angle, no place of which is the
    middle.

    References:
        Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections
        4.2 and 6.3.
    """

    centers: Centers = eqx.field(converter=_as_rows)
    width: float = eqx.field(converter=float)
    components: int = 1
    smooth: bool = False

    @property
    def start(self) -> Shape:
        return np.array([1.0])

    @property
    def bounds(self) -> Bounds:
        return np.array([(-1.2, np.log(10 * self.extent))])

    def correlation(self, distances: Gram) -> Gram:
        a = np.sqrt(3.0) * distances
        return (1 + a) * np.exp(-a) if self.smooth else np.exp(-distances)

    def steepness(self, distances: Gram) -> Gram:
        a = np.sqrt(3.0) * distances
        return a * a / (1 + a) if self.smooth else distances


BROAD = 0.5
"""Reach of an envelope, as a share of the extent of the kernels, that is no hill's."""

MIDDLE = 0.6
"""Share of the extent of kernels in which the middle of an envelope lies: as they are
laid, a fifth of them or more on each side is beyond the data."""


class AbstractFadingPrior(AbstractProcessPrior):
    r"""Gaussian process that may fade away from a place, down to a floor.

    $A_{ij} = D_i D_j + \varphi^2$ with the envelope
    $D_i = \exp(-|u_i - m|^2 / 2 R^2)$. After $\log \ell$ the shape holds $\log R$, and
    $m$ from the middle of the kernels, all in widths.

    Attributes:
        floor: $\varphi$, below which no standard deviation falls, relative to where it
            is largest.
    """

    floor: eqx.AbstractVar[float]

    @property
    def start(self) -> Shape:
        middle = np.zeros(self.centers.shape[1])
        return np.append([0.5, np.log(BROAD * self.extent)], middle)

    def amplitudes(self, shape: Shape) -> Gram:
        envelope = self._envelope(shape, self._places)
        return np.outer(envelope, envelope) + self.floor**2

    def pull_amplitudes(self, shape: Shape, pull: Gram) -> Float[np.ndarray, " rest"]:
        from_middle = self._places - shape[2:]
        envelope = self._envelope(shape, self._places)
        # Both kernels of a pair have an envelope, and the pull is symmetric.
        pulled = 2 * envelope * (pull @ envelope) / np.exp(2 * shape[1])
        squares = (from_middle**2).sum(axis=-1)
        return np.append(pulled @ squares, pulled @ from_middle)

    def _bounds(self, narrowest: float, share: float) -> Bounds:
        """The bounds, with a least reach and a middle that are shares of the extent."""
        longest, half = np.log(10 * self.extent), 0.5 * share * self.extent
        least = np.log(max(narrowest * self.extent, 1.0))
        middle = [(-half, half)] * self.centers.shape[1]
        return np.array([(-1.2, longest), (least, longest), *middle])

    @staticmethod
    def _envelope(
        shape: Shape, places: Float[np.ndarray, "*point dim"]
    ) -> Float[np.ndarray, "*point"]:
        squares = ((places - shape[2:]) ** 2).sum(axis=-1)
        return np.exp(-0.5 / np.exp(2 * shape[1]) * squares)


class WeightPrior(AbstractFadingPrior):
    r"""Gaussian-process prior of the weights of one environment, of unit amplitude.

    Its correlation is $\exp(-r^2 / 2)$: a field of length scale $\ell$ that may fade
    away from a place. Where nothing fades the evidence makes R large, and the prior is
    stationary. The envelope is what separates an obstacle from a constant force: a
    stationary prior takes a slope over the whole domain for an obstacle.

    A search begins with a wide envelope about the middle of the kernels. It does not
    leave the middle `MIDDLE` of them, where data are: the tail of an envelope whose
    middle is far from all data explains a wall as well as a wall does.

    Attributes:
        narrowest: least reach of the envelope, as a share of the extent of the kernels;
            at any rate one width.
    """

    centers: Centers = eqx.field(converter=_as_rows)
    width: float = eqx.field(converter=float)
    components: int = 1
    narrowest: float = 0.0
    floor: float = 0.0

    @property
    def bounds(self) -> Bounds:
        return self._bounds(self.narrowest, MIDDLE)

    @property
    def broad(self) -> "WeightPrior":
        return dataclasses.replace(self, narrowest=BROAD)

    def correlation(self, distances: Gram) -> Gram:
        return np.exp(-0.5 * distances * distances)

    def steepness(self, distances: Gram) -> Gram:
        return distances * distances


class ProfilePrior(AbstractFadingPrior):
    r"""Prior of a profile along one coordinate, of few derivatives, that may fade.

    A profile changes its width along its coordinate: a wall is steep at its foot and
    flat behind it, a hill has a summit and tails. A process that is smooth without end
    takes what it sees of such a profile in one place for what it must be in another,
    and its band is too sure. Its correlation is Matern's of order 7/2,
    $M(r) = (1 + a + \tfrac25 a^2 + \tfrac1{15} a^3) e^{-a}$ with $a = \sqrt7\, r$.
    Where the data end, an envelope that they chose knows nothing: without the floor its
    band would be too sure.

    References:
        Stein, Interpolation of Spatial Data (1999), section 1.7; Rasmussen and
        Williams, Gaussian Processes for Machine Learning (2006), section 4.2.
    """

    centers: Centers = eqx.field(converter=_as_rows)
    width: float = eqx.field(converter=float)
    components: int = 1
    floor: float = 0.01

    @property
    def bounds(self) -> Bounds:
        return self._bounds(0.0, 1.0)

    def correlation(self, distances: Gram) -> Gram:
        a = np.sqrt(7.0) * distances
        return (1 + a * (1 + a * (0.4 + a / 15))) * np.exp(-a)

    def steepness(self, distances: Gram) -> Gram:
        a = np.sqrt(7.0) * distances
        return a * a * (3 + a * (3 + a)) / (15 + a * (15 + a * (6 + a)))


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
    def bounds(self) -> Bounds:
        return self.base.bounds

    def covariance(self, shape: Shape) -> Matrix:
        return self.base.covariance(shape) * self._squares

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        return self.base.pullback(shape, pull * self._squares)

    @property
    def _squares(self) -> Gram:
        distances = self.base.centers / self.base.centers.max()
        return np.outer(distances, distances)


SMOOTH, REACHES = 1.5, (0.3, 0.1, 0.05)
"""Logarithm of the length scale, in widths of a kernel, at which profiles begin, and
reaches of the envelope, as shares of the extent of the kernels."""


LOG_RATIO = 8.0
"""Largest logarithm of the ratio of two amplitudes: one part then is nothing."""


class MixturePrior(AbstractPrior):
    """Prior of two parts of a force, independent of each other.

    Each part has a length scale and an envelope of its own. The last entry of the shape
    is the logarithm of the amplitude of the second relative to that of the first: where
    it is low the first part is all there is.

    Attributes:
        first_ratio: logarithm of the ratio of amplitudes at which a search begins.
        unit: amplitude of the second part, over that of the first, at a ratio of one:
            weights may be energies here and forces there, and no choice may depend on
            the unit of length.
    """

    first: AbstractPrior
    second: AbstractPrior
    first_ratio: float = 0.0
    least_ratio: float = -LOG_RATIO
    most_ratio: float = LOG_RATIO
    unit: float = 1.0

    @property
    def start(self) -> Shape:
        return self._join(self.first.start, self.second.start)

    @property
    def starts(self) -> list[Shape]:
        """One part differs from its start at a time."""
        first = [self._join(shape, self.second.start) for shape in self.first.starts]
        second = [self._join(self.first.start, shape) for shape in self.second.starts]
        return first + second[1:]

    @property
    def broad(self) -> "MixturePrior":
        first, second = self.first.broad, self.second.broad
        return dataclasses.replace(self, first=first, second=second)

    def _join(
        self, first: Float[np.ndarray, " first"], second: Float[np.ndarray, " second"]
    ) -> Shape:
        return np.concatenate([first, second, [self.first_ratio]])

    @property
    def bounds(self) -> Bounds:
        ratio = [[self.least_ratio, self.most_ratio]]
        return np.concatenate([self.first.bounds, self.second.bounds, ratio])

    def split(
        self, shape: Shape
    ) -> tuple[Float[np.ndarray, " first"], Float[np.ndarray, " second"], float]:
        """The shapes of both parts, and the ratio of amplitudes of their weights."""
        half = len(self.first.start)
        ratio = float(self.unit * np.exp(shape[-1]))
        return shape[:half], shape[half:-1], ratio

    def covariance(self, shape: Shape) -> Matrix:
        first, second, ratio = self.split(shape)
        first, second = self.first.covariance(first), self.second.covariance(second)
        return np.asarray(scipy.linalg.block_diag(first, ratio**2 * second))

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        first, second, ratio = self.split(shape)
        covariance = self.second.covariance(second)
        last = len(covariance)
        pull_first, pull_second = pull[:-last, :-last], ratio**2 * pull[-last:, -last:]
        return np.concatenate(
            [
                self.first.pullback(first, pull_first),
                self.second.pullback(second, pull_second),
                [2 * np.vdot(pull_second, covariance)],
            ]
        )


ABSENT = 0.5 * LOG_RATIO
"""Logarithm of a ratio of amplitudes at which one part is all there is."""


class TimedPrior(AbstractPrior):
    r"""Prior of a potential that changes with time.

    The product of a `WeightPrior` in space and $\exp(-(k - k')^2 / 2\tau^2)$ between
    splines. The last entry of the shape is $\log\tau$, in intervals. As $\tau$ grows
    the prior becomes that of a static potential.
    """

    space: WeightPrior
    splines: int

    @property
    def start(self) -> Shape:
        return np.append(self.space.start, 1.0)

    @property
    def bounds(self) -> Bounds:
        return np.concatenate([self.space.bounds, [[-0.5, LOG_STATIC]]])

    def covariance(self, shape: Shape) -> Matrix:
        space = self.space.covariance(shape[:-1])
        return np.kron(space, np.exp(-0.5 * self._gaps(shape)))

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        gaps = self._gaps(shape)
        time = np.exp(-0.5 * gaps)
        count = len(pull) // self.splines
        split = pull.reshape(count, self.splines, count, self.splines)
        by_space = self.space.pullback(
            shape[:-1], np.einsum("ikjl,kl->ij", split, time)
        )
        by_time = np.einsum(
            "ikjl,ij,kl", split, self.space.covariance(shape[:-1]), gaps * time
        )
        return np.append(by_space, by_time)

    def _gaps(self, shape: Shape) -> Float[np.ndarray, "spline spline"]:
        """Squared distances in time, in correlation times."""
        index = np.arange(self.splines)
        return ((index[:, None] - index[None]) / np.exp(shape[-1])) ** 2


LOG_STATIC = 12.0
r"""$\log\tau$ at which a change in time is too slow for any data to show."""
