"""A case as values that can be run: tissue, field, stepper, limits and start."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.thermal import starts
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.bodies import Body, build_body, read_heating
from pinav.thermal.case import Case, FromFile, read_case
from pinav.thermal.case_geometry import Probes
from pinav.thermal.case_matter import Absorption, Power, heating_file
from pinav.thermal.dose import Arrhenius
from pinav.thermal.grids import AbstractGrid
from pinav.thermal.protocols import LIMITS, HfLimit, Piecewise
from pinav.thermal.quantities import Field
from pinav.thermal.readings import Readings
from pinav.thermal.solve import default_stepper, probes_at, solve
from pinav.thermal.sources import (
    AbstractSource,
    ParticleSource,
    PowerSource,
    ShiftedSource,
)
from pinav.thermal.steppers import RKL2, AbstractStepper, Rosenbrock


class Setup(eqx.Module):
    """A case as values that can be run.

    Attributes:
        points: places of the probes [m], none if there are none.
        every: interval between readings of the probes [s].
    """

    title: str = eqx.field(static=True)
    model: Bioheat
    protocol: Piecewise
    body: Body
    stepper: AbstractStepper
    limits: tuple[HfLimit, ...]
    points: np.ndarray
    every: float
    start: starts.AbstractStart
    damage: Arrhenius | None = None

    @classmethod
    def read(cls, path: Path) -> "Setup":
        """The setup of a case in a TOML file.

        Raises:
            InputError: the file, or one that it names, cannot be read or holds what no
                case has.
        """
        return cls.of(read_case(path)[0], path.parent)

    @classmethod
    def of(cls, case: Case, folder: Path) -> "Setup":
        """The setup of a case."""
        model, body = build_body(case, folder)
        grid = model.grid
        start: starts.AbstractStart = starts.AT_REST
        if isinstance(case.start, FromFile):
            start = starts.read_state(folder / case.start.file, grid.shape)
        elif case.start == "steady":
            start = starts.AtSteadyState()
        sources = [_source(case, model, body, folder)]
        if case.eddy is not None:
            case.eddy.shape(grid)  # refuses a grid that has no axis
            sources.append(case.eddy)
        model = eqx.tree_at(lambda m: m.sources, model, tuple(sources))
        if isinstance(start, starts.AtSteadyState):
            starts.find_steady_state(model)  # refuses a case that has none
        stepper = _stepper(case, model)
        stepper.longest_step(model)  # refuses a step that is not stable
        probes = case.probes or Probes(())
        return cls(
            title=case.title,
            model=model,
            protocol=case.field.build(),
            body=body,
            stepper=stepper,
            limits=() if case.limit is None else (LIMITS[case.limit],),
            points=np.array(probes.points, float).reshape(-1, len(grid.shape)),
            every=probes.every,
            start=start,
            damage=case.damage,
        )

    def readings(self, noise: float = 0.0, seed: int = 0) -> Readings:
        """Readings of the probes, as if the case were the truth."""
        solution = solve(
            self.model,
            self.protocol,
            observe=probes_at(self.model, self.points),
            save_every=self.every,
            stepper=self.stepper,
            start=self.start,
        )
        clean = np.asarray(solution.observed)
        kicks = np.asarray(jax.random.normal(jax.random.key(seed), clean.shape))
        return Readings(np.asarray(solution.times), clean + noise * kicks, self.points)

    @property
    def arterial(self) -> float:
        return float(self.model.blood.arterial)


def _stepper(case: Case, model: Bioheat) -> AbstractStepper:
    if case.step is None:
        return default_stepper(model)
    if len(model.grid.shape) == 1:
        return Rosenbrock(case.step)
    return RKL2.for_step(model, case.step)


def _source(case: Case, model: Bioheat, body: Body, folder: Path) -> AbstractSource:
    heating = case.heating
    if isinstance(heating, Power):
        return PowerSource(_density(heating, model.grid, body), heating.reference)
    file = heating_file(heating)
    values = None if file is None else read_heating(heating, folder / file, body)
    if isinstance(heating, Absorption):
        assert values is not None
        absorption = jnp.asarray(values)
        source = PowerSource(absorption, heating.reference, heating.scale)
        return ShiftedSource(source, jnp.zeros(values.ndim), model.tissue.density)
    concentration = values
    if not isinstance(heating.concentration, str):
        concentration = heating.concentration * body.target  # mg/cm³ are kg/m³
    return ParticleSource(jnp.asarray(concentration), heating.heating(), heating.scale)


def _density(power: Power, grid: AbstractGrid, body: Body) -> Field:
    target = body.target
    if power.width is not None:
        center = body.middle if power.center is None else power.center
        distances = grid.distances(center)
        return power.density * jnp.exp(-0.5 * (distances / power.width) ** 2)
    if not power.edge_weighted:
        return power.density * target
    assert body.radius is not None
    shape = (0.4 + (grid.distances(body.middle) / body.radius) ** 2) * target
    total = power.density * jnp.sum(target * grid.volumes)
    return shape * (total / jnp.sum(shape * grid.volumes))
