"""Where a run begins: at rest, in a steady state, or in a state of another run."""

import abc
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat, HeatBalance
from pinav.thermal.quantities import Field, read_arrays


class AbstractStart(eqx.Module):
    """What the tissue is like when a run begins."""

    @abc.abstractmethod
    def state(self, model: Bioheat) -> "HeatState":
        """The state of a model, differentiable by its numbers."""


class HeatState(AbstractStart):
    r"""Everything that a run needs to go on.

    Attributes:
        time: since the begin of the protocol [s].
        dose: CEM43 of each cell so far [min].
        damage: $\Omega$ of each cell so far, none where it is not followed.
    """

    time: Float[Array, ""]
    temperature: Field
    dose: Field
    damage: Field | None = None

    @classmethod
    def at(cls, temperature: Field) -> "HeatState":
        """A temperature [°C] at the begin of a protocol, no dose."""
        return cls(jnp.asarray(0.0), temperature, jnp.zeros_like(temperature))

    def state(self, model: Bioheat) -> "HeatState":
        for name in ("temperature", "dose"):
            shape = getattr(self, name).shape
            if shape != model.grid.shape:
                raise InputError(
                    f"start: expected a {name} of shape {model.grid.shape}, that of "
                    f"the grid, got {shape}"
                )
        return self


class AtRest(AbstractStart):
    """Everything at the arterial temperature."""

    def state(self, model: Bioheat) -> HeatState:
        arterial = jnp.asarray(model.blood.arterial, float)
        return HeatState.at(jnp.full(model.grid.shape, arterial))


class AtSteadyState(AbstractStart):
    """The steady state without a field, such as that of a cooled wall at rest."""

    def state(self, model: Bioheat) -> HeatState:
        steady = steady_state(model)
        return HeatState.at(
            eqx.error_if(steady.temperature, ~steady.converged, NOT_STEADY)
        )


AT_REST = AtRest()
"""Everything at the arterial temperature."""

COLDEST = -50.0
"""Lowest temperature [°C] that tissue may begin with."""

HOTTEST = 150.0
"""Highest temperature [°C] that tissue may begin with; beyond it they are kelvins."""


def read_state(path: Path, shape: tuple[int, ...]) -> HeatState:
    """The end of another run, or temperatures of a file of NumPy.

    Raises:
        InputError: the file cannot be read, or is of another grid.
    """
    content = read_arrays(path)
    named = {"temperature": content[""]} if "" in content else content
    arrays = {name: named[name] for name in ("temperature", "dose") if name in named}
    for name, values in arrays.items():
        if values.dtype.kind not in "biuf":
            raise InputError(
                f"{path}: expected numbers as {name}, got {values.dtype}; save floats"
            )
    if "temperature" not in arrays:
        raise InputError(
            f"{path}: expected the results.npz of a run, with a temperature, got "
            f"{', '.join(arrays) or 'nothing'}"
        )
    temperature = arrays["temperature"]
    dose = arrays.get("dose", np.zeros(shape))
    if temperature.shape != shape or dose.shape != shape:
        raise InputError(
            f"{path}: expected temperatures of shape {shape}, that of the grid, got "
            f"{temperature.shape}; take the same grid"
        )
    outside = ~((temperature >= COLDEST) & (temperature <= HOTTEST))
    if outside.any():
        raise InputError(
            f"{path}: expected temperatures between {COLDEST:g} and {HOTTEST:g} °C, "
            f"got {temperature[outside][0]:g}; subtract 273.15 from kelvins"
        )
    if not np.all((dose >= 0) & np.isfinite(dose)):
        raise InputError(
            f"{path}: expected doses >= 0 CEM43 min, got "
            f"{dose[~((dose >= 0) & np.isfinite(dose))][0]:g}; take results of a run"
        )
    return HeatState(
        jnp.asarray(0.0), jnp.asarray(temperature, float), jnp.asarray(dose, float)
    )


FIRST_STEP, GROWTH, LAST_STEP = 100.0, 10.0, 1e9
"""Pseudo-time steps [s]: the first, the factor of each to the next, the longest."""

MOST_ITERATIONS = 60

ROUGH, EXACT = 1e-6, 1e-12
"""Relative residuals of the conjugate gradients: on the way, and of the last step."""

SMALL_CHANGE = 1e-8
"""Change [K] of a Newton step that ends the iteration."""

NOT_STEADY = (
    "steady state: none was reached; heat must be able to leave, by perfusion or "
    "through a side, and the field must not be too strong"
)


class SteadyState(eqx.Module):
    """A steady temperature."""

    temperature: Field
    iterations: Int[Array, ""]
    converged: Bool[Array, ""]


class _Progress(eqx.Module):
    temperature: Field
    step: Float[Array, ""]
    change: Float[Array, ""]
    iterations: Int[Array, ""]


@eqx.filter_jit
def steady_state(
    model: Bioheat, amplitude: Scalar = 0.0, frequency: Scalar = 1e5
) -> SteadyState:
    r"""The temperature that no longer changes at a constant field [A m⁻¹, Hz].

    Newton's method in pseudo-time, $(C/\Delta t + K + S')\,\delta = F(T)$: implicit
    Euler steps that grow until they are Newton's. $K$ is symmetric, so that one
    tridiagonal solve, or conjugate gradients in planes and boxes, is all that a step
    needs. From arterial temperature on: where the perfusion of a tumour collapses, so
    that two steady states exist, it is the colder one.
    """
    balance, forced = HeatBalance.of(model), model.levels(amplitude, frequency)
    # gradients come from one Newton step at the solution, not from the iteration
    arterial = jnp.asarray(model.blood.arterial, float)
    still = jax.lax.stop_gradient((balance, forced, arterial))
    end = _iterate(*still)
    residual = _residual(balance, forced, end.temperature)
    slope = still[0].sink_slope(end.temperature)
    last = still[0].solve(slope * still[0].volumes, residual, tolerance=EXACT)
    return SteadyState(
        end.temperature + last, end.iterations, end.change <= SMALL_CHANGE
    )


def find_steady_state(
    model: Bioheat, amplitude: Scalar = 0.0, frequency: Scalar = 1e5
) -> SteadyState:
    """The same, outside of transformations.

    Raises:
        InputError: there is no steady state, or none was reached.
    """
    state = steady_state(model, amplitude, frequency)
    if not bool(state.converged):
        raise InputError(NOT_STEADY)
    return state


def _iterate(balance: HeatBalance, forced: Array, arterial: Array) -> _Progress:
    capacity = 1 / balance.inverse_capacity

    def go_on(progress: _Progress) -> Bool[Array, ""]:
        unsettled = (progress.change > SMALL_CHANGE) | (progress.step < LAST_STEP)
        finite = jnp.isfinite(progress.change)
        return unsettled & finite & (progress.iterations < MOST_ITERATIONS)

    def newton(progress: _Progress) -> _Progress:
        at = progress.temperature
        # a falling perfusion has a negative slope, with which the matrix may lose its
        # definiteness before the steps are long
        slope = jnp.maximum(balance.sink_slope(at), 0.0) * balance.volumes
        diagonal = slope + capacity / progress.step
        residual = _residual(balance, forced, at)
        change = balance.solve(diagonal, residual, tolerance=ROUGH)
        step = jnp.minimum(GROWTH * progress.step, LAST_STEP)
        size = jnp.max(jnp.abs(change))
        return _Progress(at + change, step, size, progress.iterations + 1)

    begin = jnp.full_like(capacity, arterial)
    first = _Progress(
        begin, jnp.asarray(FIRST_STEP), jnp.asarray(jnp.inf), jnp.asarray(0)
    )
    # the first change is not finite by definition: one step is taken before the loop
    return jax.lax.while_loop(go_on, newton, newton(first))


def _residual(balance: HeatBalance, forced: Array, temperature: Field) -> Field:
    gain, _ = balance.conduction(temperature)
    taken = balance.sink(temperature) * balance.volumes
    return gain + balance.heating(forced) - taken
