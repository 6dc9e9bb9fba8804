"""A run of a case and what it reached: temperatures and doses of target and tissue."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, PyTree

from pinav.arguments import Scalar
from pinav.thermal.bioheat import Bioheat, HeatBalance
from pinav.thermal.dose import (
    cem43_segment,
    time_to_reach,
    value_exceeded_by,
    volume_above,
)
from pinav.thermal.protocols import Piecewise
from pinav.thermal.setup import Setup
from pinav.thermal.solve import Observe, Solution, probes_at, solve
from pinav.thermal.sources import ParticleSource

REGULAR_TIMES = 180
"""Times at which curves are saved, beside every switch of the field."""

MOMENTS = 61
"""Times at most at which the temperature of a plane is kept."""

THERAPEUTIC = 10.0
"""CEM43 [min] of T90 that trials of hyperthermia aim at."""

HOTTEST_VALID = 55.0
"""Temperature [°C] above which neither perfusion nor linear response is known."""

OFF = 1e-5
"""Share of the largest amplitude below which the field is off: a plan leaves less."""

SHARES = {"T10": 0.1, "T50": 0.5, "T90": 0.9}
"""Share of the target's volume that exceeds each temperature."""


class AbstractHeatResult(eqx.Module):
    """What a task on a case computed."""

    title: eqx.AbstractVar[str]


class RadialBalance(eqx.Module):
    """The heat balance along a radius as numbers, which the explorer's page integrates.

    Attributes:
        inverse_capacity: one over the heat capacity of each cell [K J⁻¹].
        outside: temperatures behind both ends [°C].
        metabolic: heat of metabolism and of given fluxes into each cell [W].
        shapes: of the sources in each cell.
        amplitudes: at which the levels of the sources are tabulated [A m⁻¹].
        levels: of the sources at these.
        warmth: temperatures at which the sink is tabulated [°C].
        sink: heat that blood takes from each cell at these [W].
        start: temperature of each cell at the begin [°C].
    """

    inverse_capacity: Float[np.ndarray, " cell"]
    conductances: Float[np.ndarray, " face"]
    outside: Float[np.ndarray, "2"]
    volumes: Float[np.ndarray, " cell"]
    metabolic: Float[np.ndarray, "..."]
    shapes: Float[np.ndarray, "source cell"]
    amplitudes: Float[np.ndarray, " amplitude"]
    levels: Float[np.ndarray, "amplitude source"]
    warmth: Float[np.ndarray, " warmth"]
    sink: Float[np.ndarray, "warmth cell"]
    start: Float[np.ndarray, " cell"]


class Cut(NamedTuple):
    """A plane of cells, or all of a field that is a plane itself.

    Attributes:
        axis: number of the axis that is normal to it.
        place: index of the cells along it; none where the field has no third axis.
    """

    axis: int
    place: int | None

    def of(self, field: Any) -> Any:
        """The cells of a field, of NumPy or JAX, that lie in the plane."""
        if self.place is None:
            return field
        return field[(*(slice(None),) * self.axis, self.place)]


class Plane(eqx.Module):
    """A plane of cells of which the temperature is kept over time.

    Attributes:
        temperatures: of the cells at the moments of the run [°C].
    """

    cut: Cut
    temperatures: Float32[np.ndarray, "moment row column"]


class HeatedRun(AbstractHeatResult):
    """A run of a case: what it reached, and the curves and fields behind that.

    Attributes:
        T10: temperature that 10 % of the target exceed at the end of heating [°C].
        V43: fraction of the target above 43 °C at the end of heating.
        D90: dose that 90 % of the target exceed [CEM43 min].
        heated: end of heating, after which the field is off [s].
        CEM43T90: dose of a place that is always at T90 [min].
        time_to_therapy: time at which D90 reaches 10 min [s]; none where it does not.
        healthy_dose: largest dose outside the target [CEM43 min].
        Hf: largest product of amplitude and frequency [A m⁻¹ s⁻¹].
        imbalance: relative error of the energy balance.
        warnings: laws that were used outside their range, one sentence each.
        temperatures: by `FOLLOWED`, at these times [°C].
        above: fraction of the target above 43 °C at these times.
        doses: `D90`, and the largest `outside` the target, at these times [CEM43 min].
        probes: their temperatures at the saved times [°C].
        profiles: temperature along the radius at the saved times [°C].
        spacing: edges of a cell of a box [m].
        moments: times at which planes are kept [s].
        dead: dead fraction of each cell by Arrhenius' law, if the case has one.
        dead_outside: largest such fraction outside it.
    """

    title: str
    T_max: float
    T10: float
    T50: float
    T90: float
    V43: float
    D90: float
    heated: float
    CEM43T90: float
    time_to_therapy: float | None
    healthy_dose: float
    Hf: float
    imbalance: float
    warnings: tuple[str, ...]
    protocol: Piecewise
    times: Float[np.ndarray, " time"]
    temperatures: dict[str, Float[np.ndarray, " time"]]
    above: Float[np.ndarray, " time"]
    doses: dict[str, Float[np.ndarray, " time"]]
    target: Float[np.ndarray, "*grid"]
    temperature: Float[np.ndarray, "*grid"]
    dose: Float[np.ndarray, "*grid"]
    points: Float[np.ndarray, "probe axis"]
    probes: Float[np.ndarray, "time probe"] | None = None
    radius: Float[np.ndarray, " cell"] | None = None
    profiles: Float[np.ndarray, "time cell"] | None = None
    balance: RadialBalance | None = None
    spacing: tuple[float, ...] = ()
    moments: Float[np.ndarray, " moment"] | None = None
    planes: tuple[Plane, ...] = ()
    dead: Float[np.ndarray, "*grid"] | None = None
    dead_target: float | None = None
    dead_outside: float | None = None


FOLLOWED = ("hottest", *SHARES)
"""Temperatures of the target that are followed: its hottest cell, and T10 to T90."""


def simulate(
    setup: Setup, model: Bioheat | None = None, protocol: Piecewise | None = None
) -> HeatedRun:
    """Run a case, or another tissue or protocol in its place."""
    model, protocol = model or setup.model, protocol or setup.protocol
    solution = _follow(setup, model, protocol)
    seen, doses = jax.tree.map(np.asarray, (solution.observed, solution.observed_dose))
    times, heated = np.asarray(solution.times), end_of_heating(protocol)
    index = int(np.abs(times - heated).argmin())
    highest = float(solution.hottest.max())
    if setup.body.target.ndim > 1:
        fields = _on_planes(setup, times, seen)
    else:
        radius, profiles = np.asarray(model.grid.distances()), seen["field"]
        balance = radial_balance(setup, model, protocol)
        fields = {"radius": radius, "profiles": profiles, "balance": balance}
    return HeatedRun(
        title=setup.title,
        T_max=highest,
        T10=float(seen["T10"][index]),
        T50=float(seen["T50"][index]),
        T90=float(seen["T90"][index]),
        V43=float(seen["V43"][index]),
        D90=float(doses["D90"][-1]),
        heated=heated,
        CEM43T90=dose_at(seen["T90"], times),
        time_to_therapy=time_to_reach(times, doses["D90"], THERAPEUTIC),
        healthy_dose=float(doses["outside"][-1]),
        Hf=float(protocol.largest * float(protocol.frequency)),
        imbalance=float(solution.energy.imbalance),
        warnings=tuple(validity_warnings(model, protocol, highest)),
        protocol=protocol,
        times=times,
        temperatures={name: seen[name] for name in FOLLOWED},
        above=seen["V43"],
        doses=doses,
        target=np.asarray(setup.body.target),
        temperature=np.asarray(solution.final.temperature),
        dose=np.asarray(solution.final.dose),
        points=setup.points,
        probes=seen.get("probes"),
        **fields,
        **_dead_shares(setup, solution.final.damage),
    )


def _follow(setup: Setup, model: Bioheat, protocol: Piecewise) -> Solution:
    probes = probes_at(model, setup.points) if len(setup.points) else None
    watched = Watched.of(setup, probes)
    return solve(
        model,
        protocol,
        stepper=setup.stepper,
        observe=watched.temperatures,
        observe_dose=watched.doses,
        save_at=saved_times(protocol),
        start=setup.start,
        damage=setup.damage,
    )


def _on_planes(
    setup: Setup, times: np.ndarray, seen: dict[str, np.ndarray]
) -> dict[str, PyTree]:
    count = len(times)
    kept = np.unique(np.linspace(0, count - 1, min(MOMENTS, count)).round().astype(int))
    planes = tuple(
        Plane(cut, seen[f"plane {cut.axis}"][kept].astype("f4"))
        for cut in cuts_through(np.asarray(setup.body.target))
    )
    return {
        "spacing": setup.model.grid.cell_sizes,
        "moments": times[kept],
        "planes": planes,
    }


def _dead_shares(setup: Setup, damage: Array | None) -> dict[str, PyTree]:
    if damage is None:
        return {}
    dead, target = 1 - np.exp(-np.asarray(damage)), np.asarray(setup.body.target)
    weights = target * np.asarray(setup.model.grid.volumes)
    return {
        "dead": dead,
        "dead_target": float((dead * weights).sum() / weights.sum()),
        "dead_outside": float(dead[target < 1e-9].max()),
    }


def validity_warnings(
    model: Bioheat, protocol: Piecewise, hottest: Scalar | None = None
) -> list[str]:
    """What of a run lies outside the range of its laws, one sentence each."""
    warnings = []
    for source in model.sources:
        if isinstance(source, ParticleSource):
            strain = float(source.heating.validity(protocol.largest))
            if strain > 1:
                warnings.append(
                    f"{type(source.heating).__name__} is strained {strain:.3g} times "
                    "beyond its range of validity (1) at the largest amplitude; the "
                    "power is doubtful"
                )
    if hottest is not None and float(hottest) > HOTTEST_VALID:
        warnings.append(
            f"{float(hottest):.1f} °C is reached; perfusion and heating laws hold up "
            f"to about {HOTTEST_VALID:g} °C"
        )
    return warnings


def saved_times(protocol: Piecewise) -> Float[np.ndarray, " time"]:
    """Regular times, and all switches: where bursts have their peaks."""
    regular = np.linspace(0.0, protocol.duration, REGULAR_TIMES + 1)[1:]
    edges = np.asarray(protocol.edges[1:])
    gaps = np.abs(regular[:, None] - edges[None]).min(axis=1)
    apart = gaps > 1e-6 * protocol.duration
    return np.sort(np.concatenate([regular[apart], edges]))


def end_of_heating(protocol: Piecewise) -> float:
    """Time [s] after which the field is off; the end where it never is on."""
    peaks = np.maximum(np.asarray(protocol.starts), np.asarray(protocol.ends))
    heated = np.flatnonzero(peaks > OFF * peaks.max())
    last = heated[-1] if heated.size else len(peaks) - 1
    return protocol.edges[last + 1]


def dose_at(
    temperatures: Float[np.ndarray, " time"], times: Float[np.ndarray, " time"]
) -> float:
    """Dose [CEM43 min] of a place with temperatures [°C] at times [s]."""
    values = jnp.asarray(temperatures)
    each = jax.vmap(cem43_segment)(values[:-1], values[1:], jnp.diff(times))
    return float(each.sum())


def cuts_through(target: Float[np.ndarray, "..."]) -> tuple[Cut, ...]:
    """The plane itself, or the three planes through the middle of a target in a box.

    A radius has none.
    """
    if target.ndim == 1:
        return ()
    if target.ndim == 2:
        return (Cut(2, None),)
    places = np.indices(target.shape).reshape(3, -1) @ target.reshape(-1)
    middle = np.round(places / target.sum()).astype(int).tolist()
    return tuple(Cut(axis, middle[axis]) for axis in (2, 1, 0))


class Watched(eqx.Module):
    """What of temperature and dose is followed in the target and outside it.

    Attributes:
        outside: marks the cells without any of the target, flattened.
        whole: True if all of the temperature is kept.
    """

    cells: np.ndarray
    volumes: Float[Array, " cell"]
    outside: Bool[np.ndarray, " all"]
    probes: Observe | None
    whole: bool = eqx.field(static=True)
    cuts: tuple[Cut, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, setup: Setup, probes: Observe | None) -> "Watched":
        volumes = np.asarray(setup.body.target * setup.model.grid.volumes).reshape(-1)
        cells = np.flatnonzero(volumes > 0)
        return cls(
            cells=cells,
            volumes=jnp.asarray(volumes[cells]),
            outside=np.asarray(setup.body.target).reshape(-1) < 1e-9,
            probes=probes,
            whole=setup.body.target.ndim == 1,
            cuts=cuts_through(np.asarray(setup.body.target)),
        )

    def temperatures(self, temperature: Float[Array, "..."]) -> dict[str, Array]:
        """Temperatures of one time [°C], and the share of the target above 43 °C."""
        target = temperature.reshape(-1)[self.cells]
        observed = {"hottest": jnp.max(temperature)}
        for name, fraction in SHARES.items():
            observed[name] = value_exceeded_by(target, self.volumes, fraction)
        observed["V43"] = volume_above(target, self.volumes, 43.0)
        if self.probes is not None:
            observed["probes"] = self.probes(temperature)
        if self.whole:
            observed["field"] = temperature
        return observed | {f"plane {c.axis}": c.of(temperature) for c in self.cuts}

    def doses(self, dose: Float[Array, "..."]) -> dict[str, Array]:
        flat = dose.reshape(-1)
        beyond = jnp.where(self.outside, flat, 0.0)
        return {
            "D90": value_exceeded_by(flat[self.cells], self.volumes, 0.9),
            "outside": jnp.max(beyond),
        }


WARMTH = np.linspace(15.0, 75.0, 241)
"""Temperatures [°C] at which the heat that blood takes is tabulated."""

AMPLITUDES = 65
"""Number of amplitudes at which the levels of the sources are tabulated, zero too."""

REACH = 1.5
"""The greatest amplitude of the table, in units of the protocol's."""


def radial_balance(setup: Setup, model: Bioheat, protocol: Piecewise) -> RadialBalance:
    """The heat balance of a run along a radius."""
    balance = HeatBalance.of(model)
    cells = balance.volumes.shape[0]
    most = max(REACH * float(protocol.largest), 1.0)
    amplitudes = np.linspace(0.0, most, AMPLITUDES)

    def levels(amplitude: Float[Array, ""]) -> Float[Array, " source"]:
        return model.levels(amplitude, protocol.frequency)

    def sink(celsius: Float[Array, ""]) -> Float[Array, " cell"]:
        return balance.sink(jnp.full(cells, celsius)) * balance.volumes

    numbers = {
        "inverse_capacity": balance.inverse_capacity,
        "conductances": balance.conductances[0],
        "outside": np.asarray(balance.outside[0], float),
        "volumes": balance.volumes,
        "metabolic": balance.inflow,
        "shapes": jnp.stack(balance.shapes),
        "amplitudes": amplitudes,
        "levels": jax.vmap(levels)(jnp.asarray(amplitudes)),
        "warmth": WARMTH,
        "sink": jax.vmap(sink)(jnp.asarray(WARMTH)),
        "start": setup.start.state(model).temperature,
    }
    return RadialBalance(**{name: np.asarray(value) for name, value in numbers.items()})
