r"""Hills and wells of a rugged potential, proposed from the linearised data.

Where the evidence asks for kernels finer than those with which fits begin, the detail
of a force is often in a few places: obstacles, each of a height and a shape of its own,
and little between them. The summits of the potential of free kernels are where a
search begins. In the linearised data (`ForceResponse`) hills of Gaussian form are
fitted by least squares with a trust region, beside coarse free kernels of a fixed
prior, which carry what no hill has been found for and are projected out. Hills are
added where the kernels have to carry most, split and left out, as long as the evidence
(by Laplace's method) grows; the fit of the engine has the last word.

References:
    Golub and Pereyra, SIAM J. Numer. Anal. 10, 413 (1973), linear unknowns that are
    projected out; Branch, Coleman and Li, SIAM J. Sci. Comput. 21, 1 (1999), the
    trust region.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.fitting.environments.kernels import KernelGrid, surround_with_kernels
from pinav.fitting.evidence.evidence import Hyperparameters, root
from pinav.fitting.policy import POLICY
from pinav.fitting.rugged.summits import NUMBERS, Hills, doubtful, halves, summits
from pinav.fitting.structure.response import ForceResponse, columns
from pinav.forces import HillsTerm, KernelPotential, forces_at
from pinav.forces.terms import MIDDLE, WIDTHS
from pinav.threads import map_on_cores

MOST_HILLS = 24
"""Summits above which the field is rough everywhere."""

ROUGH, SHARES = 0.3, (0.1, 0.03, 0.01)
"""Deviation of the coarse kernels, relative to the height of a typical hill: the first
fit leaves them much to carry, the last ones little."""

FEW = 4
"""Hills that are judged at the end alone: their fit costs little, and before it coarse
kernels that need not be there count against them."""

LENGTH = 1.2
"""Length scale of the coarse kernels beside hills, in their widths."""

PLACE, HEIGHT, SIZE, SHEAR = 0.7, 2.0, 0.3, 0.7
"""Deviations of the priors of hills: of a place from where its fit begins, in sizes of
the hill; of the height, in typical heights; of the logarithm of the size from the
typical one; and of the shear."""

PEAKS, SPLITS = 3, 2
"""Places at which a hill is added, and longest hills that are split, in a round."""

TRIED, SETTLED = 12, 30
"""Evaluations of the residuals for a trial, and for a fit."""

ROUNDS = 8
"""Rounds of additions at most."""

SPURIOUS, LATENT = 0.02, 0.1
"""Height of a peak of the remainder that counts, relative to a typical hill; and what a
datum tells of forces as great as there are, in deviations of the noise, below which it
is left out."""


def propose_hills(
    response: ForceResponse,
    noise: float,
    potential: KernelPotential,
    chosen: Hyperparameters,
) -> HillsTerm | None:
    """Hills and wells that explain the data; None where kernels explain them better.

    They may be worse by what is clear: some of the first ones may be missing, and the
    data are linearised about free kernels, whose errors count against all others.
    """
    first = summits(potential, np.asarray(response.points).reshape(-1, 2))
    if not 0 < len(first) <= MOST_HILLS:
        return None
    landscape = _Landscape.of(response, noise, first)
    free = landscape.evidence_of(potential, chosen, response)
    best = landscape.with_share(ROUGH).fit(first, SETTLED)
    reached = best.log_evidence  # the first fit may not have come to its end
    for share in SHARES:
        landscape = landscape.with_share(share)
        best = landscape.fit(best.hills, SETTLED)
        reached = max(reached, best.log_evidence)
        if len(best.hills) > FEW and reached < free - POLICY.clear:
            return None
        best = landscape.without_needless(best)
        for _ in range(ROUNDS):
            tried = landscape.fit_each(list(landscape.longer(best)))
            better = max(tried, key=_log_evidence, default=best)
            if better.log_evidence <= best.log_evidence:
                break
            best = landscape.fit(better.hills, SETTLED)
            best = landscape.without_needless(best)
        if len(best.hills) > FEW and best.log_evidence < free:
            return None
    return None if best.log_evidence < free - POLICY.clear else _term(best.hills)


class _Fit(eqx.Module):
    hills: Hills
    log_evidence: float


def _log_evidence(fit: _Fit) -> float:
    return fit.log_evidence


class _Landscape(eqx.Module):
    """Least squares of hills in the linearised data, coarse kernels projected out."""

    points: Float[Array, "trajectory group 2"]
    noise: float
    rows: Float[np.ndarray, "trajectory datum force"]
    offset: Float[np.ndarray, " residual"]
    kernels: KernelPotential
    root: Float[np.ndarray, "kernel column"]
    columns: Float[np.ndarray, "residual column"]
    height: float
    price: float
    deviation: float
    basis: Float[np.ndarray, "row explained"]
    kernel_volume: float

    @classmethod
    def of(cls, response: ForceResponse, noise: float, hills: Hills) -> "_Landscape":
        positions = np.asarray(response.points).reshape(-1, 2)
        kernels = KernelPotential.with_zero_weights(
            *surround_with_kernels(positions, KernelGrid())
        )
        rows, count = np.asarray(response.rows), len(response.rows)
        # In each trajectory the data that say most come last.
        strength = np.sqrt(np.mean(rows**2, axis=(0, 2)) * rows.shape[2])
        is_told = strength * float(np.std(np.asarray(response.forces))) > LATENT * noise
        first = int(np.argmax(is_told)) if is_told.any() else 0
        prior = kernels.prior()
        shape = prior.start.copy()
        shape[:2] = np.log(LENGTH), prior.bounds[1, 1]
        free = root(prior.covariance(shape))

        kept = rows.shape[1] - first
        explained = columns(kernels, response) @ free
        return cls(
            points=response.points,
            noise=noise,
            rows=rows[:, first:] / noise,
            offset=_told(response.residuals_of_none, count, kept) / noise,
            kernels=kernels,
            root=free,
            columns=_told(explained, count, kept) / noise,
            height=float(np.median(np.abs(hills[:, 0]))),
            price=_log_places(positions, hills),
            deviation=0.0,
            basis=np.zeros((0, 0)),
            kernel_volume=0.0,
        )

    def evidence_of(
        self,
        potential: KernelPotential,
        chosen: Hyperparameters,
        response: ForceResponse,
    ) -> float:
        """Log evidence of a potential of kernels alone, of the same data."""
        free = chosen.amplitude * root(potential.prior().covariance(chosen.shape))
        explained = columns(potential, response) @ free
        told = _told(explained, *self.rows.shape[:2]) / self.noise
        others = dataclasses.replace(self, kernels=potential, root=free, columns=told)
        alone = others.with_deviation(1.0)
        left = alone._project(self.offset)
        return -0.5 * float(left @ left) - alone.kernel_volume

    def with_share(self, share: float) -> "_Landscape":
        return self.with_deviation(share * self.height)

    def with_deviation(self, deviation: float) -> "_Landscape":
        """The same for a deviation of the coarse kernels [L² T⁻²]."""
        basis, square = np.linalg.qr(self._equations(deviation))
        volume = float(np.log(np.abs(np.diagonal(square))).sum())
        return dataclasses.replace(
            self, deviation=deviation, basis=basis, kernel_volume=volume
        )

    def fit(self, hills: Hills, evaluations: int) -> _Fit:
        """Hills of least misfit, their priors about where they are.

        The evidence of hills whose forces are not finite is none.
        """
        from scipy.optimize import least_squares

        def at(numbers: Float[np.ndarray, " number"]) -> Float[np.ndarray, " row"]:
            now = numbers.reshape(-1, NUMBERS)
            return np.append(self._project(self._residuals(now)), _scores(now, hills))

        def slopes(numbers: Float[np.ndarray, " number"]) -> Float[np.ndarray, "r n"]:
            now = numbers.reshape(-1, NUMBERS)
            return np.vstack([self._project(self._jacobian(now)), held])

        held = np.diag(1 / _deviations(hills).ravel())
        try:
            search = least_squares(
                at,
                hills.ravel(),
                cast(Any, slopes),  # SciPy's types know of names alone
                x_scale="jac",
                max_nfev=evaluations,
                ftol=1e-5,
                xtol=1e-5,
            )
        except (ValueError, np.linalg.LinAlgError):  # forces that are not finite
            return _Fit(hills, -np.inf)
        scaled = search.jac * _deviations(hills).ravel()
        volume = float(np.linalg.slogdet(scaled.T @ scaled).logabsdet)
        price = len(hills) * self.price
        value = -float(search.cost) - 0.5 * volume - price - self.kernel_volume
        return _Fit(search.x.reshape(-1, NUMBERS), value)

    def fit_each(self, trials: Sequence[Hills]) -> list[_Fit]:
        return map_on_cores(lambda hills: self.fit(hills, TRIED), trials)

    def without_needless(self, fit: _Fit) -> _Fit:
        shorter = [np.delete(fit.hills, i, axis=0) for i in doubtful(fit.hills)]
        best = max(self.fit_each(shorter), key=_log_evidence, default=fit)
        if best.log_evidence <= fit.log_evidence:
            return fit
        return self.without_needless(best)

    def longer(self, fit: _Fit) -> Iterator[Hills]:
        """One hill more: at peaks of what the kernels carry, or two in place of one."""
        hills = fit.hills
        if len(hills) >= MOST_HILLS:
            return
        positions = np.asarray(self.points).reshape(-1, 2)
        peaks = summits(self._remainder(hills), positions, SPURIOUS * self.height)
        typical = float(np.median(hills[:, 3]))
        for peak in peaks[:PEAKS]:
            yield np.vstack([hills, [*peak[:3], typical, 0.0, 0.0]])
        lengths = hills[:, 3] + np.hypot(hills[:, 4], hills[:, 5])
        for index in np.argsort(-lengths)[:SPLITS]:
            yield np.vstack([np.delete(hills, index, axis=0), halves(hills[index])])

    def _residuals(self, hills: Hills) -> Float[np.ndarray, " residual"]:
        forces = sum(
            np.asarray(_hill_forces(on_device(one), self.points)) for one in hills
        )
        flat = np.reshape(forces, (len(self.rows), -1, 1))
        return (self.rows @ flat).ravel() + self.offset

    def _jacobian(self, hills: Hills) -> Float[np.ndarray, "residual number"]:
        slopes = [
            np.asarray(_hill_slopes(on_device(one), self.points)) for one in hills
        ]
        flat = np.concatenate(slopes, axis=-1).reshape(len(self.rows), -1, hills.size)
        return (self.rows @ flat).reshape(-1, hills.size)

    def _equations(self, deviation: float) -> Float[np.ndarray, "row column"]:
        count = self.columns.shape[1]
        return np.vstack([deviation * self.columns, np.eye(count)])

    def _project(
        self, values: Float[np.ndarray, "residual ..."]
    ) -> Float[np.ndarray, "row ..."]:
        """Residuals that the coarse kernels leave, and their cost."""
        count = len(values)
        explained = self.basis @ (self.basis[:count].T @ values)
        explained[:count] -= values
        return -explained

    def _remainder(self, hills: Hills) -> KernelPotential:
        """The coarse kernels, with what they have to carry beside hills."""
        residuals = self._residuals(hills)
        wanted = np.append(-residuals, np.zeros(self.columns.shape[1]))
        values = np.linalg.lstsq(self._equations(self.deviation), wanted, rcond=None)[0]
        weights = on_device(self.deviation * (self.root @ values))
        return eqx.tree_at(lambda one: one.weights, self.kernels, weights)


def _told(
    values: Float[np.ndarray, " datum *all"], trajectories: int, kept: int
) -> Float[np.ndarray, " residual *all"]:
    """The last data of each trajectory, which say most."""
    split = values.reshape(trajectories, -1, *values.shape[1:])
    return split[:, -kept:].reshape(-1, *values.shape[1:])


def _log_places(positions: Float[np.ndarray, "point 2"], hills: Hills) -> float:
    size = np.exp(np.median(hills[:, 3]))
    ground = float(np.prod(np.ptp(positions, axis=0)))
    return float(np.log1p(ground / (2 * np.pi * (PLACE * size) ** 2)))


def _deviations(hills: Hills) -> Hills:
    """Prior deviations of the numbers of hills; see `PLACE`."""
    sizes, height = np.exp(hills[:, 3]), np.median(np.abs(hills[:, 0]))
    each = np.array([HEIGHT * height, 0.0, 0.0, SIZE, SHEAR, SHEAR])
    deviations = np.tile(each, (len(hills), 1))
    deviations[:, 1:3] = PLACE * sizes[:, None]
    return deviations


def _scores(hills: Hills, first: Hills) -> Float[np.ndarray, " number"]:
    """Numbers of hills in deviations of their priors, from their means."""
    means = np.zeros_like(first)
    means[:, 1:3], means[:, 3] = first[:, 1:3], np.median(first[:, 3])
    return ((hills - means) / _deviations(first)).ravel()


@eqx.filter_jit
def _hill_forces(
    hill: Float[Array, "6"], points: Float[Array, "trajectory group 2"]
) -> Float[Array, "trajectory group 2"]:
    """Forces of one hill, so that any number of them shares a compilation."""
    weights = jnp.zeros(len(WIDTHS)).at[MIDDLE].set(hill[0])
    term = HillsTerm(weights=weights, centers=hill[None, 1:3], shapes=hill[None, 3:])
    return forces_at(term, jnp.zeros(points.shape[:-1]), points)


_hill_slopes = eqx.filter_jit(jax.jacfwd(_hill_forces))


def _term(hills: Hills) -> HillsTerm:
    weights = np.zeros((len(hills), len(WIDTHS)))
    weights[:, MIDDLE] = hills[:, 0]
    return HillsTerm(
        weights=on_device(weights.ravel()),
        centers=on_device(hills[:, 1:3]),
        shapes=on_device(hills[:, 3:]),
    )
