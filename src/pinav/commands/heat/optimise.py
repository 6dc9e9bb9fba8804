"""`pinav heat optimise`: the protocol of largest dose under the limits of a case."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt

from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case, Optimise
from pinav.commands.heat.metrics import ConstraintMetrics, OptimumMetrics
from pinav.commands.heat.simulate import simulate_run
from pinav.commands.heat.task import AbstractTask, TaskResult
from pinav.errors import InputError
from pinav.thermal.constraints import (
    AbstractConstraint,
    HealthyDose,
    LogD90,
    MaxTemperature,
    limit_constraint,
)
from pinav.thermal.design_variables import (
    AbstractDesignVariable,
    FreeAmplitudes,
    FreePlacement,
    FreeScale,
    Run,
    shells,
)
from pinav.thermal.grids import CartesianGrid
from pinav.thermal.optimise import optimise
from pinav.thermal.quantities import Field


class OptimiseTask(AbstractTask):
    """Find the protocol of largest D90."""

    def __init__(self, case: Case, source: Path) -> None:
        if case.optimise is None:
            raise InputError(
                "optimise: expected a table [optimise] in the case, got none"
            )
        self.settings, self.setup = case.optimise, build_case(case, source.parent)
        self.variables = _variables(case, case.optimise, self.setup)
        self.constraints = _constraints(case, case.optimise, self.setup)

    def run(self) -> TaskResult:
        setup = self.setup
        optimum = optimise(
            Run(setup.model, setup.protocol),
            self.variables,
            maximise=LogD90(setup.target),
            subject_to=self.constraints,
            stepper=setup.stepper,
            begin=setup.start,
        )
        protocol = optimum.run.protocol
        metrics, arrays = simulate_run(setup, optimum.run.model, protocol)
        return TaskResult(
            OptimumMetrics(
                result=metrics,
                outcome=str(optimum.outcome),
                evaluations=optimum.evaluations,
                start_d90=float(np.exp(optimum.start_value)),
                constraints=tuple(map(ConstraintMetrics.of, optimum.constraints)),
                amplitudes=tuple(np.asarray(protocol.starts).tolist()),
                max_temperature=self.settings.max_temperature,
            ),
            arrays,
            image=setup.body.image,
        )


def _variables(
    case: Case, settings: Optimise, setup: CaseModel
) -> list[AbstractDesignVariable]:
    intervals = len(setup.protocol.edges) - 1
    variables: list[AbstractDesignVariable] = [
        FreeAmplitudes(settings.largest, intervals, settings.start)
        if case.field.on is None
        # pauses stay pauses
        else FreeScale(settings.largest / case.field.amplitudes[0], settings.start)
    ]
    if settings.placement is not None:
        grid, source = setup.model.grid, setup.model.sources[0]
        total = float(jnp.sum(source.shape(grid) * grid.volumes))
        radius = case.ball[1].radius
        patterns = shells(setup.model, radius, settings.placement, total)
        variables.append(FreePlacement(patterns))
    return variables


def _constraints(
    case: Case, settings: Optimise, setup: CaseModel
) -> list[AbstractConstraint]:
    constraints: list[AbstractConstraint] = [
        MaxTemperature(bound=settings.max_temperature)
    ]
    if settings.healthy_dose is not None:
        # the margin leaves out tissue that conduction from the tumour heats anyway
        away = tissue_beyond(case, setup, settings.margin)
        name = f"dose of tissue {1e3 * settings.margin:g} mm or more from the tumour"
        constraints.append(
            HealthyDose(bound=settings.healthy_dose, share=away, name=name)
        )
    return constraints + [limit_constraint(limit) for limit in setup.limits]


def tissue_beyond(case: Case, setup: CaseModel, margin: float) -> Field:
    """Share of each cell that is further than a margin [m] from the target."""
    if case.tumour is not None:
        radius = case.tumour.radius + margin
        return 1 - setup.model.grid.ball(radius, center=case.tumour.center)
    grid = setup.model.grid
    assert isinstance(grid, CartesianGrid)
    outside = np.asarray(setup.target) <= 0.5
    sizes = [float(size) for size in grid.spacing]
    # from centre to centre: half a voxel is inside the target
    distance = np.asarray(distance_transform_edt(outside, sizes)) - 0.5 * min(sizes)
    return jnp.asarray(distance >= margin, float)
