"""Laws fitted to a sampled force, weighted by the covariance of its errors."""

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, ArrayLike, Float

from pinav.analysis.discovery.force_sample import ForceSample
from pinav.analysis.discovery.laws import AbstractLaw, LawForce, Role, SumLaw

STARTS = 3
"""Best starts from which a fit is run to its end."""

Bounds = tuple[Float[np.ndarray, " constant"], Float[np.ndarray, " constant"]]
"""Least and greatest value of each constant."""


class FieldFit(eqx.Module):
    """A law fitted to a sampled force.

    Attributes:
        law: the formula.
        constants: its best constants.
        squares: sum of squared, independent residuals of unit variance.
        bic: the squares, plus log of the effective sample size for each constant.
    """

    law: AbstractLaw = eqx.field(static=True)
    constants: Float[np.ndarray, " constant"]
    squares: float
    bic: float


def fit_law(
    law: AbstractLaw,
    sample: ForceSample,
    starts: Float[np.ndarray, "start constant"] | None = None,
) -> FieldFit:
    """Weighted nonlinear least squares from the best of several starts.

    Args:
        law: the formula.
        sample: the force, with the covariance of its errors.
        starts: constants to start from, whatever their amplitudes; those that the
            force itself suggests unless given.
    """
    if starts is None:
        starts = np.array(law.shapes(sample.landscape), float)
    with jax.enable_x64(new_val=True):
        problem = _Regression(law, sample.positions, sample.force, sample.whitener)
        low, high = _bounds(law, sample)
        scaled = [problem.with_best_amplitudes(np.clip(s, low, high)) for s in starts]
        scaled = [np.clip(start, low, high) for start in scaled]
        costs = [float(np.sum(problem.residuals(start) ** 2)) for start in scaled]
        fits = [problem.fit(scaled[i], (low, high)) for i in np.argsort(costs)[:STARTS]]
    best = min(fits, key=lambda fit: fit.cost)
    squares = 2 * float(best.cost)
    penalty = len(law.constants) * np.log(max(sample.num_effective, np.e))
    return FieldFit(law, best.x, squares, squares + float(penalty))


def fit_sum(first: FieldFit, term: AbstractLaw, sample: ForceSample) -> FieldFit:
    """A fitted law plus a term, which starts from the force that the law leaves."""
    rest = sample.less(law_force(first.law, first.constants, sample.positions))
    second = fit_law(term, rest)
    start = np.concatenate([first.constants, second.constants])
    return fit_law(first.law + term, sample, start[None])


def law_force(
    law: AbstractLaw,
    constants: Float[np.ndarray, " constant"],
    positions: Float[np.ndarray, "point dim"],
) -> Float[np.ndarray, "point dim"]:
    """The force of a law at points [L T⁻²]."""
    with jax.enable_x64(new_val=True):
        values = _force(law, jnp.asarray(constants), jnp.asarray(positions))
        return np.asarray(values)


@eqx.filter_jit
def _force(
    law: AbstractLaw,
    constants: Float[Array, " constant"],
    positions: Float[Array, "point dim"],
) -> Float[Array, "point dim"]:
    force = LawForce(law, constants)
    return jax.vmap(lambda x: force(0.0, x, jnp.zeros_like(x)))(positions)


@eqx.filter_jit
def _force_and_slopes(
    law: AbstractLaw,
    constants: Float[ArrayLike, " constant"],
    positions: Float[ArrayLike, "point dim"],
) -> tuple[Float[Array, "point dim"], Float[Array, "point dim constant"]]:
    """One program for both: compiling a second one takes longer than all its calls."""

    def force(constants: Float[Array, " constant"]) -> tuple[Array, Array]:
        values = _force(law, constants, jnp.asarray(positions))
        return values, values

    slopes, values = jax.jacfwd(force, has_aux=True)(jnp.asarray(constants))
    return values, slopes


class _Regression(eqx.Module):
    """Residuals of a law, as a function of its constants."""

    law: AbstractLaw = eqx.field(static=True)
    positions: Float[np.ndarray, "point dim"]
    force: Float[np.ndarray, "point dim"]
    whitener: Float[np.ndarray, "component component"]

    def residuals(
        self, constants: Float[np.ndarray, " constant"]
    ) -> Float[np.ndarray, " component"]:
        values, _ = self._evaluate(constants)
        return self.whitener @ (values - self.force).reshape(-1)

    def jacobian(
        self, constants: Float[np.ndarray, " constant"]
    ) -> Float[np.ndarray, "component constant"]:
        _, slopes = self._evaluate(constants)
        return self.whitener @ slopes.reshape(-1, len(constants))

    def _evaluate(
        self, constants: Float[np.ndarray, " constant"]
    ) -> tuple[Float[np.ndarray, "point dim"], Float[np.ndarray, "point dim constant"]]:
        """Force and slopes; of a sum term by term, whose programs are there already."""
        law, parts = self.law, [(self.law, constants)]
        if isinstance(law, SumLaw):
            parts = [(one, np.asarray(c)) for one, c in law.split(tuple(constants))]
        both = [_force_and_slopes(*part, self.positions) for part in parts]
        values = sum(np.asarray(force) for force, _ in both)
        slopes = [np.asarray(slope) for _, slope in both]
        return np.asarray(values), np.concatenate(slopes, axis=-1)

    def with_best_amplitudes(
        self, constants: Float[np.ndarray, " constant"]
    ) -> Float[np.ndarray, " constant"]:
        """The constants with the amplitudes, which are linear, at their best."""
        chosen = self.law.indices(Role.AMPLITUDE)
        values = np.array(constants, float)
        values[chosen] = 0.0
        rest = self.residuals(values)
        columns = self.jacobian(values)[:, chosen]
        values[chosen] = np.linalg.lstsq(columns, -rest, rcond=1e-10)[0]
        return values

    def fit(
        self, start: Float[np.ndarray, " constant"], bounds: Bounds
    ) -> scipy.optimize.OptimizeResult:
        return scipy.optimize.least_squares(
            self.residuals,
            start,
            cast(Any, self.jacobian),
            bounds=bounds,
            x_scale="jac",
            max_nfev=200,
        )


def _bounds(law: AbstractLaw, sample: ForceSample) -> Bounds:
    """Between which each constant is sought: wide, but finite numbers throughout."""
    low, high = sample.positions.min(axis=0), sample.positions.max(axis=0)
    reach, middle = 5 * sample.extent, (low + high) / 2
    corner = float(np.abs(middle).max())
    limits = []
    for constant in law.constants:
        if constant.role is Role.SCALE:
            unit = sample.extent if constant.unit == "L" else 1.0
            limits.append((5e-3 * unit, 50 * unit))
        elif constant.role is Role.POSITION:
            limits.append((-corner - reach, corner + reach))
        else:
            limits.append((-np.inf, np.inf))
    low, high = np.array(limits).T
    return low, high
