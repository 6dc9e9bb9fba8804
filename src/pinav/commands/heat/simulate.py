"""`pinav heat simulate`: temperature and dose of a case."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case
from pinav.commands.heat.metrics import RunMetrics
from pinav.commands.heat.task import AbstractTask, TaskResult
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.dose import exceeded_by, volume_above
from pinav.thermal.exposure_limits import require, validity_warnings
from pinav.thermal.probes import ProbeData
from pinav.thermal.protocols import Piecewise
from pinav.thermal.solve import Probes, Solution, solve

SAVED_TIMES = 180
"""Times at which the curves of a figure are saved."""


class SimulateTask(AbstractTask):
    """Run a case as it is."""

    def __init__(self, case: Case, source: Path) -> None:
        self.case, self.setup = case, build_case(case, source.parent)
        require(self.setup.protocol, *self.setup.limits)

    def run(self) -> TaskResult:
        setup = self.setup
        metrics, arrays = simulate_run(setup, setup.model, setup.protocol)
        return TaskResult(metrics, arrays, self._readings())

    def _readings(self) -> ProbeData | None:
        """Temperatures of the probes at their own times, without noise."""
        if self.case.probes is None or not len(self.setup.points):
            return None
        setup = self.setup
        solution = solve(
            setup.model,
            setup.protocol,
            stepper=setup.stepper,
            observe=Probes(setup.model.grid.interpolation(setup.points)),
            save_every=self.case.probes.every,
            start=setup.start,
        )
        times = np.asarray(solution.times)
        return ProbeData(times, setup.points, np.asarray(solution.observed))


def simulate_run(
    setup: CaseModel, model: Bioheat, protocol: Piecewise
) -> tuple[RunMetrics, dict[str, np.ndarray]]:
    """The metrics of a run, and the arrays of its figures."""
    has_probes = len(setup.points) > 0
    probes = Probes(model.grid.interpolation(setup.points)) if has_probes else None
    radial = len(model.grid.shape) == 1

    def observe(temperature: Float[Array, "..."]) -> dict[str, Array]:
        observed = {"hottest": jnp.max(temperature)}
        if probes is not None:
            observed["probes"] = probes(temperature)
        if radial:
            observed["field"] = temperature
        return observed

    solution = solve(
        model,
        protocol,
        stepper=setup.stepper,
        observe=observe,
        save_every=protocol.duration / SAVED_TIMES,
        start=setup.start,
    )
    arrays = {
        "times": np.asarray(solution.times),
        "temperature": np.asarray(solution.final.temperature),
        "dose": np.asarray(solution.final.dose),
        "target": np.asarray(setup.target),
        "edges": np.array(protocol.edges),
        "starts": np.asarray(protocol.starts),
        "ends": np.asarray(protocol.ends),
        **{name: np.asarray(values) for name, values in solution.observed.items()},
    }
    if radial:
        arrays["radius"] = np.asarray(model.grid.distances())
    else:
        halves = [model.grid.half_widths(axis) for axis in range(setup.target.ndim)]
        arrays["spacing"] = np.array([2 * float(h.reshape(-1)[0]) for h in halves])
    return run_metrics(model, protocol, setup.target, solution), arrays


def run_metrics(
    model: Bioheat, protocol: Piecewise, target: jax.Array, solution: Solution
) -> RunMetrics:
    """Temperatures and doses of target and healthy tissue."""
    volumes = target * model.grid.volumes
    final, dose = solution.final.temperature, solution.final.dose
    highest = float(solution.hottest.max())
    outside = jnp.where(target < 1e-9, dose, 0.0)
    return RunMetrics(
        highest=highest,
        t10=float(exceeded_by(final, volumes, 0.1)),
        t50=float(exceeded_by(final, volumes, 0.5)),
        t90=float(exceeded_by(final, volumes, 0.9)),
        d90=float(exceeded_by(dose, volumes, 0.9)),
        v43=float(volume_above(final, volumes, 43.0)),
        healthy_dose=float(outside.max()),
        hf=float(protocol.largest * float(protocol.frequency)),
        imbalance=float(solution.energy.imbalance),
        warnings=tuple(validity_warnings(model, protocol, highest)),
    )
