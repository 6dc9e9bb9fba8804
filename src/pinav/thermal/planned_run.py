"""The protocol of largest dose under the limits of a case, and what it reaches."""

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from pinav.errors import InputError
from pinav.fitting import Outcome
from pinav.thermal import design
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.case import Case
from pinav.thermal.case_geometry import Optimise
from pinav.thermal.grids import CartesianGrid
from pinav.thermal.heated_run import AbstractHeatResult, HeatedRun, simulate
from pinav.thermal.optimise import ConstraintValue, Optimum, optimise
from pinav.thermal.quantities import Field
from pinav.thermal.setup import Setup
from pinav.thermal.solve import solve
from pinav.thermal.tissue_fit import TissueFit, require_heating


class Judgement(eqx.Module):
    """A plan made with a learned tissue, run on the true one.

    Attributes:
        best_D90: dose of a plan made with the truth, under the same bounds [CEM43 min].
        amplitudes: amplitudes of the plan made with the truth [A m⁻¹].
    """

    D90: float
    best_D90: float
    T_max: float
    amplitudes: Float[np.ndarray, " interval"]


class PlannedRun(AbstractHeatResult):
    """An optimised protocol.

    Attributes:
        evaluations: number of runs with their gradients.
        amplitudes: amplitude of the field in each interval [A m⁻¹].
        max_temperature: bound of the temperature [°C].
    """

    title: str
    result: HeatedRun
    outcome: Outcome
    evaluations: int
    start_D90: float
    constraints: tuple[ConstraintValue, ...]
    amplitudes: Float[np.ndarray, " interval"]
    max_temperature: float
    judged: Judgement | None = None


@dataclasses.dataclass(frozen=True)
class PlanTask:
    """A search for the protocol of largest D90, or of the rest of one.

    Where the field is free after a time, readings until that time say first what the
    tissue is like. The plan is made with the learned tissue and judged with the true
    one, where the case names it.

    Attributes:
        learning: fit of the tissue to the readings before, if there are any.
    """

    setup: Setup
    settings: Optimise
    learning: TissueFit | None
    variables: list[design.DesignVariable]
    constraints: list[design.Constraint]

    @classmethod
    def of(cls, case: Case, setup: Setup, folder: Path) -> "PlanTask":
        """The search that a case asks for.

        Raises:
            InputError: it asks for none, or for one that cannot succeed.
        """
        settings = case.optimise
        if settings is None:
            raise InputError(
                "optimise: expected a table [optimise] in the case, got none"
            )
        learning = None
        if settings.after is not None and case.learn is not None:
            if case.learn.is_synthetic:
                raise InputError(
                    "learn: expected data or thermometry, from which a plan after "
                    f"{settings.after:g} s is made, got neither; name a file, or "
                    "remove the table"
                )
            learning = TissueFit.of(case, setup, folder, settings.after)
        _check_plan(settings, setup)
        return cls(
            setup=setup,
            settings=settings,
            learning=learning,
            variables=_variables(case, settings, setup),
            constraints=_constraints(settings, setup),
        )

    def run(self) -> PlannedRun:
        """Plan, and judge the plan where the truth is known."""
        setup, learning, judged = self.setup, self.learning, None
        model = setup.model
        if learning is not None and learning.fitted is not None:
            model = _with_arrays(learning.learn(learning.fitted).model)
        optimum = self._plan(model)
        protocol = optimum.run.protocol
        reached = simulate(setup, optimum.run.model, protocol)
        if learning is not None and learning.truth is not None:
            judged = self._judge(_with_arrays(learning.truth.model), optimum)
        return PlannedRun(
            title=setup.title,
            result=reached,
            outcome=optimum.outcome,
            evaluations=optimum.evaluations,
            start_D90=float(np.exp(optimum.start_value)),
            constraints=optimum.constraints,
            amplitudes=np.asarray(protocol.starts),
            max_temperature=self.settings.max_temperature,
            judged=judged,
        )

    def _plan(self, model: Bioheat, initial: np.ndarray | None = None) -> Optimum:
        setup, begin = self.setup, self.setup.start
        if self.settings.after is not None:
            before = setup.protocol.until(self.settings.after)
            begin = solve(model, before, stepper=setup.stepper, start=begin).final
        return optimise(
            design.Run(model, setup.protocol),
            self.variables,
            maximise=design.log_d90(setup.body.target),
            subject_to=self.constraints,
            stepper=setup.stepper,
            begin=begin,
            initial=initial,
        )

    def _judge(self, truth: Bioheat, plan: Optimum) -> Judgement:
        reached = simulate(self.setup, truth, plan.run.protocol)
        best = self._plan(truth, plan.numbers).run.protocol
        possible = simulate(self.setup, truth, best)
        return Judgement(
            D90=reached.D90,
            best_D90=possible.D90,
            T_max=reached.T_max,
            amplitudes=np.asarray(best.starts),
        )


def _with_arrays(model: Bioheat) -> Bioheat:
    """The model with arrays for numbers, so that a learned and a true one compile once.

    A number of Python is part of the program, an array is data of it.
    """

    def as_array(leaf: Any) -> Any:
        return jnp.asarray(np.asarray(leaf)) if isinstance(leaf, float) else leaf

    return jax.tree.map(as_array, model)


def _check_plan(settings: Optimise, setup: Setup) -> None:
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
    case: Case, settings: Optimise, setup: Setup
) -> list[design.DesignVariable]:
    edges = setup.protocol.edges
    kept = 0 if settings.after is None else edges.index(settings.after)
    free = len(edges) - 1 - kept
    variables: list[design.DesignVariable] = [
        design.free_amplitudes(settings.largest, free, settings.start, kept)
        if case.field.on is None and not case.field.ramp
        # pauses stay pauses, and ramps ramps
        else design.free_scale(
            settings.largest / setup.protocol.largest, settings.start
        )
    ]
    if settings.placement is not None:
        grid, source = setup.model.grid, setup.model.sources[0]
        total = float(jnp.sum(source.shape(grid) * grid.volumes))
        assert setup.body.radius is not None
        patterns = design.shells(
            setup.model, setup.body.radius, settings.placement, total
        )
        variables.append(design.free_placement(patterns))
    return variables


def _constraints(settings: Optimise, setup: Setup) -> list[design.Constraint]:
    constraints: list[design.Constraint] = [
        design.max_temperature(settings.max_temperature)
    ]
    if settings.healthy_dose is not None:
        # the margin leaves out tissue that conduction from the tumour heats anyway
        away = tissue_beyond(setup, settings.margin)
        if not bool(jnp.any(away > 0.5)):
            raise InputError(
                f"optimise.margin: expected tissue further than it from the tumour, "
                f"got none at {settings.margin:g} m; give metres, or a smaller one"
            )
        name = f"dose of tissue {1e3 * settings.margin:g} mm or more from the tumour"
        constraints.append(design.healthy_dose(settings.healthy_dose, away, name))
    return constraints + [design.limit_constraint(limit) for limit in setup.limits]


def tissue_beyond(setup: Setup, margin: float) -> Field:
    """Share of each cell that is further than a margin [m] from the target."""
    body, grid = setup.body, setup.model.grid
    if body.radius is not None:
        return 1 - grid.ball(body.radius + margin, center=body.middle)
    assert isinstance(grid, CartesianGrid)
    outside, sizes = np.asarray(setup.body.target) <= 0.5, grid.cell_sizes
    # from centre to centre: half a voxel is inside the target
    distance = np.asarray(distance_transform_edt(outside, sizes)) - 0.5 * min(sizes)
    return jnp.asarray(distance >= margin, float)
