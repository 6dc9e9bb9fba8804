"""Where a run begins: at rest, in a steady state, or in a state of another run."""

import abc
import zipfile
import zlib
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.quantities import Field
from pinav.thermal.steady import NOT_STEADY, steady_state


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

    @classmethod
    def at_rest(cls, model: Bioheat) -> "HeatState":
        """Everything at the arterial temperature, no dose."""
        arterial = jnp.asarray(model.blood.arterial, float)
        return cls.at(jnp.full(model.grid.shape, arterial))

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
        return HeatState.at_rest(model)


class AtSteadyState(AbstractStart):
    """The steady state of a constant field, or without one: a cooled wall at rest."""

    amplitude: Scalar = 0.0
    frequency: Scalar = 1e5

    def state(self, model: Bioheat) -> HeatState:
        steady = steady_state(model, self.amplitude, self.frequency)
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
    arrays = _read_arrays(path)
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


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an npz file by their names, or of an npy file as temperatures."""
    try:
        with open(path, "rb") as file:
            content = np.load(file, allow_pickle=False)
            if isinstance(content, np.ndarray):
                return {"temperature": content}
            with content:
                names = [n for n in ("temperature", "dose") if n in content]
                return {name: content[name] for name in names}
    except (
        OSError,
        ValueError,
        EOFError,
        MemoryError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
