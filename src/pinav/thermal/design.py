r"""Design variables, objectives and constraints of a protocol, as functions of a run.

A design variable is a few numbers between 0 and 1 that change a run; an objective or a
constrained quantity is a differentiable function of the run and its solution.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.dose import value_exceeded_by
from pinav.thermal.protocols import HfLimit, Piecewise
from pinav.thermal.quantities import Field, Number
from pinav.thermal.solve import Solution
from pinav.thermal.sources import ParticleSource, PowerSource

LEAST_DOSE = 1e-9
"""Added [min] to a dose before its logarithm is taken."""

LEAST_POWER = 1e-12
"""Share of the largest power that is left of a field that is off."""

RANGE = 14.0
"""Range of the logarithms of the weights of a placement: a factor of a million."""


class Run(eqx.Module):
    """What is run: tissue with its particles, and the field over time."""

    model: Bioheat
    protocol: Piecewise


Numbers = Float[Array, " number"]
"""Design variables, between 0 and 1."""

Quantity = Callable[[Run, Solution], Field]
"""A differentiable function of a run; several numbers are all bounded."""


class DesignVariable(eqx.Module):
    """Numbers between 0 and 1 that change a run.

    Attributes:
        start: where an optimisation begins.
        apply: gives the run with these numbers.
    """

    start: Float[np.ndarray, " number"]
    apply: Callable[[Numbers, Run], Run]


class Constraint(eqx.Module):
    """A quantity that may not exceed a bound.

    Attributes:
        scale: change that matters, positive.
        is_dose: the logarithm counts: a dose spans many decades, and its logarithm is
            nearly linear in the temperature.
    """

    name: str = eqx.field(static=True)
    quantity: Quantity
    bound: Number
    unit: str = eqx.field(static=True)
    scale: Number = 1.0
    is_dose: bool = eqx.field(static=True, default=False)

    def excess(self, value: Field) -> Field:
        """Amount by which a value exceeds, such that a change of one matters."""
        if self.is_dose:
            return jnp.log((value + LEAST_DOSE) / self.bound)
        return (value - self.bound) / self.scale


def log_d90(target: Field) -> Quantity:
    """Logarithm of the CEM43 [min] that 90 % of a target exceed.

    Args:
        target: volume fraction of the target in each cell.
    """
    return eqx.Partial(_log_d90, target)  # compiled once for all targets of a shape


def _log_d90(target: Field, run: Run, solution: Solution) -> Field:
    volumes = target * run.model.grid.volumes
    d90 = value_exceeded_by(solution.final.dose, volumes, 0.9)
    # Doses span decades; without the offset a cold start would have no gradient.
    return jnp.log(d90 + LEAST_DOSE)


def max_temperature(bound: Number) -> Constraint:
    """No cell is hotter than a bound [°C], at the end of any step.

    Each step counts for itself. Where a field is lowered, the hottest moment of its
    interval is the first, at which the amplitude does not act yet; the slope of a
    maximum over the interval would not tell what the amplitude does later.
    """
    return Constraint(
        "maximum temperature", lambda _, solution: solution.hottest, bound, "°C"
    )


def healthy_dose(
    bound: Number, fraction: Field, name: str = "healthy tissue dose"
) -> Constraint:
    """No cell of healthy tissue gets more dose than a bound.

    Args:
        bound: largest dose [CEM43 min], positive.
        fraction: volume fraction of the healthy tissue; cells below one half do not
            count.
        name: name in the result.
    """

    def dose(_: Run, solution: Solution) -> Field:
        return jnp.max(jnp.where(fraction > 0.5, solution.final.dose, 0.0))

    return Constraint(name, dose, bound, "min", is_dose=True)


def limit_constraint(limit: HfLimit) -> Constraint:
    """The constraint that the field keeps a limit; a change of the bound matters."""
    return Constraint(
        limit.name,
        lambda run, _: limit.exposure(run.protocol),
        limit.product,
        "A/(m s)",
        scale=limit.product,
    )


def free_amplitudes(
    largest: Number, count: int, first: Number = 0.5, before: int = 0
) -> DesignVariable:
    r"""A constant amplitude in each interval, $H_j = \sqrt{x_j}\,H_{max}$.

    Power goes with $x$, and temperature nearly so: few steps of quadratic programming.

    Args:
        largest: $H_{max}$ [A m⁻¹], positive.
        first: $H_j/H_{max}$ to start from, the same in all.
        before: number of intervals at the begin that keep their amplitudes.

    Raises:
        InputError: a number is out of range.
    """
    if not largest > 0 or count < 1 or not 0 <= first <= 1:
        raise InputError(
            "free_amplitudes: expected a largest amplitude > 0 A/m, an interval and a "
            f"start within 0 and 1, got {largest}, {count} and {first}"
        )

    def apply(numbers: Numbers, run: Run) -> Run:
        # a millionth of the largest where it is off: power has a slope there
        values = largest * jnp.sqrt(LEAST_POWER + (1 - LEAST_POWER) * numbers)
        return _with_field(run, lambda kept: jnp.concatenate([kept[:before], values]))

    return DesignVariable(np.full(count, float(first) ** 2), apply)


def free_scale(largest: Number, first: Number = 0.5) -> DesignVariable:
    """One factor of all amplitudes, the pattern kept: for bursts and ramps."""

    def apply(numbers: Numbers, run: Run) -> Run:
        return _with_field(run, lambda kept: kept * (largest * numbers[0]))

    return DesignVariable(np.array([float(first)]), apply)


def _with_field(run: Run, change: Callable[[Array], Array]) -> Run:
    return eqx.tree_at(
        lambda r: (r.protocol.starts, r.protocol.ends), run, replace_fn=change
    )


def free_placement(patterns: Float[Array, "number ..."]) -> DesignVariable:
    r"""Where the particles or the power of the first source go, their total kept.

    The field is $\sum_k s_k(x)\,b_k$ of given patterns of one total, with weights $s$
    that are positive and add up to one.

    Args:
        patterns: $b_k$, one for each row [kg m⁻³ or W m⁻³].
    """

    def apply(numbers: Numbers, run: Run) -> Run:
        # a softmax keeps the total and cannot become negative, without a constraint
        fractions = jax.nn.softmax(RANGE * (numbers - 0.5))
        field = jnp.tensordot(fractions, patterns, axes=1)
        first = run.model.sources[0]
        if isinstance(first, ParticleSource):
            moved = ParticleSource(field, first.heating, first.scale)
        elif isinstance(first, PowerSource):
            moved = PowerSource(field, first.reference, first.scale)
        else:
            raise InputError(
                "free_placement: expected particles or a power density as the first "
                f"source, got {type(first).__name__}"
            )
        return eqx.tree_at(lambda r: r.model.sources[0], run, moved)

    return DesignVariable(np.full(patterns.shape[0], 0.5), apply)


def shells(
    model: Bioheat, radius: Number, count: int, total: Number
) -> Float[Array, "number ..."]:
    """Patterns in shells of equal thickness up to a radius [m].

    Each has the same total, in kilograms of particles, or watts.
    """
    edges = np.linspace(0.0, radius, count + 1)
    balls = [model.grid.ball(float(r)) for r in edges[1:]]
    shells = jnp.diff(jnp.stack([jnp.zeros_like(balls[0]), *balls]), axis=0)
    volumes = model.grid.volumes
    return jax.vmap(lambda shell: shell * (total / jnp.sum(shell * volumes)))(shells)
