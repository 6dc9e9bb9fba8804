"""The learned force on visited ground, how well it is known, and whether it is central.

Neighbouring values of a learned field share their errors, so points are never counted
as independent: everything is weighted by the joint covariance of the force.
"""

import enum
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.special
from jaxtyping import Float

from pinav.errors import InputError
from pinav.fitting import Posterior
from pinav.fitting.engine.posterior import force_jacobians
from pinav.forces import AbstractForce, forces_at
from pinav.forces.geometries import Landscape
from pinav.forces.priors import Points
from pinav.trajectories import Trajectories

FLOOR = 0.01
"""Error of any learned field in each direction, relative to its root mean square.

A finite basis and its prior bend every law by about this much, whatever the noise."""

MAX_POINTS = 120
"""More points on visited ground say nothing new about a smooth field."""


class ForceSample(eqx.Module):
    """A planar force [L T⁻²] at positions [L], with the joint covariance of its errors.

    Attributes:
        num_effective: number of independent numbers that the data tell about it.

    Raises:
        InputError: the shapes do not fit together, or there are under four points.
    """

    positions: Points
    force: Points
    covariance: Float[np.ndarray, "component component"]
    num_effective: float

    def __check_init__(self) -> None:
        points, size = len(self.positions), self.force.size
        if (
            points < 4
            or self.positions.shape != (points, 2)
            or self.force.shape != (points, 2)
            or self.covariance.shape != (size, size)
        ):
            raise InputError(
                "ForceSample: expected four or more planar positions, as many forces "
                f"and a covariance of twice that size, got {self.positions.shape}, "
                f"{self.force.shape} and {self.covariance.shape}"
            )

    @property
    def sd(self) -> Points:
        """Standard deviation of each component [L T⁻²]."""
        variances = np.maximum(np.diag(self.covariance), 0.0)
        return np.sqrt(variances).reshape(self.force.shape)

    @property
    def strength(self) -> float:
        """Root-mean-square magnitude [L T⁻²]."""
        return float(np.sqrt(np.mean(np.sum(self.force**2, axis=1))))

    @property
    def total_covariance(self) -> Float[np.ndarray, "component component"]:
        """The covariance with the error of `FLOOR` in every direction."""
        floor = max(FLOOR * self.strength, np.finfo(float).tiny ** 0.25)
        return self.covariance + floor**2 * np.eye(self.force.size)

    @property
    def whitener(self) -> Float[np.ndarray, "component component"]:
        """Rows that make the errors of the force independent, of unit variance."""
        values, vectors = np.linalg.eigh(self.total_covariance)
        floor = np.finfo(float).eps * values[-1]
        return vectors.T / np.sqrt(np.maximum(values, floor))[:, None]

    @property
    def extent(self) -> float:
        """Longest side of the box around the points [L]."""
        return float(np.ptp(self.positions, axis=0).max())

    @property
    def landscape(self) -> Landscape:
        """Centre, lengths and main direction, for the starts of fits."""
        positions, force = self.positions, self.force
        low, high = positions.min(axis=0), positions.max(axis=0)
        margin = 0.5 * self.extent
        size = np.linalg.norm(force, axis=1)
        central = np.clip(_linear_center(self), low - margin, high + margin)
        weighted = (size @ positions) / max(size.sum(), np.finfo(float).tiny)
        strong = size >= np.quantile(size, 0.9)
        reach = np.median(np.linalg.norm(positions[strong] - central, axis=1))
        reach = max(float(reach), 0.05 * self.extent)
        axis = np.linalg.eigh(force.T @ force)[1][:, -1]
        return Landscape(
            centers=tuple((float(c[0]), float(c[1])) for c in (central, weighted)),
            lengths=(0.5 * reach, reach, 2 * reach),
            direction=float(np.arctan2(axis[1], axis[0])),
            extent=self.extent,
        )

    def less(self, force: Points) -> "ForceSample":
        """The sample less a known force."""
        return eqx.tree_at(lambda s: s.force, self, self.force - force)


class Sampling(eqx.Module):
    """Points [L], spread over visited ground, at which a learned force is sampled.

    Attributes:
        times: when trajectories were there [T].
    """

    posterior: Posterior
    positions: Points
    times: Float[np.ndarray, " point"]
    num_effective: float

    @classmethod
    def of(
        cls, posterior: Posterior, trajectories: Trajectories, num_effective: float
    ) -> "Sampling":
        """Points among the observed positions of a plane, each far from the others."""
        if len(trajectories.channels) not in (2, 4):
            raise InputError(
                "law discovery: expected planar trajectories, got the channels "
                f"{', '.join(trajectories.channels)}"
            )
        is_observed = trajectories.observed[..., :2].all(axis=-1)
        positions = trajectories.states[..., :2][is_observed]
        chosen = spread_points(positions, MAX_POINTS)
        times = trajectories.times[is_observed][chosen]
        return cls(posterior, positions[chosen], times, num_effective)

    def sample(self, part: Callable[[Any], AbstractForce]) -> ForceSample:
        """A part of the learned force, such as one of its terms."""
        free, positions, times = self.posterior.free, self.positions, self.times
        with jax.enable_x64(new_val=True):
            environment = self.posterior.model.environment
            force = forces_at(part(environment), times, positions)
            mean, points = jnp.asarray(self.posterior.mean), jnp.asarray(positions)
            jacobians = force_jacobians(free, mean, points, jnp.asarray(times), part)
        rows = np.asarray(jacobians).reshape(-1, len(mean))
        return ForceSample(
            positions=positions,
            force=np.asarray(force),
            covariance=rows @ self.posterior.covariance @ rows.T,
            num_effective=self.num_effective,
        )


def spread_points(positions: Points, count: int) -> np.ndarray:
    """Indices of at most `count` points, each the farthest from those before it."""
    chosen = [0]
    distance = np.linalg.norm(positions - positions[0], axis=1)
    while len(chosen) < count and distance.max() > 0:
        chosen.append(int(np.argmax(distance)))
        new = np.linalg.norm(positions - positions[chosen[-1]], axis=1)
        distance = np.minimum(distance, new)
    return np.array(chosen)


class Centrality(enum.Enum):
    """Result of the test for a central force."""

    CENTRAL = "central"
    NOT_CENTRAL = "not central"
    UNDECIDED = "not identifiable"


class CentralTest(eqx.Module):
    r"""Test that a force points to or from one place, $F \times (x - c) = 0$.

    Attributes:
        center: $c$ [L], where the condition is fulfilled best.
        ratio: root-mean-square tangential force over the radial one.
        noise_ratio: what the uncertainty of a central force makes of it on average.
        p_value: probability of a ratio this large if the force is central.
        extent: of the points [L].
    """

    DERIVED: ClassVar = ("verdict",)

    center: tuple[float, float]
    center_sd: tuple[float, float]
    ratio: float
    noise_ratio: float
    p_value: float
    extent: float

    @property
    def verdict(self) -> Centrality:
        """Not central where p < 0.01.

        Undecided where noise hides a ratio of 0.3, or the centre is less certain than
        the points are far apart.
        """
        if self.p_value < 0.01:
            return Centrality.NOT_CENTRAL
        if not (self.noise_ratio < 0.3 and max(self.center_sd) < self.extent):
            return Centrality.UNDECIDED
        return Centrality.CENTRAL


def central_test(sample: ForceSample) -> CentralTest:
    """Test a force for a centre, found by weighted linear least squares.

    The tangential force is compared with its own uncertainty: the sum of its squares
    is a sum of weighted chi-squares, whose first two moments set those of one.

    References:
        Satterthwaite, Biometrics Bulletin 2, 110 (1946).
    """
    center, spread = _center(sample)
    offsets = sample.positions - center
    distance = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)
    outward = offsets / distance[:, None]
    tangents = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
    tangential = np.sum(tangents * sample.force, axis=1)
    radial = np.sum(outward * sample.force, axis=1)
    covariance = project_covariance(sample.total_covariance, tangents)
    mean, variance = np.trace(covariance), 2 * np.sum(covariance**2)
    statistic = float(np.sum(tangential**2))
    p_value = scipy.special.chdtrc(
        2 * mean**2 / variance, 2 * mean * statistic / variance
    )
    strength = max(float(np.sqrt(np.sum(radial**2))), np.finfo(float).tiny)
    return CentralTest(
        center=(float(center[0]), float(center[1])),
        center_sd=(float(spread[0]), float(spread[1])),
        ratio=float(np.sqrt(statistic)) / strength,
        noise_ratio=float(np.sqrt(mean)) / strength,
        p_value=float(p_value),
        extent=sample.extent,
    )


def _conditions(
    sample: ForceSample,
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, " point"]]:
    """F × (x − c) = 0 as rows and targets of a linear problem for c."""
    (x, y), (fx, fy) = sample.positions.T, sample.force.T
    return np.stack([-fy, fx], axis=1), fx * y - fy * x


def _linear_center(sample: ForceSample) -> Float[np.ndarray, "2"]:
    """The centre by least squares, all conditions weighted alike."""
    return np.linalg.lstsq(*_conditions(sample), rcond=1e-12)[0]


def _center(
    sample: ForceSample,
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The centre and its standard deviations.

    Linear least squares first. Errors of the force pull that towards the data, so the
    weights then follow the centre: each condition has the variance of F × (x − c).
    """
    rows, targets = _conditions(sample)

    def factor(center: Float[np.ndarray, "2"]) -> Float[np.ndarray, "point point"]:
        offsets = sample.positions - center
        arms = np.stack([offsets[:, 1], -offsets[:, 0]], axis=1)
        covariance = project_covariance(sample.total_covariance, arms)
        ridge = 1e-9 * np.trace(covariance) / len(rows) + np.finfo(float).tiny
        return np.linalg.cholesky(covariance + ridge * np.eye(len(rows)))

    def misfit(center: Float[np.ndarray, "2"]) -> float:
        white = np.linalg.solve(factor(center), rows @ center - targets)
        return float(white @ white)

    start = _linear_center(sample)
    options = {"xatol": 1e-9 * sample.extent, "fatol": 1e-9, "maxiter": 200}
    center = scipy.optimize.minimize(
        misfit, start, method="Nelder-Mead", options=options
    ).x
    white = np.linalg.solve(factor(center), rows)
    normal = np.linalg.pinv(white.T @ white, rcond=1e-12, hermitian=True)
    return center, np.sqrt(np.diag(normal))


def project_covariance(
    covariance: Float[np.ndarray, "component component"], directions: Points
) -> Float[np.ndarray, "point point"]:
    """Covariance of each point's force along its own direction."""
    points = len(directions)
    blocks = covariance.reshape(points, 2, points, 2)
    return np.einsum("id,idje,je->ij", directions, blocks, directions)
