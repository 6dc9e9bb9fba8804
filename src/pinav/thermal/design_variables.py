r"""What a protocol optimisation may change; each a few numbers between 0 and 1."""

import abc
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.protocols import Piecewise
from pinav.thermal.quantities import Number
from pinav.thermal.sources import ParticleSource, PowerSource


class Run(eqx.Module):
    """What is run: tissue with its particles, and the field over time.

    Attributes:
        model: the tissue.
        protocol: the field.
    """

    model: Bioheat
    protocol: Piecewise


class AbstractDesignVariable(eqx.Module):
    """Numbers between 0 and 1 that change a run."""

    @property
    @abc.abstractmethod
    def start(self) -> Float[np.ndarray, " number"]:
        """Where an optimisation begins."""

    @abc.abstractmethod
    def apply(self, numbers: Float[Array, " number"], run: Run) -> Run:
        """The run with these numbers."""


LEAST_POWER = 1e-12
"""Share of the largest power that is left of a field that is off."""


class FreeAmplitudes(AbstractDesignVariable):
    r"""A constant amplitude in each interval, $H_j = \sqrt{x_j}\,H_{max}$.

    Power goes with $x$, and temperature nearly so: few steps of quadratic programming.

    Attributes:
        largest: $H_{max}$ [A m⁻¹], positive.
        count: number of intervals.
        first: $H_j/H_{max}$ to start from, the same in all.
        before: intervals at the begin that keep their amplitudes.

    Raises:
        InputError: a number is out of range.
    """

    largest: Number
    count: int = eqx.field(static=True)
    first: Number = 0.5
    before: int = eqx.field(static=True, default=0)

    def __check_init__(self) -> None:
        if not self.largest > 0 or self.count < 1 or not 0 <= self.first <= 1:
            raise InputError(
                "FreeAmplitudes: expected a largest amplitude > 0 A/m, an interval and "
                f"a start within 0 and 1, got {self.largest}, {self.count} and "
                f"{self.first}"
            )

    @property
    def start(self) -> Float[np.ndarray, " number"]:
        return np.full(self.count, float(self.first) ** 2)

    def apply(self, numbers: Float[Array, " number"], run: Run) -> Run:
        # a millionth of the largest where it is off: power has a slope there
        root = jnp.sqrt(LEAST_POWER + (1 - LEAST_POWER) * numbers)
        kept, values = run.protocol, self.largest * root
        starts = jnp.concatenate([kept.starts[: self.before], values])
        ends = jnp.concatenate([kept.ends[: self.before], values])
        protocol = eqx.tree_at(lambda p: (p.starts, p.ends), kept, (starts, ends))
        return Run(run.model, protocol)


class FreeScale(AbstractDesignVariable):
    """One factor of all amplitudes, the pattern kept: for bursts and ramps.

    Attributes:
        largest: factor at 1, positive.
        first: where to start.
    """

    largest: Number
    first: Number = 0.5

    @property
    def start(self) -> Float[np.ndarray, " number"]:
        return np.array([float(self.first)])

    def apply(self, numbers: Float[Array, " number"], run: Run) -> Run:
        factor = self.largest * numbers[0]
        protocol_before = run.protocol
        values = protocol_before.starts * factor, protocol_before.ends * factor
        protocol = eqx.tree_at(lambda p: (p.starts, p.ends), protocol_before, values)
        return Run(run.model, protocol)


class FreePlacement(AbstractDesignVariable):
    r"""Where the particles or the power of the first source go, their total kept.

    The field is $\sum_k s_k(x)\,b_k$ of given patterns of one total, with weights $s$
    that are positive and add up to one.

    Attributes:
        patterns: $b_k$, one for each row [kg m⁻³ or W m⁻³].
    """

    patterns: Float[Array, "number ..."]

    @property
    def start(self) -> Float[np.ndarray, " number"]:
        return np.full(self.patterns.shape[0], 0.5)

    def apply(self, numbers: Float[Array, " number"], run: Run) -> Run:
        # a softmax keeps the total and cannot become negative, without a constraint
        fractions = jax.nn.softmax(RANGE * (numbers - 0.5))
        field = jnp.tensordot(fractions, self.patterns, axes=1)
        first, *others = run.model.sources
        if isinstance(first, ParticleSource):
            moved = ParticleSource(field, first.heating, first.scale)
        elif isinstance(first, PowerSource):
            moved = PowerSource(field, first.reference, first.scale)
        else:
            raise InputError(
                "FreePlacement: expected particles or a power density as the first "
                f"source, got {type(first).__name__}"
            )
        model = eqx.tree_at(lambda m: m.sources, run.model, (moved, *others))
        return Run(model, run.protocol)


RANGE = 14.0
"""Range of the logarithms of the weights: a factor of a million."""


def shells(
    model: Bioheat, radius: Number, count: int, total: Number
) -> Float[Array, "number ..."]:
    """Patterns in shells of equal thickness up to a radius [m], of one total each.

    Args:
        model: on whose grid.
        radius: of the outermost shell [m].
        count: number of shells.
        total: integral of each pattern: kilograms of particles, or watts.
    """
    edges = np.linspace(0.0, radius, count + 1)
    balls = [model.grid.ball(float(r)) if r > 0 else None for r in edges]
    rows = []
    for inner, outer in itertools.pairwise(balls):
        assert outer is not None
        shell = outer if inner is None else outer - inner
        rows.append(shell * (total / jnp.sum(shell * model.grid.volumes)))
    return jnp.stack(rows)
