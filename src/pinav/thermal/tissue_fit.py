"""The fit of a case to readings: what is learned, from which start."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.errors import FitError, InputError
from pinav.fitting import EvidenceFit, Outcome
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.case import Case
from pinav.thermal.case_geometry import Learn
from pinav.thermal.grids import CartesianGrid
from pinav.thermal.learned_perfusion import kernel_perfusion, neural_perfusion
from pinav.thermal.learning import (
    ProbeResiduals,
    learn,
    read_residuals,
    visited_range,
)
from pinav.thermal.perfusion import AbstractPerfusion, ConstantPerfusion
from pinav.thermal.probes import ProbeData
from pinav.thermal.readings import Readings, read_data, readings_until
from pinav.thermal.setup import Setup
from pinav.thermal.sources import ShiftedSource
from pinav.thermal.thermometry import Thermometry, ThermometryResiduals

DEFAULT_RISE = 6.0
"""Range [K] of the law of a tissue without a probe."""

MORE_RISE = 3.0
"""Range [K] of a law beyond what the case says; single voxels are too noisy for it."""

ADVICE = {
    str(Outcome.STALLED): (
        "the fit stalled before its steps became small; learn fewer numbers (kind = "
        "'constant' or no spot under [learn]), or give more readings"
    ),
}
"""What can be changed in a case whose fit failed."""


@dataclasses.dataclass(frozen=True)
class TissueFit:
    """What is fitted to what, and what is known of the truth.

    Attributes:
        setup: case.
        settings: its table `learn`.
        names: tissues whose perfusion is learned.
        fitted: readings that are fitted; none where the case makes its own.
        every: all readings that there are.
        truth: case that made the readings, where it is known.
    """

    setup: Setup
    settings: Learn
    names: tuple[str, ...]
    fitted: Readings | None
    every: Readings | None
    truth: Setup | None

    @classmethod
    def of(
        cls, case: Case, setup: Setup, folder: Path, until: float | None = None
    ) -> "TissueFit":
        """The fit of a case, to readings up to a time [s] unless its table says one.

        Raises:
            InputError: a file cannot be read, or nothing could be learned from it.
        """
        settings = case.learn or Learn()
        names = tuple(setup.laws) if settings.laws is None else settings.laws
        for name in names:
            if name not in setup.laws:
                raise InputError(
                    f"learn.laws: expected names of tissues, {', '.join(setup.laws)}; "
                    f"got {name!r}"
                )
            perfusion_at_rest(setup, name)
        require_heating(setup)
        data = read_data(settings, setup, folder)
        if data is None and not len(setup.points):
            raise InputError(
                "learn: expected data, a CSV file, or probes whose readings are "
                "simulated"
            )
        end = until or settings.until
        fitted = data if data is None or end is None else readings_until(data, end)
        truth = None
        if settings.truth is not None:
            truth = _read_truth(folder / settings.truth, setup, names)
        fit = cls(setup, settings, names, fitted, data, truth)
        fit.movable()  # refuses a spot on a grid where none can be moved
        if fitted is not None:
            # refuses readings outside the grid or after the end of the protocol
            fit.residuals(setup.model, fitted)
            fit._check_readings(fitted)
        return fit

    def _check_readings(self, data: Readings) -> None:
        """Refuse fewer readings than numbers that are learned, and unread tissue."""
        settings, axes = self.settings, len(self.setup.model.grid.shape)
        numbers = len(self.names) + settings.power_scale + axes * settings.spot
        if (count := int(data.observed.sum())) <= numbers:
            raise InputError(
                f"learn: expected more readings than the {numbers} numbers that are "
                f"learned, got {count}; read more, or learn less"
            )
        read = data.observed.any(axis=0)
        for name in self.names if isinstance(data, Thermometry) else ():
            if not (read & (np.asarray(self.setup.fractions[name]) > 0.5)).any():
                raise InputError(
                    f"learn.laws: expected tissues with a reading, got {name}, of "
                    "which no voxel is read; leave it out"
                )

    def residuals(
        self, model: Bioheat, data: Readings
    ) -> ProbeResiduals | ThermometryResiduals:
        """Predicted less read temperatures, as a function of the model.

        Raises:
            InputError: the readings do not fit the grid or the protocol.
        """
        setup = self.setup
        return read_residuals(
            model, setup.protocol, data, stepper=setup.stepper, start=setup.start
        )

    def learn(self, data: Readings) -> EvidenceFit:
        """Learn what the settings say.

        Raises:
            FitError: the fit did not converge.
        """
        constant = self.settings.kind == "constant"
        try:
            return self.learn_constants(data) if constant else self._learn_laws(data)
        except FitError as error:
            advice = ADVICE.get(error.outcome, str(error))
            raise FitError(advice, error.outcome) from error

    def learn_constants(self, data: Readings) -> EvidenceFit:
        """Learn the same with perfusions that do not depend on temperature."""
        laws = tuple(self.setup.laws[name] for name in self.names)
        start = self.movable()
        for name, law in zip(self.names, laws, strict=True):
            rest = jnp.asarray(perfusion_at_rest(self.setup, name))
            start = eqx.tree_at(law, start, ConstantPerfusion(rest))
        return self._fit(
            start,
            data,
            constants=lambda m: (
                tuple(law(m).value for law in laws),
                self._numbers(m),
            ),
        )

    def _learn_laws(self, data: Readings) -> EvidenceFit:
        """Learn laws of the temperature, with the numbers of the sources."""
        setup, settings, model = self.setup, self.settings, self.movable()
        laws = tuple(setup.laws[name] for name in self.names)
        for index, (name, law) in enumerate(zip(self.names, laws, strict=True)):
            rest, top = perfusion_at_rest(setup, name), self._hottest(name, data)
            span = (setup.arterial, max(top, setup.arterial + 1.0))
            key = jax.random.fold_in(jax.random.key(settings.seed), index)
            learned = (
                neural_perfusion(rest, span, key=key)
                if settings.kind == "network"
                else kernel_perfusion(rest, span)
            )
            model = eqx.tree_at(law, model, learned)
        return self._fit(
            model,
            data,
            laws=lambda m: tuple(law(m) for law in laws),
            constants=self._numbers,
        )

    def _fit(self, start: Bioheat, data: Readings, **picked: Any) -> EvidenceFit:
        setup = self.setup
        options = {"stepper": setup.stepper, "start": setup.start}
        return learn(start, setup.protocol, data, **picked, **options)

    def movable(self) -> Bioheat:
        """The model, its first source one that can be shifted if that is learned.

        Raises:
            InputError: the grid is no box.
        """
        model = self.setup.model
        if not self.settings.spot or isinstance(model.sources[0], ShiftedSource):
            return model
        if not isinstance(model.grid, CartesianGrid):
            raise InputError(
                "learn.spot: expected a box or voxels, in which a spot can be moved, "
                "got a sphere or a cylinder; remove it"
            )
        first, *others = model.sources
        moved = ShiftedSource(first, jnp.zeros(len(model.grid.shape)))
        return eqx.tree_at(lambda m: m.sources, model, (moved, *others))

    def _numbers(self, model: Any) -> tuple:
        """The numbers of the first source that are learned too."""
        source: Any = model.sources[0]
        plain: Any = source.source if isinstance(source, ShiftedSource) else source
        numbers = (plain.scale,) if self.settings.power_scale else ()
        return (*numbers, source.shift) if self.settings.spot else numbers

    def _hottest(self, name: str, data: Readings) -> float:
        """Highest temperature of a tissue by its probes, or by the case about [°C]."""
        setup, fraction = self.setup, self.setup.fractions[name]
        if not isinstance(data, ProbeData):
            visited = visited_range(setup.model, setup.protocol, fraction, setup.start)
            return visited[1] + MORE_RISE
        weights = np.asarray(setup.model.grid.interpolation(data.points))
        shares = weights.reshape(len(weights), -1) @ np.asarray(fraction).reshape(-1)
        readings = data.values[:, shares > 0.5]
        if not readings.size:
            return setup.arterial + DEFAULT_RISE
        return float(np.nanmax(readings))


def _read_truth(path: Path, setup: Setup, names: tuple[str, ...]) -> Setup:
    truth = Setup.read(path)
    given, expected = (
        f"{one.model.grid.shape} of {np.array(one.model.grid.cell_sizes)} m"
        for one in (truth, setup)
    )
    if given != expected:
        raise InputError(
            f"learn.truth: expected a case on the cells of this one, {expected}, got "
            f"{given}; take the same"
        )
    for name in names:
        if name not in truth.laws:
            raise InputError(
                f"learn.truth: expected a case with the tissue {name}, got "
                f"{', '.join(truth.laws)}; name its tissues as here"
            )
    return truth


def perfusion_at_rest(setup: Setup, name: str) -> float:
    """Perfusion of a tissue at the arterial temperature [kg m⁻³ s⁻¹], on average.

    Raises:
        InputError: it is zero, from where no fit starts.
    """
    value = mean_perfusion(setup, name, setup.arterial)
    if not value > 0:
        raise InputError(
            f"perfusion of the {name}: expected > 0 where a fit starts, got {value:g}; "
            "give a small value, or leave the tissue out of learn.laws"
        )
    return value


def mean_perfusion(setup: Setup, name: str, celsius: float) -> float:
    """Perfusion of a tissue at a temperature [kg m⁻³ s⁻¹], on average over it."""
    law: AbstractPerfusion = setup.laws[name](setup.model)
    flow = law(jnp.full(setup.model.grid.shape, celsius))
    fraction = setup.fractions[name]
    return float(jnp.sum(flow * fraction) / jnp.sum(fraction))


def require_heating(setup: Setup) -> None:
    """Refuse a field that heats nothing: nothing could be learned or planned.

    Raises:
        InputError: it brings no power into the tissue.
    """
    protocol, grid = setup.protocol, setup.model.grid
    if not protocol.largest > 0:
        raise InputError(
            "field.amplitudes: expected one > 0 A/m, got none; tissue that is not "
            "heated tells nothing of its perfusion, and has no best field"
        )
    powers = [
        float(source.level(protocol.largest, protocol.frequency))
        * float(jnp.sum(source.shape(grid) * grid.volumes))
        for source in setup.model.sources
    ]
    if not max(powers) > 0:
        raise InputError(
            "heating: expected a power > 0 W in the tissue, got none; give a density, "
            "a map or particles that heat"
        )


def describe_constant(path: str, setup: Setup) -> str:
    """The name of a number of the model, by its path in it."""
    names = list(setup.laws)
    path = path.replace("perfusion.inside.", "tumour ").replace(
        "perfusion.outside.", "tissue "
    )
    path = re.sub(r"perfusion\.laws\[(\d+)\]\.", lambda m: f"{names[int(m[1])]} ", path)
    if path.endswith(" value"):
        return f"perfusion of {path.removesuffix(' value')} [kg/(m³ s)]"
    if path.endswith(" log_level"):
        return f"log perfusion of {path.removesuffix(' log_level')}"
    if shift := re.fullmatch(r"sources\[0\]\.shift\[(\d)\]", path):
        return f"shift of the spot along {'xyz'[int(shift[1])]} [m]"
    return "factor of the power" if path.startswith("sources[0].") else path


class Quantities(eqx.Module):
    """Numbers of a model that can be compared with those of the truth.

    Attributes:
        laws: of tissues whose perfusion does not depend on temperature, by their names.
        amplitude: amplitude of the field at which the power is meant [A m⁻¹].
        frequency: frequency of the field [Hz].
        spot: True if the place of the first source is one of them.
        power: True if its power is.
    """

    laws: dict[str, Callable[[Any], Any]] = eqx.field(static=True)
    amplitude: float
    frequency: Any
    spot: bool = eqx.field(static=True)
    power: bool = eqx.field(static=True)

    @classmethod
    def of(cls, fit: TissueFit) -> "Quantities":
        """Those that are learned."""
        setup, settings = fit.setup, fit.settings
        names = fit.names if settings.kind == "constant" else ()
        return cls(
            {name: setup.laws[name] for name in names},
            setup.protocol.largest,
            setup.protocol.frequency,
            settings.spot,
            settings.power_scale,
        )

    def names(self, axes: int) -> list[str]:
        """Name of each, with its unit, in a number of dimensions."""
        names = [f"perfusion of {name} [kg/(m³ s)]" for name in self.laws]
        names += ["power of the source [W]"] * self.power
        places = [f"place of the spot along {axis} [mm]" for axis in "xyz"[:axes]]
        return names + places * self.spot

    @eqx.filter_jit
    def __call__(self, model: Bioheat) -> Float[Array, " quantity"]:
        """Their values for a model."""
        at = jnp.asarray(model.blood.arterial, float)[None]
        values = [jnp.mean(law(model)(at)) for law in self.laws.values()]
        source, grid = model.sources[0], model.grid
        if self.power or self.spot:
            shape = source.shape(grid) * grid.volumes
            total = jnp.sum(shape)
            if self.power:
                level = source.level(self.amplitude, self.frequency)
                values.append(level * total)
            if self.spot:
                values += [_middle(shape, grid, axis) for axis in range(shape.ndim)]
        return jnp.stack(values) if values else jnp.zeros(0)


def _middle(shape: Array, grid: Any, axis: int) -> Float[Array, ""]:
    """Centre of the squared power along an axis [mm]: sides cut tails of the power."""
    others = tuple(index for index in range(shape.ndim) if index != axis)
    along = jnp.sum(shape**2, axis=others)
    places = (jnp.arange(float(len(along))) + 0.5) * grid.spacing[axis]
    return 1e3 * (along @ places) / jnp.sum(along)
