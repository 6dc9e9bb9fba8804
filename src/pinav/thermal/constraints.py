"""Objectives and constraints of a protocol: differentiable functions of a run."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.thermal.design_variables import Run
from pinav.thermal.dose import value_exceeded_by
from pinav.thermal.exposure_limits import HfLimit
from pinav.thermal.quantities import Field, Number
from pinav.thermal.solve import Solution

LEAST_DOSE = 1e-9
"""Added [min] to a dose before its logarithm is taken."""


class RunResult(eqx.Module):
    """A run and its temperatures and doses.

    Attributes:
        run: tissue and field.
        solution: temperature and dose.
    """

    run: Run
    solution: Solution

    def volumes(self, fraction: Field) -> Field:
        """Volume [m³] of a tissue in each cell."""
        return fraction * self.run.model.grid.volumes


Quantity = Callable[[RunResult], Field]


class LogD90(eqx.Module):
    """Logarithm of the CEM43 [min] that 90 % of a target exceed.

    Attributes:
        target: volume fraction of the target in each cell.
    """

    target: Field

    def __call__(self, result: RunResult) -> Float[Array, ""]:
        """Its value for a run."""
        dose = result.solution.final.dose
        d90 = value_exceeded_by(dose, result.volumes(self.target), 0.9)
        # Doses span decades; without the offset a cold start would have no gradient.
        return jnp.log(d90 + LEAST_DOSE)


class AbstractConstraint(eqx.Module):
    """A quantity that may not exceed a bound.

    Attributes:
        name: what the result calls it.
        bound: upper bound.
        unit: of quantity and bound.
    """

    name: eqx.AbstractVar[str]
    bound: eqx.AbstractVar[Number]
    unit: eqx.AbstractVar[str]

    @abc.abstractmethod
    def quantity(self, result: RunResult) -> Field:
        """What is bounded; several numbers are all bounded."""

    def excess(self, result: RunResult) -> Field:
        """By how much it exceeds, such that a change of one matters."""
        return self.quantity(result) - self.bound


class MaxTemperature(AbstractConstraint):
    """No cell is hotter than a bound, at the end of any step.

    Each step counts for itself. Where a field is lowered, the hottest moment of its
    interval is the first, at which the amplitude does not act yet; the slope of a
    maximum over the interval would not tell what the amplitude does later.

    Attributes:
        bound: highest temperature [°C].
        name: what the result calls it.
        unit: of the bound.
    """

    bound: Number
    name: str = eqx.field(static=True, default="maximum temperature")
    unit: str = eqx.field(static=True, default="°C")

    def quantity(self, result: RunResult) -> Field:
        return result.solution.hottest


class HealthyDose(AbstractConstraint):
    """No cell of healthy tissue gets more dose than a bound.

    Attributes:
        bound: largest dose [CEM43 min], positive.
        fraction: volume fraction of the healthy tissue; cells below one half do
            not count.
        name: what the result calls it.
        unit: of the bound.
    """

    bound: Number
    fraction: Field
    name: str = eqx.field(static=True, default="healthy tissue dose")
    unit: str = eqx.field(static=True, default="min")

    def quantity(self, result: RunResult) -> Field:
        dose = jnp.where(self.fraction > 0.5, result.solution.final.dose, 0.0)
        return jnp.max(dose)

    def excess(self, result: RunResult) -> Field:
        # a dose spans many decades; its logarithm is nearly linear in the temperature
        return jnp.log((self.quantity(result) + LEAST_DOSE) / self.bound)


class AtMost(AbstractConstraint):
    """Any quantity of a run.

    Attributes:
        name: what the result calls it.
        function: the quantity.
        bound: upper bound.
        unit: of both.
        scale: change that matters, positive.
    """

    name: str = eqx.field(static=True)
    function: Quantity
    bound: Number
    unit: str = eqx.field(static=True)
    scale: Number = 1.0

    def quantity(self, result: RunResult) -> Field:
        return self.function(result)

    def excess(self, result: RunResult) -> Field:
        return (self.quantity(result) - self.bound) / self.scale


class Exposure(eqx.Module):
    """What a limit of the field bounds.

    Attributes:
        limit: of the field.
    """

    limit: HfLimit

    def __call__(self, result: RunResult) -> Field:
        """Its value for a run."""
        return self.limit.exposure(result.run.protocol)


def limit_constraint(limit: HfLimit) -> AtMost:
    """The constraint that the field keeps a limit; a change of the bound matters."""
    return AtMost(
        name=limit.name,
        function=Exposure(limit),
        bound=limit.product,
        unit="A/(m s)",
        scale=limit.product,
    )
