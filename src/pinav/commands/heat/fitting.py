"""The fit of a case to readings: what is learned, and what follows from it."""

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.heat.aims import Learn
from pinav.commands.heat.build import CaseModel
from pinav.commands.heat.history import Watched
from pinav.commands.heat.readings import Readings
from pinav.errors import FitError, InputError
from pinav.fitting import EvidenceFit, Outcome
from pinav.fitting.engine.posterior import Posterior
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.grids import CartesianGrid
from pinav.thermal.learned_perfusion import kernel_perfusion, neural_perfusion
from pinav.thermal.learning import learn, visited_range
from pinav.thermal.perfusion import AbstractPerfusion, ConstantPerfusion
from pinav.thermal.probes import ProbeData
from pinav.thermal.schedule import plan_steps
from pinav.thermal.solve import run
from pinav.thermal.sources import ShiftedSource

DEFAULT_RISE = 6.0
"""Range [K] of the law of a tissue without a probe."""

MORE_RISE = 3.0
"""Range [K] of a law beyond what the case says; single voxels are too noisy for it."""


def law_names(setup: CaseModel, settings: Learn) -> tuple[str, ...]:
    """Tissues whose perfusion is learned: all of a case that names none.

    Raises:
        InputError: there is no such tissue.
    """
    names = tuple(setup.body.laws) if settings.laws is None else settings.laws
    for name in names:
        if name not in setup.body.laws:
            raise InputError(
                f"learn.laws: expected names of tissues, {', '.join(setup.body.laws)}; "
                f"got {name!r}"
            )
    return names


def value_at_rest(setup: CaseModel, name: str) -> float:
    """Perfusion of a tissue at the arterial temperature [kg m⁻³ s⁻¹], on average.

    Raises:
        InputError: it is zero, from where no fit starts.
    """
    value = mean_perfusion(setup, name, float(setup.model.blood.arterial))
    if not value > 0:
        raise InputError(
            f"perfusion of the {name}: expected > 0 where a fit starts, got {value:g}; "
            "give a small value, or leave the tissue out of learn.laws"
        )
    return value


def mean_perfusion(setup: CaseModel, name: str, celsius: float) -> float:
    """Perfusion of a tissue at a temperature [kg m⁻³ s⁻¹], on average over it."""
    law: AbstractPerfusion = setup.body.laws[name](setup.model)
    flow = law(jnp.full(setup.model.grid.shape, celsius))
    fraction = setup.body.fractions[name]
    return float(jnp.sum(flow * fraction) / jnp.sum(fraction))


def require_heating(setup: CaseModel) -> None:
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


def fit_case(setup: CaseModel, settings: Learn, data: Readings) -> EvidenceFit:
    """Learn what the settings say.

    Raises:
        FitError: the fit did not converge.
    """
    try:
        if settings.kind == "constant":
            return fit_constant(setup, settings, data)
        return _fit_laws(setup, settings, data)
    except FitError as error:
        raise FitError(ADVICE.get(error.outcome, str(error)), error.outcome) from error


ADVICE = {
    str(Outcome.STALLED): (
        "the fit stalled before its steps became small; learn fewer numbers (kind = "
        "'constant' or no spot under [learn]), or give more readings"
    ),
}
"""What a fit that failed advises on the command line."""


def _fit_laws(setup: CaseModel, settings: Learn, data: Readings) -> EvidenceFit:
    """Perfusion laws of the temperature, with the numbers of the sources."""
    laws = tuple(setup.body.laws[name] for name in law_names(setup, settings))
    return learn(
        _initial_model(setup, settings, data),
        setup.protocol,
        data,
        laws=lambda m: tuple(law(m) for law in laws),
        constants=_source_numbers(settings),
        stepper=setup.stepper,
        start=setup.start,
    )


def fit_constant(setup: CaseModel, settings: Learn, data: Readings) -> EvidenceFit:
    """The same with a perfusion of each tissue that does not depend on temperature."""
    names = law_names(setup, settings)
    laws = tuple(setup.body.laws[name] for name in names)
    start = movable(setup, settings)
    for name, law in zip(names, laws, strict=True):
        rest = ConstantPerfusion(jnp.asarray(value_at_rest(setup, name)))
        start = eqx.tree_at(law, start, rest)
    numbers = _source_numbers(settings)
    return learn(
        start,
        setup.protocol,
        data,
        constants=lambda m: (tuple(law(m).value for law in laws), numbers(m)),
        stepper=setup.stepper,
        start=setup.start,
    )


def movable(setup: CaseModel, settings: Learn) -> Bioheat:
    """The model, its first source one that can be shifted if that is learned.

    Raises:
        InputError: the grid is no box.
    """
    model = setup.model
    if not settings.spot or isinstance(model.sources[0], ShiftedSource):
        return model
    if not isinstance(model.grid, CartesianGrid):
        raise InputError(
            "learn.spot: expected a box or voxels, in which a spot can be moved, got a "
            "sphere or a cylinder; remove it"
        )
    first, *others = model.sources
    moved = ShiftedSource(first, jnp.zeros(len(model.grid.shape)))
    return eqx.tree_at(lambda m: m.sources, model, (moved, *others))


def _source_numbers(settings: Learn) -> Callable[[Any], Any]:
    """Picks the numbers of the first source that are learned too."""

    def pick(model: Any) -> tuple:
        source: Any = model.sources[0]
        numbers = []
        if settings.power_scale:
            numbers.append(_unshifted_source(source).scale)
        return (*numbers, source.shift) if settings.spot else tuple(numbers)

    return pick


def _unshifted_source(source: Any) -> Any:
    """The source that has the factor of the power."""
    return source.source if isinstance(source, ShiftedSource) else source


def _initial_model(setup: CaseModel, settings: Learn, data: Readings) -> Bioheat:
    """The model with constant laws, at the perfusion at rest.

    Each may vary up to the hottest temperature of its own tissue.
    """
    model, arterial = movable(setup, settings), float(setup.model.blood.arterial)
    for index, name in enumerate(law_names(setup, settings)):
        rest, top = value_at_rest(setup, name), _hottest(setup, name, data)
        span = (arterial, max(top, arterial + 1.0))
        key = jax.random.fold_in(jax.random.key(settings.seed), index)
        learned = (
            neural_perfusion(rest, span, key=key)
            if settings.kind == "network"
            else kernel_perfusion(rest, span)
        )
        model = eqx.tree_at(setup.body.laws[name], model, learned)
    return model


def _hottest(setup: CaseModel, name: str, data: Readings) -> float:
    """Highest temperature of a tissue by its probes, or by the case about [°C]."""
    fraction = setup.body.fractions[name]
    if not isinstance(data, ProbeData):
        visited = visited_range(setup.model, setup.protocol, fraction, setup.start)
        return visited[1] + MORE_RISE
    weights = np.asarray(setup.model.grid.interpolation(data.points))
    inside = weights.reshape(len(weights), -1) @ np.asarray(fraction).reshape(-1) > 0.5
    readings = data.values[:, inside]
    if not readings.size:
        return float(setup.model.blood.arterial) + DEFAULT_RISE
    return float(np.nanmax(readings))


def describe_constant(path: str, setup: CaseModel) -> str:
    """What a number of the model is, by its path in it."""
    names = list(setup.body.laws)
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
        amplitude: of the field [A m⁻¹] at which the power is meant.
        frequency: of the field [Hz].
        spot: whether the place of the first source is one of them.
        power: whether its power is.
    """

    laws: dict[str, Callable[[Any], Any]] = eqx.field(static=True)
    amplitude: float
    frequency: Any
    spot: bool = eqx.field(static=True)
    power: bool = eqx.field(static=True)

    @classmethod
    def of(cls, setup: CaseModel, settings: Learn) -> "Quantities":
        """Those that are learned."""
        names = law_names(setup, settings) if settings.kind == "constant" else ()
        return cls(
            {name: setup.body.laws[name] for name in names},
            setup.protocol.largest,
            setup.protocol.frequency,
            settings.spot,
            settings.power_scale,
        )

    def names(self, axes: int) -> list[str]:
        """Of each, with its unit, in a number of dimensions."""
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


@dataclasses.dataclass(frozen=True)
class Forecast:
    """Temperatures that a posterior predicts of the target.

    Attributes:
        times: [s].
        values: by `FOLLOWED`, at each time [°C].
        sd: their standard deviations.
    """

    times: Float[np.ndarray, " time"]
    values: Float[np.ndarray, "time quantity"]
    sd: Float[np.ndarray, "time quantity"]


FOLLOWED = ("hottest", "T10", "T50", "T90")


def forecast(setup: CaseModel, posterior: Posterior, count: int = 30) -> Forecast:
    """Temperatures of the whole protocol, their band by the delta method."""
    times = np.linspace(0.0, setup.protocol.duration, count + 1)[1:]
    with jax.enable_x64(new_val=True):
        theta = jnp.asarray(posterior.mean)
        values, slopes = _curves_and_slopes(setup, times)(posterior.free, theta)
    variance = np.einsum(
        "tqp,pr,tqr->tq", np.asarray(slopes), posterior.covariance, np.asarray(slopes)
    )
    return Forecast(times, np.asarray(values), np.sqrt(np.maximum(variance, 0.0)))


def followed_curves(
    setup: CaseModel, model: Bioheat, times: np.ndarray
) -> Float[np.ndarray, "time quantity"]:
    """Those of one model [°C]."""
    return np.asarray(_curves(setup, times)(model))


def _curves(setup: CaseModel, times: np.ndarray) -> Callable[[Any], Array]:
    watched, schedule = (
        Watched.of(setup, None),
        plan_steps(
            setup.protocol, setup.stepper.longest_step(setup.model), save_at=times
        ),
    )

    def follow(model: Any) -> Array:
        solution = run(
            model,
            setup.protocol,
            schedule,
            stepper=setup.stepper,
            observe=watched.temperatures,
            start=setup.start,
        )
        return jnp.stack([solution.observed[name] for name in FOLLOWED], axis=-1)

    return follow


def _curves_and_slopes(setup: CaseModel, times: np.ndarray) -> Callable:
    """Forward mode: there are fewer parameters than temperatures."""
    follow = _curves(setup, times)

    @eqx.filter_jit
    def both(free: Any, theta: Array) -> tuple[Array, Array]:
        value, push = jax.linearize(lambda at: follow(free(at)), theta)
        return value, jnp.moveaxis(jax.lax.map(push, jnp.eye(len(theta))), 0, -1)

    return both
