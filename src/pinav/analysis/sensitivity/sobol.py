r"""Global sensitivity: which parameter decides the outcome, over its whole range.

With independent parameters $p_i$ and an outcome $Y$, the first-order index
$S_i = \mathrm{Var}[E(Y|p_i)]/\mathrm{Var}\,Y$ is the share of the variance that $p_i$
alone explains, the total index $T_i = E[\mathrm{Var}(Y|p_{\sim i})]/\mathrm{Var}\,Y$
that in which it takes part. SciPy estimates both from Sobol' sequences; intervals
are those of a bootstrap over the samples.

References:
    Sobol', Math. Comput. Simul. 55, 271 (2001); Saltelli et al., Comput. Phys. Commun.
    181, 259 (2010), whose estimators these are.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, State, Vector
from pinav.dynamics import FixedStep, Swimmer, with_dtype
from pinav.errors import InputError
from pinav.evaluation.coverage import NOMINAL
from pinav.forces import AbstractForce, LinearDrag, MagneticPropulsion

Samples = Float[np.ndarray, "sample factor"]
"""Values of the factors, one row a sample."""

Model = Callable[[Samples], Float[np.ndarray, "sample outcome"]]
"""Outcomes, one column each, of parameters, one row a sample."""

Indices = Float[np.ndarray, "outcome factor"]
"""An index for each outcome and factor."""

RESAMPLES = 200
"""Samples of the bootstrap."""


class Factor(eqx.Module):
    """A parameter that varies uniformly and independently of the others.

    Raises:
        InputError: the range is empty or not finite.
    """

    name: str = eqx.field(static=True)
    low: float
    high: float

    def __check_init__(self) -> None:
        if not -np.inf < self.low < self.high < np.inf:
            raise InputError(
                f"Factor {self.name}: expected a finite range with low < high, got "
                f"{self.low} to {self.high}"
            )


class SobolIndices(eqx.Module):
    """Sobol' indices of several outcomes, with confidence intervals.

    An outcome that does not vary has no indices: they are NaN.
    """

    factors: tuple[str, ...] = eqx.field(static=True)
    outcomes: tuple[str, ...] = eqx.field(static=True)
    first: Indices
    first_interval: Float[np.ndarray, "outcome factor 2"]
    total: Indices
    total_interval: Float[np.ndarray, "outcome factor 2"]
    confidence: float
    variance: Float[np.ndarray, " outcome"]


def sobol_indices(
    function: Model,
    factors: Sequence[Factor],
    outcomes: Sequence[str],
    *,
    samples: int = 256,
    seed: int = 0,
) -> SobolIndices:
    """Sobol' indices of every outcome with respect to every factor.

    Args:
        function: outcomes, one column each, of parameters, one row a sample; called
            with samples x (factors + 2) rows in all.
        samples: a power of two.

    Raises:
        InputError: there is no factor, `samples` is no power of two, or an outcome is
            not finite.
    """
    if not factors:
        raise InputError("sobol_indices factors: expected one or more, got none")
    if samples < 2 or samples & (samples - 1):
        raise InputError(
            "sobol_indices samples: expected a power of two, such as 256, got "
            f"{samples}"
        )
    generator = np.random.default_rng(seed)
    from scipy.stats import qmc  # seconds of imports that few commands need

    points = qmc.Sobol(2 * len(factors), rng=generator).random(samples)
    low = np.array([factor.low for factor in factors])
    high = np.array([factor.high for factor in factors])
    halves = np.split(points, 2, axis=1)
    first, second = (low[None] + half * (high - low)[None] for half in halves)
    mixed = np.repeat(first[None], len(factors), axis=0)
    for index in range(len(factors)):
        mixed[index, :, index] = second[:, index]
    values = _evaluate(function, np.concatenate([first, second, *mixed]), outcomes)
    varies = values.std(axis=0) > 1e-12 * np.abs(values).max(axis=0)
    stacked = values.reshape(-1, samples, len(outcomes))
    blank = np.where(varies, 0.0, np.nan)[:, None]
    draws = [
        _indices(stacked[:, generator.integers(0, samples, samples)])
        for _ in range(RESAMPLES)
    ]
    ends = [0.5 - NOMINAL / 2, 0.5 + NOMINAL / 2]
    intervals = np.quantile(np.array(draws), ends, axis=0)
    first_order, total = (blank + index for index in _indices(stacked))
    return SobolIndices(
        factors=tuple(factor.name for factor in factors),
        outcomes=tuple(outcomes),
        first=first_order,
        first_interval=blank[..., None] + np.moveaxis(intervals[:, 0], 0, -1),
        total=total,
        total_interval=blank[..., None] + np.moveaxis(intervals[:, 1], 0, -1),
        confidence=NOMINAL,
        variance=values[: 2 * samples].var(axis=0),
    )


def _evaluate(
    function: Model, parameters: Samples, outcomes: Sequence[str]
) -> Float[np.ndarray, "sample outcome"]:
    values = np.asarray(function(parameters), float)
    if values.shape != (len(parameters), len(outcomes)):
        raise InputError(
            f"sobol_indices function: expected an array of shape "
            f"{(len(parameters), len(outcomes))}, a row per sample and a column per "
            f"outcome, got {values.shape}"
        )
    if not np.isfinite(values).all():
        raise InputError(
            "sobol_indices function: an outcome is not finite somewhere in the ranges "
            "of the factors; make them narrower"
        )
    return values


def _indices(
    stacked: Float[np.ndarray, "matrix sample outcome"],
) -> tuple[Indices, Indices]:
    """Indices from the outcomes of both matrices and of the mixed ones."""
    from scipy.stats import sobol_indices as saltelli

    samples = stacked.shape[1]
    first, second, *mixed = np.moveaxis(stacked, 2, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        indices = saltelli(
            func={"f_A": first, "f_B": second, "f_AB": np.stack(mixed)}, n=samples
        )
    shape = first.shape[0], len(mixed)  # SciPy drops the axis of a single outcome
    return indices.first_order.reshape(shape), indices.total_order.reshape(shape)


OUTCOMES = ("final x", "final y", "displacement", "least distance", "arrival")
"""Names of what a study looks at, in the order of its columns."""


class RolloutStudy(eqx.Module):
    """One rollout of a planar swimmer, to be repeated with other parameters.

    Its outcomes are the final coordinates [L]; the displacement of the final position
    from the nominal one [L]; the least distance [L] on the way to a landmark; and
    arrival, 1 where the displacement is at most the tolerance, else 0. Its factors are
    relative for the environment's strength, the damping and the gain, where the swimmer
    has them, and shifts [L] for the start.

    Attributes:
        landmark: such as the top of a barrier [L].
    """

    swimmer: Swimmer
    start: Float[np.ndarray, " state"]
    ts: Float[np.ndarray, " time"]
    landmark: Float[np.ndarray, "2"]
    tolerance: float

    def factors(self, *, relative: float, shift: float) -> tuple[Factor, ...]:
        """Uniform ranges about the nominal values.

        Args:
            relative: half range of a strength, relative to its value.
            shift: half range of each coordinate of the start [L].

        Raises:
            InputError: `relative` or `shift` is not positive.
        """
        names = ["environment"]
        names += ["damping"] if isinstance(self.swimmer.drag, LinearDrag) else []
        names += (
            ["gain"] if isinstance(self.swimmer.propulsion, MagneticPropulsion) else []
        )
        strengths = [Factor(name, 1.0 - relative, 1.0 + relative) for name in names]
        shifts = [Factor(f"start {axis}", -shift, shift) for axis in "xy"]
        return (*strengths, *shifts)

    def outcomes(
        self,
        factors: tuple[Factor, ...],
        parameters: Float[np.ndarray, "sample factor"],
    ) -> Float[np.ndarray, "sample outcome"]:
        """Outcomes of rollouts with these values of the factors."""
        names = tuple(factor.name for factor in factors)
        with jax.enable_x64(new_val=True):
            swimmer = with_dtype(self.swimmer, jnp.float64)
            start, ts = jnp.asarray(self.start), jnp.asarray(self.ts)
            nominal = _paths(swimmer, start, ts, (), jnp.zeros((1, 0)))
            paths = _paths(swimmer, start, ts, names, jnp.asarray(parameters))
        goal, paths = np.asarray(nominal)[0, -1], np.asarray(paths)
        final = paths[:, -1]
        displacement = np.linalg.norm(final - goal, axis=1)
        distances = np.linalg.norm(paths - self.landmark, axis=2)
        arrival = (displacement <= self.tolerance).astype(float)
        rest = (displacement, distances.min(axis=1), arrival)
        return np.column_stack([final, *rest])

    def indices(
        self, factors: tuple[Factor, ...], *, samples: int = 256, seed: int = 0
    ) -> SobolIndices:
        """Sobol' indices of all outcomes.

        Args:
            factors: some of those of `factors`, with any ranges.

        Raises:
            InputError: a factor is not one of this study, or an outcome is not finite.
        """
        known = {f.name for f in self.factors(relative=0.1, shift=1.0)}
        for factor in factors:
            if factor.name not in known:
                raise InputError(
                    f"RolloutStudy factors: {factor.name!r} is unknown; choose from "
                    f"{', '.join(sorted(known))}"
                )
        return sobol_indices(
            lambda parameters: self.outcomes(factors, parameters),
            factors,
            OUTCOMES,
            samples=samples,
            seed=seed,
        )


@eqx.filter_jit
def _paths(
    swimmer: Swimmer,
    start: State,
    ts: Float[Array, " time"],
    names: tuple[str, ...],
    parameters: Float[Array, "sample factor"],
) -> Float[Array, "sample time 2"]:
    def one(values: Float[Array, " factor"]) -> Float[Array, "time 2"]:
        chosen = dict(zip(names, values, strict=True))
        varied = swimmer
        for name, pick in _STRENGTHS.items():
            if name in chosen:
                factor = chosen[name]
                varied = eqx.tree_at(pick, varied, factor, is_leaf=lambda x: x is None)
        shifts = [chosen.get(f"start {axis}", jnp.zeros(())) for axis in "xy"]
        y0 = start.at[:2].add(jnp.stack(shifts))
        return FixedStep().solve(varied, y0, ts)[0][:, :2]

    forces = swimmer.propulsion, swimmer.drag, swimmer.environment
    swimmer = Swimmer(*map(_ScaledForce, forces))
    return jax.lax.map(one, parameters, batch_size=256)


_STRENGTHS = {
    "environment": lambda swimmer: swimmer.environment.factor,
    "damping": lambda swimmer: swimmer.drag.factor,
    "gain": lambda swimmer: swimmer.propulsion.factor,
}


class _ScaledForce(AbstractForce):
    """A force times a factor: thrust by its gain, linear drag by its damping."""

    force: AbstractForce
    factor: Float[Array, ""] | float | None = None

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        value = self.force(t, x, v)
        return value if self.factor is None else self.factor * value
