r"""Gaussian priors of the weights of learned forces.

That of kernels is a Gaussian process. Each has a shape, which the evidence chooses:
length scales, envelopes, relative amplitudes. The amplitude common to all weights is
not part of it.
"""

import abc
import dataclasses
import functools
import operator

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
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
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


def _exact(values: Float[ArrayLike, "kernel dim"]) -> Centers:
    return np.asarray(values, float)


class WeightPrior(AbstractPrior):
    r"""Gaussian-process prior of the weights of one environment, of unit amplitude.

    $K_{ij} = D_i D_j \exp(-|c_i - c_j|^2 / 2\ell^2)$ with the envelope
    $D_i = \exp(-|c_i - m|^2 / 2 R^2)$: a field of length scale $\ell$ that may fade
    away from a place. Where nothing fades the evidence makes R large, and the prior is
    stationary. The envelope is what separates an obstacle from a constant force: a
    stationary prior takes a slope over the whole domain for an obstacle.

    Its shape is $\log \ell$, $\log R$, and $m$ from the middle, all in widths; a search
    begins with a wide envelope about the middle of the kernels. It does not leave the
    middle `MIDDLE` of them, where data are: the tail of an envelope whose middle is far
    from all data explains a wall as well as a wall does.

    Attributes:
        components: weights of each kernel, independent of each other.
        narrowest: least reach of the envelope, as a share of the extent of the kernels;
            at any rate one width.
    """

    centers: Centers = eqx.field(converter=_exact)
    width: float = eqx.field(converter=float)
    components: int = 1
    narrowest: float = 0.0

    @property
    def start(self) -> Shape:
        return np.append([0.5, np.log(BROAD * self._extent)], np.zeros(self._dim))

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        extent = self._extent
        half = 0.5 * MIDDLE * extent
        least = np.log(max(self.narrowest * extent, 1.0))
        scales = [(-1.2, np.log(10 * extent)), (least, np.log(10 * extent))]
        return np.array(scales + [(-half, half)] * self._dim)

    @property
    def broad(self) -> "WeightPrior":
        return dataclasses.replace(self, narrowest=BROAD)

    def covariance(self, shape: Shape) -> Matrix:
        return _per_component(self._scalar(shape), self.components)

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        length_scale, reach = np.exp(shape[:2])
        from_middle = self._scaled_centers - shape[2:]
        weighed = _over_components(pull, self.components) * self._scalar(shape)
        by_scale = np.vdot(weighed, self._squares) / length_scale**2
        # Both kernels of a pair have an envelope, and the pull is symmetric.
        by_envelope = 2 * weighed.sum(axis=1) / reach**2
        squares = (from_middle**2).sum(axis=-1)
        return np.array([by_scale, by_envelope @ squares, *(by_envelope @ from_middle)])

    def variance(
        self,
        shape: Shape,
        places: Float[np.ndarray, "point place dim"],
        forces: Float[np.ndarray, "point place dim"],
    ) -> Float[np.ndarray, "point dim"]:
        r"""Prior variance of $\sum_j w_j f_j$ at points, with kernels at other places.

        Args:
            places: of kernels about each point, alike but for a shift [L].
            forces: $f_j$ of each of them at the point.
        """
        scaled = (places - self._middle) / self.width
        faded = forces * self._envelope(shape, scaled)[..., None]
        apart = scaled[0][:, None] - scaled[0]
        alike = np.exp(-0.5 * (apart**2).sum(axis=-1) / np.exp(2 * shape[0]))
        return np.sum(faded * np.einsum("ij,pjd->pid", alike, faded), axis=1)

    def draw(
        self,
        shape: Shape,
        centers: Centers,
        generator: np.random.Generator,
    ) -> Float[np.ndarray, "kernel component"]:
        r"""Weights drawn from the prior for kernels at other places, however many.

        $w = D\,M^{-1/2} \sum_m a_m \cos(\omega_m c) + b_m \sin(\omega_m c)$ with
        standard normal $a$ and $b$, and $\omega$ normal with a deviation of $1/\ell$:
        random Fourier features, whose covariance is that of the prior.

        References:
            Rahimi and Recht, Advances in Neural Information Processing Systems 20
            (2007).
        """
        scaled = (centers - self._middle) / self.width
        waves = generator.normal(size=(self._dim, FEATURES)) / np.exp(shape[0])
        phases = scaled @ waves
        parts = np.concatenate([np.cos(phases), np.sin(phases)], axis=1)
        normal = generator.normal(size=(2 * FEATURES, self.components))
        envelope = self._envelope(shape, scaled)[:, None]
        return envelope * (parts @ normal) / np.sqrt(FEATURES)

    def _scalar(self, shape: Shape) -> Gram:
        envelope = self._envelope(shape, self._scaled_centers)
        alike = np.exp(-0.5 / np.exp(2 * shape[0]) * self._squares)
        return alike * np.outer(envelope, envelope)

    @staticmethod
    def _envelope(
        shape: Shape, scaled: Float[np.ndarray, "*point dim"]
    ) -> Float[np.ndarray, "*point"]:
        squares = ((scaled - shape[2:]) ** 2).sum(axis=-1)
        return np.exp(-0.5 * squares / np.exp(2 * shape[1]))

    @property
    def _squares(self) -> Gram:
        scaled = np.ascontiguousarray(self._scaled_centers)
        return _squares(scaled.tobytes(), self._dim)

    @property
    def _scaled_centers(self) -> Centers:
        return (self.centers - self._middle) / self.width

    @property
    def _middle(self) -> Float[np.ndarray, " dim"]:
        return (self.centers.min(axis=0) + self.centers.max(axis=0)) / 2

    @property
    def _extent(self) -> float:
        return float(max(np.ptp(self._scaled_centers, axis=0).max(), 1.0))

    @property
    def _dim(self) -> int:
        return self.centers.shape[1]


def _per_component(scalar: Gram, components: int) -> Matrix:
    return np.kron(scalar, np.eye(components)) if components > 1 else scalar


def _over_components(pull: Matrix, components: int) -> Gram:
    """Adjoint of `_per_component`: the sum over the components."""
    count = len(pull) // components
    split = pull.reshape(count, components, count, components)
    return np.einsum("icjc->ij", split)


@functools.lru_cache(maxsize=8)
def _squares(centers: bytes, dim: int) -> Gram:
    """Squared distances between centres; a search asks for them a thousand times."""
    points = np.frombuffer(centers).reshape(-1, dim)
    # one coordinate after the other: a sum along so short an axis takes ten times as
    # long
    along = (np.subtract.outer(x, x) ** 2 for x in points.T)
    squares = functools.reduce(operator.add, along)
    squares.flags.writeable = False
    return squares


BROAD = 0.5
"""Reach of an envelope, as a share of the extent of the kernels, that is no hill's."""

MIDDLE = 0.6
"""Share of the extent of kernels in which the middle of an envelope lies: as they are
laid, a fifth of them or more on each side is beyond the data."""


FEATURES = 256
"""Waves of which weights of the prior are drawn."""


class StationaryPrior(AbstractPrior):
    r"""Gaussian-process prior of weights that fades nowhere, and is rough.

    $K = e^{-r/\ell}$ of the distance r between kernels or, where the field's slope
    matters, Matern's $(1 + a) e^{-a}$ with $a = \sqrt3 r/\ell$. As $\ell$ grows these
    become a random walk of the field, or of its slope: smoothing splines, which assume
    no scale below which a field is smooth. The kernels filter what is finer than they.
    For fields in coordinates of their own, such as an angle, no place of which is the
    middle. Its shape is $\log\ell$, in spacings of the kernels.

    References:
        Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections
        4.2 and 6.3.
    """

    centers: Centers = eqx.field(converter=_exact)
    components: int = 1
    smooth: bool = False

    @property
    def start(self) -> Shape:
        return np.array([1.0])

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        extent = max(float(np.ptp(self.centers, axis=0).max(initial=0.0)), 1.0)
        return np.array([(-1.2, np.log(10 * extent))])

    def covariance(self, shape: Shape) -> Matrix:
        scaled = self._relative_distances(shape)
        gram = np.exp(-scaled) * (1 + scaled if self.smooth else 1.0)
        return _per_component(gram, self.components)

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        scaled = self._relative_distances(shape)
        slope = np.exp(-scaled) * (scaled**2 if self.smooth else scaled)
        return np.array([np.vdot(_over_components(pull, self.components), slope)])

    def _relative_distances(self, shape: Shape) -> Gram:
        offsets = self.centers[:, None] - self.centers[None]
        root = np.sqrt(3.0) if self.smooth else 1.0
        return root * np.sqrt((offsets**2).sum(axis=-1)) / np.exp(shape[0])


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
        self,
        first: Float[np.ndarray, " first"],
        second: Float[np.ndarray, " second"],
    ) -> Shape:
        return np.concatenate([first, second, [self.first_ratio]])

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
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
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
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


class IsotropicPrior(AbstractPrior):
    """Independent weights of one variance: the prior of a network, without a shape.

    References:
        MacKay, Neural Computation 4, 448 (1992).
    """

    count: int

    @property
    def start(self) -> Shape:
        return np.zeros(0)

    @property
    def bounds(self) -> Float[np.ndarray, "shape 2"]:
        return np.zeros((0, 2))

    def covariance(self, shape: Shape) -> Matrix:
        return np.eye(self.count)

    def pullback(self, shape: Shape, pull: Matrix) -> Shape:
        return np.zeros(0)
