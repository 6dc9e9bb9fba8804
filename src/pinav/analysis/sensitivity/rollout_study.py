"""What becomes of a rollout when the swimmer, its environment or its start differ."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.analysis.sensitivity.sobol import Factor, SobolIndices, sobol_indices
from pinav.arguments import Scalar, State, Vector
from pinav.dynamics import FixedStep, Swimmer, with_dtype
from pinav.errors import InputError
from pinav.forces import AbstractForce, LinearDrag, MagneticPropulsion

OUTCOMES = ("final x", "final y", "displacement", "least distance", "arrival")
"""Names of what a study looks at, in the order of its columns."""


class RolloutStudy(eqx.Module):
    r"""One rollout of a planar swimmer, to be repeated with other parameters.

    Its outcomes are the final coordinates [L]; the displacement of the final position
    from the nominal one [L]; the least distance [L] on the way to a landmark; and
    arrival, 1 where the displacement is at most the tolerance, else 0. Its factors are
    relative for the environment's strength, the damping and the gain, where the swimmer
    has them, and shifts [L] for the start.

    Attributes:
        ts: times [T].
        landmark: such as the top of a barrier [L].
        tolerance: of arrival [L].
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
        return self._outcomes(np.asarray(paths), np.asarray(nominal)[0, -1])

    def _outcomes(
        self, paths: Float[np.ndarray, "sample time 2"], goal: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, "sample outcome"]:
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
            samples: a power of two.
            seed: of sequence and bootstrap.

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
