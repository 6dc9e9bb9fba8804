"""Numbers that a system leaves to be learned, and what is known of them before."""

import abc
import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from pinav.arguments import STEPS, Scalar, check_positive
from pinav.errors import InputError


class AbstractNumberPrior(eqx.Module):
    """Probability density of a number before the data are seen."""

    @property
    @abc.abstractmethod
    def log_height(self) -> float:
        """Logarithm of the density where the standardised value is zero."""

    @abc.abstractmethod
    def standard_score(self, value: Scalar) -> Float[Array, ""]:
        r"""$z$ with a density proportional to $\exp(-z^2/2)$."""


class Flat(AbstractNumberPrior):
    """No preference for any value."""

    @property
    def log_height(self) -> float:
        return 0.0

    def standard_score(self, value: Scalar) -> Float[Array, ""]:
        return jnp.zeros_like(jnp.asarray(value, float))


class Normal(AbstractNumberPrior):
    r"""Normal distribution, $\exp(-(x - \mu)^2 / 2 \sigma^2)$.

    Raises:
        InputError: `deviation` is a number <= 0.
    """

    mean: Scalar
    deviation: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "deviation")

    @property
    def log_height(self) -> float:
        return -math.log(self.deviation * math.sqrt(2 * math.pi))

    def standard_score(self, value: Scalar) -> Float[Array, ""]:
        return (jnp.asarray(value) - self.mean) / self.deviation


class LogNormal(AbstractNumberPrior):
    r"""Log-normal distribution of a positive number.

    Attributes:
        median: median of the number; positive.
        deviation: standard deviation of $\log x$, positive; 0.1 is about 10 %.

    Raises:
        InputError: `median` or `deviation` is a number <= 0.
    """

    median: Scalar
    deviation: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "median", "deviation")

    @property
    def log_height(self) -> float:
        return -math.log(self.median * self.deviation * math.sqrt(2 * math.pi))

    def standard_score(self, value: Scalar) -> Float[Array, ""]:
        # the density of log x: its mode is the median, however wide it is
        return jnp.log(jnp.asarray(value) / self.median) / self.deviation


class FreeNumber(eqx.Module):
    """A number of a swimmer that is learned with the unknown environment.

    Attributes:
        path: place in the swimmer, such as `drag.damping`, or
            `known_force.terms[0].excess_density` in the first of several forces.
    """

    path: str = eqx.field(static=True)
    prior: AbstractNumberPrior = Flat()

    def pick(self, swimmer: PyTree) -> PyTree:
        """The number, or the numbers of a vector or tensor, of a swimmer.

        Raises:
            InputError: the swimmer has nothing there.
        """
        part = swimmer
        try:
            for place, name in STEPS.findall(self.path):
                part = getattr(part, name) if name else part[int(place)]
        except (AttributeError, IndexError, TypeError) as error:
            raise InputError(
                f"learn: {self.path!r} is not in the swimmer: {error}"
            ) from error
        return part
