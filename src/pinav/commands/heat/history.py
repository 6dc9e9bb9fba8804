"""What a run reached over time: temperatures and doses of target and tissue."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.commands.heat.build import CaseModel
from pinav.commands.heat.sections import Section, sections_of
from pinav.thermal.dose import (
    cem43_segment,
    time_to_reach,
    value_exceeded_by,
    volume_above,
)
from pinav.thermal.protocols import Piecewise
from pinav.thermal.solve import Observe, Solution

REGULAR_TIMES = 180
"""Times at which curves are saved, beside every switch of the field."""

THERAPEUTIC = 10.0
"""CEM43 [min] of T90 that trials of hyperthermia aim at."""

OFF = 1e-5
"""Share of the largest amplitude below which the field is off: a plan leaves less."""

SHARES = {"T10": 0.1, "T50": 0.5, "T90": 0.9}


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


class Watched(eqx.Module):
    """What of temperature and dose is followed in the target and outside it.

    Attributes:
        cells: indices of the target's cells in the flattened grid.
        volumes: of the target in them [m³].
        outside: cells without any of the target, flattened.
        probes: temperatures at the probes, if there are any.
        whole: whether all of the temperature is kept.
        sections: of a plane or a box, whose temperatures are kept.
    """

    cells: np.ndarray
    volumes: Float[Array, " cell"]
    outside: Bool[np.ndarray, " all"]
    probes: Observe | None
    whole: bool = eqx.field(static=True)
    sections: tuple[Section, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, setup: CaseModel, probes: Observe | None) -> "Watched":
        volumes = np.asarray(setup.target * setup.model.grid.volumes).reshape(-1)
        cells = np.flatnonzero(volumes > 0)
        return cls(
            cells=cells,
            volumes=jnp.asarray(volumes[cells]),
            outside=np.asarray(setup.target).reshape(-1) < 1e-9,
            probes=probes,
            whole=setup.target.ndim == 1,
            sections=sections_of(np.asarray(setup.target)),
        )

    def temperatures(self, temperature: Float[Array, "..."]) -> dict[str, Array]:
        """Of one time [°C], and the share of the target above 43 °C."""
        target = temperature.reshape(-1)[self.cells]
        observed = {"hottest": jnp.max(temperature)}
        for name, fraction in SHARES.items():
            observed[name] = value_exceeded_by(target, self.volumes, fraction)
        observed["V43"] = volume_above(target, self.volumes, 43.0)
        if self.probes is not None:
            observed["probes"] = self.probes(temperature)
        if self.whole:
            observed["field"] = temperature
        return observed | {s.name: s.of(temperature) for s in self.sections}

    def doses(self, dose: Float[Array, "..."]) -> dict[str, Array]:
        """Of one time [CEM43 min]."""
        flat = dose.reshape(-1)
        beyond = jnp.where(self.outside, flat, 0.0)
        return {
            "D90": value_exceeded_by(flat[self.cells], self.volumes, 0.9),
            "outside": jnp.max(beyond),
        }


def dose_of_t90(solution: Solution) -> float:
    """CEM43 T90 [min]: the dose of a place that always is at T90."""
    t90 = jnp.asarray(solution.observed["T90"])
    steps = jnp.diff(solution.times)
    each = jax.vmap(cem43_segment)(t90[:-1], t90[1:], steps)
    return float(each.sum())


def time_to_therapy(solution: Solution) -> float | None:
    """Time [s] at which D90 reaches `THERAPEUTIC`; none where it does not."""
    doses = np.asarray(solution.observed_dose["D90"])
    return time_to_reach(np.asarray(solution.times), doses, THERAPEUTIC)
