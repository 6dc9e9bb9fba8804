"""`pinav heat optimise`: the protocol of largest dose under the limits of a case."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt

from pinav.commands.heat.aims import Optimise
from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case
from pinav.commands.heat.fitting import fit_case, require_heating
from pinav.commands.heat.learning_case import LearningCase
from pinav.commands.heat.metrics import (
    ConstraintMetrics,
    JudgedMetrics,
    OptimumMetrics,
)
from pinav.commands.heat.simulate import simulate_run
from pinav.commands.heat.task import AbstractTask, TaskResult
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
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
from pinav.thermal.optimise import Optimum, optimise
from pinav.thermal.quantities import Field
from pinav.thermal.solve import solve


class OptimiseTask(AbstractTask):
    """Find the protocol of largest D90; where it is free after a time, the rest of it.

    Readings until that time say first what the tissue is like. The plan is made with
    the learned tissue and judged with the true one, where the case names it.
    """

    def __init__(self, case: Case, source: Path) -> None:
        if case.optimise is None:
            raise InputError(
                "optimise: expected a table [optimise] in the case, got none"
            )
        self.settings, self.setup = case.optimise, build_case(case, source.parent)
        self.learning = None
        if case.optimise.after is not None and case.learn is not None:
            self.learning = LearningCase.of(
                case, self.setup, source.parent, case.optimise.after
            )
            if self.learning.fitted is None:
                raise InputError(
                    "learn: expected data or thermometry, from which a plan after "
                    f"{case.optimise.after:g} s is made, got neither; name a file, or "
                    "remove the table"
                )
        _check_plan(case.optimise, self.setup)
        self.variables = _variables(case, case.optimise, self.setup)
        self.constraints = _constraints(case, case.optimise, self.setup)

    def run(self) -> TaskResult:
        model, learning, judged = self.setup.model, self.learning, None
        if learning is not None and learning.fitted is not None:
            model = fit_case(self.setup, learning.settings, learning.fitted).model
            model = _with_arrays(model)
        optimum = self._plan(model)
        protocol = optimum.run.protocol
        metrics, arrays = simulate_run(self.setup, optimum.run.model, protocol)
        if learning is not None and learning.truth is not None:
            judged = self._judge(_with_arrays(learning.truth.model), optimum)
        return TaskResult(
            OptimumMetrics(
                result=metrics,
                outcome=str(optimum.outcome),
                evaluations=optimum.evaluations,
                start_d90=float(np.exp(optimum.start_value)),
                constraints=tuple(map(ConstraintMetrics.of, optimum.constraints)),
                amplitudes=tuple(np.asarray(protocol.starts).tolist()),
                max_temperature=self.settings.max_temperature,
                judged=judged,
            ),
            arrays,
            image=self.setup.body.image,
        )

    def _plan(self, model: Bioheat, initial: np.ndarray | None = None) -> Optimum:
        """The best field of a tissue, from where it is free."""
        setup, begin = self.setup, self.setup.start
        if self.settings.after is not None:
            before = setup.protocol.until(self.settings.after)
            begin = solve(model, before, stepper=setup.stepper, start=begin).final
        return optimise(
            Run(model, setup.protocol),
            self.variables,
            maximise=LogD90(setup.target),
            subject_to=self.constraints,
            stepper=setup.stepper,
            begin=begin,
            initial=initial,
        )

    def _judge(self, truth: Bioheat, plan: Optimum) -> JudgedMetrics:
        """What a plan does to the true tissue, and one made with the truth."""
        reached, _ = simulate_run(self.setup, truth, plan.run.protocol)
        best = self._plan(truth, plan.numbers).run.protocol
        possible, _ = simulate_run(self.setup, truth, best)
        return JudgedMetrics(
            d90=reached.d90,
            best_d90=possible.d90,
            highest=reached.highest,
            amplitudes=tuple(np.asarray(best.starts).tolist()),
        )


def _with_arrays(model: Bioheat) -> Bioheat:
    """The model with arrays for numbers, so that a learned and a true one compile once.

    A number of Python is part of the program, an array is data of it.
    """

    def as_array(leaf: Any) -> Any:
        return jnp.asarray(np.asarray(leaf)) if isinstance(leaf, float) else leaf

    return jax.tree.map(as_array, model)


def _check_plan(settings: Optimise, setup: CaseModel) -> None:
    """Refuse a bound that is passed at the start, and a field that heats nothing."""
    hottest = float(jnp.max(setup.start.state(setup.model).temperature))
    if hottest >= settings.max_temperature:
        raise InputError(
            f"optimise.max_temperature: expected above the temperature at the start, "
            f"> {hottest:.4g} °C, got {settings.max_temperature:g} °C; raise it, or "
            "cool the start"
        )
    require_heating(setup)


def _variables(
    case: Case, settings: Optimise, setup: CaseModel
) -> list[AbstractDesignVariable]:
    edges = setup.protocol.edges
    kept = 0 if settings.after is None else edges.index(settings.after)
    free = len(edges) - 1 - kept
    variables: list[AbstractDesignVariable] = [
        FreeAmplitudes(settings.largest, free, settings.start, kept)
        if case.field.on is None and not case.field.ramp
        # pauses stay pauses, and ramps ramps
        else FreeScale(settings.largest / setup.protocol.largest, settings.start)
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
        if not bool(jnp.any(away > 0.5)):
            raise InputError(
                f"optimise.margin: expected tissue further than it from the tumour, "
                f"got none at {settings.margin:g} m; give metres, or a smaller one"
            )
        name = f"dose of tissue {1e3 * settings.margin:g} mm or more from the tumour"
        constraints.append(
            HealthyDose(bound=settings.healthy_dose, fraction=away, name=name)
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
