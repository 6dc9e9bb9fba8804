r"""Which formula a learned perfusion is: candidates refitted to the readings.

As with forces: each candidate is fitted to the learned curve first, weighted by its
band, then to the readings through the whole equation, and candidates are ranked by
BIC. On visited ground alone, where the curve says anything.
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.fitting import Outcome
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.least_squares import fit_regression
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.learning import PerfusionCurve, learn
from pinav.thermal.perfusion import (
    AbstractPerfusion,
    CollapsingPerfusion,
    ConstantPerfusion,
    RisingPerfusion,
)
from pinav.thermal.probes import ProbeData
from pinav.thermal.protocols import AbstractProtocol
from pinav.thermal.quantities import Field
from pinav.thermal.steppers import AbstractStepper


class ExponentialPerfusion(AbstractPerfusion):
    r"""$w = w_0 e^{a (T - 37)}$.

    Attributes:
        level: $w_0$ [kg m⁻³ s⁻¹].
        growth: $a$ [K⁻¹].
    """

    level: Scalar
    growth: Scalar

    def __call__(self, temperature: Field) -> Field:
        return self.level * jnp.exp(self.growth * (temperature - 37.0))


class LogisticPerfusion(AbstractPerfusion):
    r"""$w = a + b/(1 + e^{-(T - T_m)/s})$.

    Attributes:
        rest: $a$ [kg m⁻³ s⁻¹].
        gain: $b$ [kg m⁻³ s⁻¹].
        middle: $T_m$ [°C].
        width: $s$ [K].
    """

    rest: Scalar
    gain: Scalar
    middle: Scalar
    width: Scalar

    def __call__(self, temperature: Field) -> Field:
        slope = jnp.tanh(0.5 * (temperature - self.middle) / self.width)
        return self.rest + 0.5 * self.gain * (1 + slope)


CANDIDATES: Mapping[str, AbstractPerfusion] = {
    "constant": ConstantPerfusion(1.0),
    "exponential": ExponentialPerfusion(0.5, 0.2),
    "rise to a plateau (Lang)": RisingPerfusion(0.5, 3.0, 45.0, 12.0),
    "logistic": LogisticPerfusion(0.5, 3.0, 42.0, 1.0),
    "collapse (Lang)": CollapsingPerfusion(),
}
"""Where each candidate starts; those of Lang et al. (1999) among them."""


class LawFit(eqx.Module):
    """A candidate refitted to the readings.

    Attributes:
        name: of the candidate.
        law: with its best constants.
        constants: their values and standard deviations.
        squares: sum of squared residuals [K²].
        bic: of the readings; lower is better.
        converged: whether both fits ended well.
    """

    name: str = eqx.field(static=True)
    law: AbstractPerfusion
    constants: dict[str, Estimate]
    squares: float
    bic: float
    converged: bool = eqx.field(static=True)


class _CurveResiduals(eqx.Module):
    """A law less a learned curve, in standard deviations."""

    temperatures: Float[Array, " temperature"]
    values: Float[Array, " temperature"]
    sd: Float[Array, " temperature"]

    def __call__(self, law: AbstractPerfusion) -> Float[Array, " temperature"]:
        return (law(self.temperatures) - self.values) / self.sd


def rank_laws(
    model: Bioheat,
    protocol: AbstractProtocol,
    data: ProbeData,
    *,
    law: Callable[[Any], AbstractPerfusion],
    curve: PerfusionCurve,
    candidates: Mapping[str, AbstractPerfusion] = CANDIDATES,
    stepper: AbstractStepper | None = None,
) -> list[LawFit]:
    """Candidates for one learned law, the best first.

    Args:
        model: of the fit; all its other laws stay as they are.
        protocol: the field while the readings were taken.
        data: the readings.
        law: picks the law from the model.
        curve: the law, learned.
        candidates: by name, each with the constants from which it starts.
        stepper: as of `solve`.

    Raises:
        FitError: a candidate leads nowhere at once.
    """
    inside = curve.inside
    curve_residuals = _CurveResiduals(
        jnp.asarray(curve.temperatures[inside]),
        jnp.asarray(curve.values[inside]),
        jnp.asarray((curve.values * np.maximum(curve.sd, LEAST_SD))[inside]),
    )
    fits = []
    for name, start in candidates.items():
        # first to the curve, which is quick, so that the run starts near the optimum
        shaped = fit_regression(
            start, curve_residuals, constants=lambda m: m, throw=False
        )
        refit = learn(
            eqx.tree_at(law, model, shaped.model),
            protocol,
            data,
            constants=law,
            stepper=stepper,
            throw=False,
        )
        count, free = int(data.observed.sum()), len(refit.constants)
        # the noise is that of the restricted likelihood: its divisor is count - free
        squares = refit.hyperparameters.noise**2 * (count - free)
        bic = count * np.log(squares / count) + free * np.log(count)
        converged = refit.outcome is Outcome.CONVERGED
        best = law(refit.model)
        fits.append(LawFit(name, best, refit.constants, squares, float(bic), converged))
    return sorted(fits, key=lambda fit: fit.bic)


LEAST_SD = 0.02
"""Relative error of the curve below which it is not trusted."""
