"""Where a run begins: at rest, in a steady state, or in a state of another run."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.quantities import Field
from pinav.thermal.steady import NOT_STEADY, steady_state


class AbstractStart(eqx.Module):
    """What the tissue is like when a run begins."""

    @abc.abstractmethod
    def state(self, model: Bioheat) -> "State":
        """The state of a model, differentiable by its numbers.

        Raises:
            InputError: the model has another grid.
        """


class State(AbstractStart):
    r"""Everything that a run needs to go on.

    Attributes:
        time: since the begin of the protocol [s].
        temperature: of each cell [°C].
        dose: CEM43 of each cell so far [min].
        damage: $\Omega$ of each cell so far, none where it is not followed.
    """

    time: Float[Array, ""]
    temperature: Field
    dose: Field
    damage: Field | None = None

    @classmethod
    def at(cls, temperature: Field) -> "State":
        """A temperature [°C] at the begin of a protocol, no dose."""
        return cls(jnp.asarray(0.0), temperature, jnp.zeros_like(temperature))

    @classmethod
    def at_rest(cls, model: Bioheat) -> "State":
        """Everything at the arterial temperature, no dose."""
        arterial = jnp.asarray(model.blood.arterial, float)
        return cls.at(jnp.full(model.grid.shape, arterial))

    def state(self, model: Bioheat) -> "State":
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

    def state(self, model: Bioheat) -> State:
        return State.at_rest(model)


class AtSteadyState(AbstractStart):
    """The steady state of a constant field, or without one: a cooled wall at rest.

    Attributes:
        amplitude: of that field [A m⁻¹].
        frequency: of that field [Hz].
    """

    amplitude: Scalar = 0.0
    frequency: Scalar = 1e5

    def state(self, model: Bioheat) -> State:
        steady = steady_state(model, self.amplitude, self.frequency)
        return State.at(eqx.error_if(steady.temperature, ~steady.converged, NOT_STEADY))


AT_REST = AtRest()
"""Everything at the arterial temperature."""
