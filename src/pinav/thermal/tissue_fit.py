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
from jaxtyping import Array, Float, PyTree

from pinav.errors import FitError, InputError
from pinav.fitting import EvidenceFit, Outcome
from pinav.thermal import perfusion
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.case import Case
from pinav.thermal.case_geometry import Learn
from pinav.thermal.grids import CartesianGrid
from pinav.thermal.images import read_frames
from pinav.thermal.learning import Residuals, learn, read_residuals, visited_range
from pinav.thermal.readings import Readings, load_probes
from pinav.thermal.setup import Setup
from pinav.thermal.sources import ShiftedSource

DEFAULT_RISE = 6.0
"""Range [K] of the law of a tissue without a probe."""

MORE_RISE = 3.0
"""Range [K] of a law beyond what the case says; single voxels are too noisy for it."""

ADVICE = {
    str(Outcome.STALLED): (
        "the fit stalled before its steps became small; learn fewer numbers (kind = "
        "'constant' or no spot under [learn]), or give more readings"
    )
}
"""What can be changed in a case whose fit failed."""


@dataclasses.dataclass(frozen=True)
class TissueFit:
    """What is fitted to what, and what is known of the truth.

    Attributes:
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
        settings, laws = case.learn or Learn(), setup.body.fractions
        names = tuple(laws) if settings.laws is None else settings.laws
        for name in names:
            if name not in laws:
                raise InputError(
                    f"learn.laws: expected names of tissues, {', '.join(laws)}; got "
                    f"{name!r}"
                )
            perfusion_at_rest(setup, name)
        require_heating(setup)
        data = None if settings.data is None else load_probes(folder / settings.data)
        if settings.thermometry is not None:
            image = setup.body.image
            data = read_frames(settings.thermometry, image, setup.arterial, folder)
        if data is None and not len(setup.points):
            raise InputError(
                "learn: expected data, a CSV file, or probes whose readings are "
                "simulated"
            )
        end = until or settings.until
        if data is not None and end is not None and data.times[0] > end:
            raise InputError(
                f"learn.until: expected a time after the first reading at "
                f"{data.times[0]:g} s, got {end:g} s; fit more of them"
            )
        fitted = data if data is None or end is None else data.until(end)
        truth = None
        if settings.truth is not None:
            truth = _read_truth(folder / settings.truth, setup, names)
        fit = cls(setup, settings, names, fitted, data, truth)
        fit.movable()  # refuses a spot on a grid where none can be moved
        if fitted is not None:
            # refuses readings outside the grid or after the end of the protocol
            fit.residuals(fitted)
            fit._check_readings(fitted)
        return fit

    def _check_readings(self, data: Readings) -> None:
        settings, axes = self.settings, len(self.setup.model.grid.shape)
        numbers = len(self.names) + settings.power_scale + axes * settings.spot
        if (count := int(data.observed.sum())) <= numbers:
            raise InputError(
                f"learn: expected more readings than the {numbers} numbers that are "
                f"learned, got {count}; read more, or learn less"
            )
        read = data.observed.any(axis=0)
        for name in self.names if data.points is None else ():
            if not (read & (np.asarray(self.setup.body.fractions[name]) > 0.5)).any():
                raise InputError(
                    f"learn.laws: expected tissues with a reading, got {name}, of "
                    "which no voxel is read; leave it out"
                )

    def residuals(self, data: Readings) -> Residuals:
        """Predicted less read temperatures, as a function of the model."""
        setup = self.setup
        options = {"stepper": setup.stepper, "start": setup.start}
        return read_residuals(setup.model, setup.protocol, data, **options)

    def learn(self, data: Readings, kind: str | None = None) -> EvidenceFit:
        """Learn laws of a kind, that of the settings unless given, and the sources."""
        setup, kind = self.setup, kind or self.settings.kind
        laws, model = [setup.body.law(name) for name in self.names], self.movable()
        for index, law in enumerate(laws):
            model = eqx.tree_at(law, model, self._first_law(kind, index, data))

        def constants(candidate: Any) -> PyTree:
            values = [law(candidate).value for law in laws if kind == "constant"]
            return tuple(values), self._numbers(candidate)

        def learned(candidate: Any) -> tuple[Any, ...]:
            return tuple(law(candidate) for law in laws if kind != "constant")

        try:
            return learn(
                model,
                setup.protocol,
                data,
                laws=learned,
                constants=constants,
                stepper=setup.stepper,
                start=setup.start,
            )
        except FitError as error:
            advice = ADVICE.get(error.outcome, str(error))
            raise FitError(advice, error.outcome) from error

    def _first_law(
        self, kind: str, index: int, data: Readings
    ) -> perfusion.AbstractPerfusion:
        name, arterial = self.names[index], self.setup.arterial
        rest = perfusion_at_rest(self.setup, name)
        if kind == "constant":
            return perfusion.ConstantPerfusion(jnp.asarray(rest))
        span = (arterial, max(self._hottest(name, data), arterial + 1.0))
        if kind == "kernels":
            return perfusion.kernel_perfusion(rest, span)
        key = jax.random.fold_in(jax.random.key(self.settings.seed), index)
        return perfusion.neural_perfusion(rest, span, key=key)

    def movable(self) -> Bioheat:
        """The model, its first source one that can be shifted if that is learned."""
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
        source: Any = model.sources[0]
        plain: Any = source.source if isinstance(source, ShiftedSource) else source
        numbers = (plain.scale,) if self.settings.power_scale else ()
        return (*numbers, source.shift) if self.settings.spot else numbers

    def _hottest(self, name: str, data: Readings) -> float:
        """Highest temperature of a tissue by its probes, or by the case about [°C]."""
        setup, fraction = self.setup, self.setup.body.fractions[name]
        if data.points is None:
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
        if name not in truth.body.fractions:
            raise InputError(
                f"learn.truth: expected a case with the tissue {name}, got "
                f"{', '.join(truth.body.fractions)}; name its tissues as here"
            )
    return truth


def perfusion_at_rest(setup: Setup, name: str) -> float:
    """Perfusion of a tissue at the arterial temperature [kg m⁻³ s⁻¹], on average."""
    value = mean_perfusion(setup, name, setup.arterial)
    if not value > 0:
        raise InputError(
            f"perfusion of the {name}: expected > 0 where a fit starts, got {value:g}; "
            "give a small value, or leave the tissue out of learn.laws"
        )
    return value


def mean_perfusion(setup: Setup, name: str, celsius: float) -> float:
    """Perfusion of a tissue at a temperature [kg m⁻³ s⁻¹], on average over it."""
    law: perfusion.AbstractPerfusion = setup.body.law(name)(setup.model)
    flow = law(jnp.full(setup.model.grid.shape, celsius))
    fraction = setup.body.fractions[name]
    return float(jnp.sum(flow * fraction) / jnp.sum(fraction))


def require_heating(setup: Setup) -> None:
    """Refuse a field that heats nothing: nothing could be learned or planned."""
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
    names = list(setup.body.fractions)
    path = re.sub(r"perfusion\.laws\[(\d+)\]\.", lambda m: f"{names[int(m[1])]} ", path)
    if path.endswith(" value"):
        return f"perfusion of {path.removesuffix(' value')} [kg/(m³ s)]"
    if path.endswith(" log_level"):
        return f"log perfusion of {path.removesuffix(' log_level')}"
    if shift := re.fullmatch(r"sources\[0\]\.shift\[(\d)\]", path):
        return f"shift of the spot along {'xyz'[int(shift[1])]} [m]"
    return "factor of the power" if path.startswith("sources[0].") else path


def quantities_of(
    fit: TissueFit,
) -> tuple[list[str], Callable[[Bioheat], Float[Array, " quantity"]]]:
    """Numbers that can be compared with those of the truth, as functions of a model.

    The perfusion of tissues where it does not depend on temperature, and power and
    place of the first source, if they are learned; names have the unit.
    """
    setup, settings = fit.setup, fit.settings
    amplitude, frequency = setup.protocol.largest, setup.protocol.frequency
    constant = fit.names if settings.kind == "constant" else ()
    laws = [setup.body.law(name) for name in constant]
    axes = "xyz"[: len(setup.model.grid.shape)] if settings.spot else ""
    names = [f"perfusion of {name} [kg/(m³ s)]" for name in constant]
    names += ["power of the source [W]"] * settings.power_scale
    names += [f"place of the spot along {axis} [mm]" for axis in axes]

    @eqx.filter_jit
    def values(model: Bioheat) -> Float[Array, " quantity"]:
        at = jnp.asarray(model.blood.arterial, float)[None]
        parts = [jnp.mean(law(model)(at)) for law in laws]
        source, grid = model.sources[0], model.grid
        shape = source.shape(grid) * grid.volumes
        if settings.power_scale:
            parts.append(source.level(amplitude, frequency) * jnp.sum(shape))
        parts += [_middle(shape, grid, axis) for axis in range(len(axes))]
        return jnp.stack(parts)

    return names, values


def _middle(shape: Array, grid: Any, axis: int) -> Float[Array, ""]:
    """Centre of the squared power along an axis [mm]: sides cut tails of the power."""
    others = tuple(index for index in range(shape.ndim) if index != axis)
    along = jnp.sum(shape**2, axis=others)
    places = (jnp.arange(float(len(along))) + 0.5) * grid.spacing[axis]
    return 1e3 * (along @ places) / jnp.sum(along)
