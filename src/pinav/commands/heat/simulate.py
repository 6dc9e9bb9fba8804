"""`pinav heat simulate`: temperature and dose of a case."""

from pathlib import Path

import numpy as np

from pinav.commands.heat.balance import balance_arrays
from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case
from pinav.commands.heat.history import (
    Watched,
    dose_of_t90,
    end_of_heating,
    saved_times,
    time_to_therapy,
)
from pinav.commands.heat.metrics import RunMetrics
from pinav.commands.heat.sections import PREFIX, section_arrays
from pinav.commands.heat.task import AbstractTask, TaskResult
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.exposure_limits import require, validity_warnings
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.probes import ProbeData
from pinav.thermal.protocols import Piecewise
from pinav.thermal.solve import Solution, probes_at, solve


class SimulateTask(AbstractTask):
    """Run a case as it is."""

    def __init__(self, case: Case, source: Path) -> None:
        self.case, self.setup = case, build_case(case, source.parent)
        require(self.setup.protocol, *self.setup.limits)

    def run(self) -> TaskResult:
        setup = self.setup
        metrics, arrays = simulate_run(setup, setup.model, setup.protocol)
        return TaskResult(metrics, arrays, self._readings(), setup.body.image)

    def _readings(self) -> ProbeData | None:
        """Temperatures of the probes at their own times, without noise."""
        if self.case.probes is None or not len(self.setup.points):
            return None
        setup = self.setup
        solution = solve(
            setup.model,
            setup.protocol,
            stepper=setup.stepper,
            observe=probes_at(setup.model, setup.points),
            save_every=self.case.probes.every,
            start=setup.start,
        )
        times = np.asarray(solution.times)
        return ProbeData(times, setup.points, np.asarray(solution.observed))


def simulate_run(
    setup: CaseModel, model: Bioheat, protocol: Piecewise
) -> tuple[RunMetrics, dict[str, np.ndarray]]:
    """The metrics of a run, and the arrays of its figures."""
    probes = probes_at(model, setup.points) if len(setup.points) else None
    watched = Watched.of(setup, probes)
    solution = solve(
        model,
        protocol,
        stepper=setup.stepper,
        observe=watched.temperatures,
        observe_dose=watched.doses,
        save_at=saved_times(protocol),
        start=setup.start,
        damage=setup.damage,
    )
    arrays = {
        "times": np.asarray(solution.times),
        "temperature": np.asarray(solution.final.temperature),
        "dose": np.asarray(solution.final.dose),
        "target": np.asarray(setup.target),
        "edges": np.array(protocol.edges),
        "starts": np.asarray(protocol.starts),
        "ends": np.asarray(protocol.ends),
        "points": setup.points,
        **{
            name: np.asarray(values)
            for name, values in solution.observed.items()
            if not name.startswith(PREFIX)
        },
    }
    arrays |= section_arrays(arrays["target"], arrays["times"], solution.observed)
    if (damage := solution.final.damage) is not None:
        arrays["dead"] = 1 - np.exp(-np.asarray(damage))
    for name, values in solution.observed_dose.items():
        arrays[f"dose/{name}"] = np.asarray(values)
    if setup.target.ndim == 1:
        arrays["radius"] = np.asarray(model.grid.distances())
        arrays |= balance_arrays(setup, model, protocol)
    else:
        arrays["spacing"] = spacing(model.grid)
    return run_metrics(setup, model, protocol, solution), arrays


def _dead_shares(
    setup: CaseModel, solution: Solution
) -> tuple[float | None, float | None]:
    """Dead fraction of the target, and the largest outside it, by Arrhenius' law."""
    if solution.final.damage is None:
        return None, None
    dead = 1 - np.exp(-np.asarray(solution.final.damage))
    weights = np.asarray(setup.target * setup.model.grid.volumes)
    outside = dead[np.asarray(setup.target) < 1e-9]
    return float((dead * weights).sum() / weights.sum()), float(outside.max())


def spacing(grid: AbstractGrid) -> np.ndarray:
    """Edges of the cells of a box [m]."""
    halves = [grid.half_widths(axis) for axis in range(len(grid.shape))]
    return np.array([2 * float(h.reshape(-1)[0]) for h in halves])


def run_metrics(
    setup: CaseModel, model: Bioheat, protocol: Piecewise, solution: Solution
) -> RunMetrics:
    """Temperatures at the end of heating, and doses, of target and healthy tissue."""
    dead_target, dead_outside = _dead_shares(setup, solution)
    heated = end_of_heating(protocol)
    index = int(np.abs(np.asarray(solution.times) - heated).argmin())
    at_end = {
        n: float(solution.observed[n][index]) for n in ("T10", "T50", "T90", "V43")
    }
    highest = float(solution.hottest.max())
    return RunMetrics(
        highest=highest,
        t10=at_end["T10"],
        t50=at_end["T50"],
        t90=at_end["T90"],
        v43=at_end["V43"],
        heated=heated,
        d90=float(solution.observed_dose["D90"][-1]),
        t90_dose=dose_of_t90(solution),
        time_to_therapy=time_to_therapy(solution),
        healthy_dose=float(solution.observed_dose["outside"][-1]),
        hf=float(protocol.largest * float(protocol.frequency)),
        dead_target=dead_target,
        dead_outside=dead_outside,
        imbalance=float(solution.energy.imbalance),
        warnings=tuple(validity_warnings(model, protocol, highest)),
    )
