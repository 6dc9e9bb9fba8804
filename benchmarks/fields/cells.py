"""One cell of the benchmark: a field, a way to fit it, and how near it came."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from benchmarks._sweep import write_measurement
from benchmarks.fields.families import FAMILIES, random_system
from benchmarks.fields.stochastic_force_inference import infer_force
from pinav.analysis import Discovery, Verdict, discover_law
from pinav.evaluation import field_map, force_coverage
from pinav.evaluation.force_fields import force_agreement
from pinav.fitting import Posterior, StructuredFit, fit_bayes, fit_structured
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import ModelChoice, summarise_for
from pinav.sweeps import Cell
from pinav.systems import System
from pinav.trajectories import Trajectories, simulate

REGIONS = ("visited", "near", "unvisited")


class Measurement(msgspec.Struct, frozen=True):
    """What a fit achieved.

    Attributes:
        family: of the field.
        key: of the draw.
        column: the way it was fitted.
        outcome: the word for how the fit ended, or why there is none.
        seconds: of the processor for the fit, compilation included.
        error: relative L2 error of the force, by region.
        coverage: of the band of 95 %, by region; none without a band.
        structure: kinds of the terms that were claimed, sorted.
        gain: log evidence of the structure over free kernels [nats].
        laws: names of the laws of a discovery that identified them, sorted.
        verdict: the word for what the discovery says; empty without one.
    """

    family: str
    key: int
    column: str
    outcome: str
    seconds: float
    error: dict[str, float | None] = {}
    coverage: dict[str, float | None] = {}
    structure: tuple[str, ...] = ()
    gain: float | None = None
    laws: tuple[str, ...] = ()
    verdict: str = ""

    @property
    def has_right_laws(self) -> bool:
        """Whether the laws that were identified are those of the family."""
        return self.laws == FAMILIES[self.family].laws

    @property
    def is_named_rightly(self) -> bool:
        """Whether the structure that was claimed is that of the family."""
        return self.structure == FAMILIES[self.family].structure


class Fitted(NamedTuple):
    """A fitted environment.

    Attributes:
        model: the fitted swimmer.
        outcome: how the fit ended.
        posterior: of its parameters, if there is one.
        gain: of a structure over free kernels [nats].
        structure: kinds of the terms that were claimed.
        discovery: of its laws, if they were asked for.
    """

    model: Any
    outcome: str
    posterior: Posterior | None = None
    gain: float = float("nan")
    structure: tuple[str, ...] = ()
    discovery: Discovery | None = None

    @classmethod
    def of(cls, result: StructuredFit) -> "Fitted":
        """What a search came to; of a network, with the structure of its teacher."""
        fit, force = result.fit, result.structure
        terms = () if force is None else force.terms
        kinds = tuple(sorted({term.kind for term in terms}))
        return cls(fit.model, str(fit.outcome), fit.posterior, result.gain, kinds)


def _untrained(system: System, data: Trajectories, name: str = "") -> Any:
    choice = ModelChoice(name or system.model)
    return build(choice, system.swimmer, summarise_for(choice, data))


def _free(system: System, data: Trajectories) -> Fitted:
    fit = fit_bayes(_untrained(system, data), data, throw=False)
    return Fitted(fit.model, str(fit.outcome), fit.posterior)


def _structured(system: System, data: Trajectories) -> Fitted:
    model = _untrained(system, data)
    return Fitted.of(fit_structured(model, data, weigh_rotation=True, throw=False))


def _network(name: str) -> Callable[[System, Trajectories], Fitted]:
    """The network of a name, taught by a search for structure, as `pinav fit` does."""

    def fit(system: System, data: Trajectories) -> Fitted:
        model = _untrained(system, data, name)
        return Fitted.of(fit_structured(model, data, throw=False))

    return fit


def _laws(system: System, data: Trajectories) -> Fitted:
    fitted = _structured(system, data)
    assert fitted.posterior is not None
    return fitted._replace(discovery=discover_law(fitted.posterior, data))


def _law_known(system: System, data: Trajectories) -> Fitted:
    truth = system.true_swimmer
    fit = fit_bayes(truth, data, learn=lambda m: m.environment, throw=False)
    return Fitted(fit.model, str(fit.outcome), fit.posterior)


def _other_tool(system: System, data: Trajectories) -> Fitted:
    return Fitted(infer_force(system.swimmer, data, system.noise), "done")


COLUMNS: dict[str, Callable[[System, Trajectories], Fitted]] = {
    "free": _free,
    "structured": _structured,
    "network": _network("neural-force"),
    "ude": _network("ude"),
    "sfi": _other_tool,
    "law": _law_known,
    "neural-potential": _network("neural-potential"),
    "discover": _laws,
}
"""Ways to fit by name: kernels alone; with a search for structure, as `pinav fit` does;
a network of the position, which may turn as the force of some families does, and one
that sees the time, as the paper's does, both taught by such a search;
StochasticForceInference; the numbers of the true law, for comparison; a network with a
potential, which the force of some families has not; and with a search for structure and
for its laws, as `pinav fit` and `pinav discover` do."""

DEFAULT_COLUMNS = tuple(
    name for name in COLUMNS if name not in ("neural-potential", "discover")
)
"""Those that suit all families, and repeat no other."""


class FieldCell(msgspec.Struct, frozen=True):
    """What decides a fit beside the family and the key.

    Attributes:
        column: the way to fit.
        count: number of trajectories.
    """

    column: str
    count: int


def cell_of(family: str, key: int, column: str, count: int) -> Cell:
    """The cell of a field and a way to fit it."""
    return Cell.of(
        "benchmarks.fields.cells:measure",
        FieldCell(column, count),
        system=family,
        seed=key,
        label=f"{family} {key} {column}",
        shape=column,
    )


def measure(cell: Cell, folder: Path) -> None:
    """Fit and score one cell."""
    one, family, key = cell.read(FieldCell), cell.system, cell.seed
    system = random_system(family, key)
    system = system.with_starts(count=one.count)
    data = simulate(system, key=jax.random.key(key)).only(("x", "y"))
    start = time.process_time()
    try:
        fitted = COLUMNS[one.column](system, data)
    except Exception as error:  # a crash is a result of this benchmark
        reason = f"{type(error).__name__}: {error}"[:200]
        seconds = time.process_time() - start
        result = Measurement(family, key, one.column, reason, seconds)
    else:
        jax.block_until_ready(jax.tree.leaves(fitted.model))
        seconds = time.process_time() - start
        result = _scored(family, key, one.column, system, data, fitted, seconds)
    write_measurement(folder, result)


def _scored(
    family: str,
    key: int,
    column: str,
    system: System,
    data: Trajectories,
    fitted: Fitted,
    seconds: float,
) -> Measurement:
    assert system.environment is not None
    true = field_map(system.environment, data)
    force = fitted.model.environment
    learned = field_map(force, data)
    agreements = force_agreement(learned, true)
    coverage: dict[str, float | None] = {}
    if fitted.posterior is not None:
        points = np.stack(np.meshgrid(true.x, true.y), axis=-1).reshape(-1, 2)
        sd = fitted.posterior.force_sd(jnp.asarray(points)).reshape(true.force.shape)
        masks = true.regions.masks(true.distance)
        coverage = dict(force_coverage(learned, true, sd, masks))
    discovery, laws = fitted.discovery, ()
    if discovery is not None and discovery.verdict is Verdict.IDENTIFIED:
        laws = tuple(sorted(discovery.best.terms))
    return Measurement(
        family=family,
        key=key,
        column=column,
        outcome=fitted.outcome,
        seconds=seconds,
        error={name: _finite(agreements[name].error) for name in REGIONS},
        coverage={name: _finite(value) for name, value in coverage.items()},
        structure=fitted.structure,
        gain=_finite(fitted.gain),
        laws=laws,
        verdict="" if discovery is None else discovery.verdict.value,
    )


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
