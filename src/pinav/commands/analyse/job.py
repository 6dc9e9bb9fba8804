"""`pinav analyse`: maps, parts and sensitivities of what a run has learned."""

from operator import attrgetter
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from tqdm import tqdm

from pinav.analysis import (
    Influence,
    RolloutStudy,
    SobolIndices,
    helmholtz_split,
    influence,
    lyapunov_map,
    rotational_fractions,
    sampled_forces,
)
from pinav.commands.analyse.settings import AnalyseOptions, AnalyseSettings
from pinav.commands.command import CommandResult
from pinav.commands.fitted_run import FittedRun
from pinav.dynamics import Swimmer
from pinav.errors import FitError, InputError
from pinav.evaluation import FieldMap, field_map
from pinav.fitting.environments.catalogue import CONSTANTS
from pinav.forces import (
    AbstractLearnedForce,
    KernelPotential,
    LinearDrag,
    MagneticPropulsion,
    NeuralPotential,
)
from pinav.runs import RunFolder

ANALYSIS_FILE, ARRAYS_FILE = "analysis.json", "analysis.npz"

LYAPUNOV_POINTS = 25
"""Starts along each side of the map of stretch."""


def analyse(settings: AnalyseSettings, run: Path) -> dict[str, Any]:
    """Analyse a run of `pinav fit` and write the results into its folder.

    Returns:
        The content of `analysis.json`.

    Raises:
        InputError: the folder holds no finished fit of a force, or there is no
            trajectory of the number that was asked for.
    """
    settings.check()
    work = _Analysis(settings, FittedRun.open(run))
    steps = (work.maps, work.parts, work.trust, work.influences, work.rollouts)
    with tqdm(steps, desc="analyse", unit="part") as bar:
        for step in bar:
            bar.set_postfix_str(step.__name__, refresh=True)
            step()
    return work.write()


class _Analysis:
    """The parts of one analysis, in their order, and what they found so far."""

    def __init__(self, settings: AnalyseSettings, fitted: FittedRun):
        self.settings, self.fitted = settings, fitted
        self.folder = folder = fitted.folder
        self.model, self.data = _model(fitted), fitted.data
        if settings.reference >= len(self.data):
            raise InputError(
                f"--reference: expected 0 to {len(self.data) - 1}, a trajectory of "
                f"{folder.path}, got {settings.reference}"
            )
        self.found: dict[str, Any] = {
            "model": fitted.choice.name,
            "posterior": fitted.posterior is not None,
            "settings": msgspec.to_builtins(settings),
            "left_out": [],
        }
        self.arrays: dict[str, np.ndarray] = {}

    def write(self) -> dict[str, Any]:
        """Write everything; `analysis.json` last, when all else is there."""
        self.folder.write_arrays(ARRAYS_FILE, self.arrays)
        _write_tables(self.found, self.folder)
        self.folder.write_json(ANALYSIS_FILE, self.found)
        return self.found

    def leave_out(self, what: str, why: str) -> None:
        self.found["left_out"].append(f"{what}: {why}")

    def maps(self) -> None:
        """The force on a grid."""
        force = self.model.environment
        self.field = field_map(force, self.data, points=self.settings.points)
        self.arrays |= {
            name: getattr(self.field, name) for name in ("x", "y", "force", "distance")
        }

    def parts(self) -> None:
        """Gradient and rotational part, with the potential."""
        split = helmholtz_split(self.field)
        self.found["helmholtz"] = {
            "reach": self.field.regions.near,
            "rotational": split.rotational_fraction,
            "gradient": split.gradient_fraction,
            "least": split.least_fraction,
            "greatest": split.greatest_fraction,
            "misfit": split.misfit,
        }
        for name in ("gradient", "rotational", "stream", "ground"):
            self.arrays[f"split/{name}"] = getattr(split, name)
        self.arrays["split/potential"] = split.potential
        force = self.model.environment
        direct = isinstance(force, KernelPotential | NeuralPotential)
        self.arrays["potential"] = (
            _potential(force, self.field) if direct else split.potential
        )
        self.found["potential"] = "learned" if direct else "of the gradient part"

    def trust(self) -> None:
        """What the posterior says of the force and of its parts."""
        if self.fitted.posterior is None:
            self.leave_out("standard deviations", NO_POSTERIOR)
            return
        sd = self.fitted.force_sd(self.field)
        size = np.linalg.norm(self.field.force, axis=-1)
        sure = size > 2.0 * np.linalg.norm(sd, axis=-1)
        share = {
            name: float(sure[ground].mean())
            for name, ground in self.field.regions.masks(self.field.distance).items()
            if name != "unvisited"
        }
        self.arrays["sd"], self.found["above_two_sd"] = sd, share
        posterior = self.fitted.posterior
        key = jax.random.key(self.settings.seed)
        forces = sampled_forces(posterior, self.field, self.settings.draws, key=key)
        fractions = rotational_fractions(self.field, forces)
        self.found["helmholtz"]["sd"] = float(fractions.std())

    def influences(self) -> None:
        """What each trajectory and each constant does."""
        if self.fitted.posterior is None:
            self.leave_out("influence of trajectories and constants", NO_POSTERIOR)
            return
        try:
            found = _influence(self.fitted, self.model)
        except (InputError, FitError) as error:
            self.leave_out("influence of trajectories and constants", str(error))
            return
        grid = np.stack(np.meshgrid(self.field.x, self.field.y), axis=-1)
        points, shape = grid.reshape(-1, 2), self.field.force.shape
        start, times = self._reference()
        moved = found.force_changes(points, found.removals).reshape(-1, *shape)
        final = found.final_changes(start, times, found.removals)[:, :2]
        self.arrays["influence"] = moved
        near = self.field.distance <= self.field.regions.near
        size = _rms(self.field.force[near])
        self.found["influence"] = [
            {
                "trajectory": index,
                "leverage": float(found.leverages[index]),
                "cook": float(found.distances[index]),
                "force": _rms(moved[index][near]) / size,
                "final": float(np.linalg.norm(final[index])),
            }
            for index in range(len(moved))
        ]
        self._constants(found, points, start, times)

    def _constants(self, found: Influence, points, start, times) -> None:
        """How force and final position follow the constants, per percent of each."""
        if not found.constants:
            self.leave_out("influence of constants", "the physics has none")
            return
        near, rows = self.field.distance <= self.field.regions.near, []
        size = _rms(self.field.force[near])
        for name, change in found.constants.items():
            value = float(attrgetter(CONSTANTS[name])(self.model))
            percent = 0.01 * value * change[None]
            moved = found.force_changes(points, percent)[0]
            moved = moved.reshape(self.field.force.shape)
            final = found.final_changes(start, times, percent)[0, :2]
            self.arrays[f"constant/{name}"] = moved
            rows.append(
                {
                    "constant": name,
                    "value": value,
                    "learned": name in self.fitted.choice.learn,
                    "force": _rms(moved[near]) / size,
                    "final": float(np.linalg.norm(final)),
                }
            )
        self.found["constants"] = rows

    def rollouts(self) -> None:
        """How the reference rollout depends on its start, and on everything."""
        start, times = self._reference()
        self._stretch(start, times)
        potential = np.where(
            self.field.distance <= self.field.regions.near,
            self.arrays["potential"],
            -np.inf,
        )
        row, column = np.unravel_index(potential.argmax(), potential.shape)
        landmark = np.array([self.field.x[column], self.field.y[row]])
        study = RolloutStudy(
            self.model, start, times, landmark, self.field.regions.visited
        )
        factors = study.factors(
            relative=self.settings.relative, shift=self.settings.shift
        )
        options = {"samples": self.settings.samples, "seed": self.settings.seed}
        try:
            indices = study.indices(factors, **options)
        except InputError as error:
            self.leave_out("Sobol' indices", str(error))
            return
        self.found["sobol"] = _sobol_rows(indices)
        self.found["landmark"] = landmark.tolist()

    def _stretch(self, start, times) -> None:
        x, y = (
            np.linspace(axis[0], axis[-1], LYAPUNOV_POINTS)
            for axis in (self.field.x, self.field.y)
        )
        found = lyapunov_map(self.model, x, y, times, velocity=lambda _: start[2:])
        for name in ("x", "y", "separation", "final"):
            self.arrays[f"lyapunov/{name}"] = getattr(found, name)
        self.found["stretch"] = {
            "horizon": found.horizon,
            "median": float(np.nanmedian(found.separation)),
            "greatest": float(np.nanmax(found.separation)),
            "exponent": float(np.nanmedian(found.exponent)),
        }

    def _reference(self) -> tuple[np.ndarray, np.ndarray]:
        """Start and times of the reference trajectory."""
        index = self.settings.reference
        times = self.data.times[index][: self.data.lengths[index]]
        return self.fitted.start(index), times


NO_POSTERIOR = "the run has no posterior; fit with --recipe bayes"


def _model(fitted: FittedRun) -> Swimmer:
    model = fitted.model
    if not isinstance(model, Swimmer) or not isinstance(
        model.environment, AbstractLearnedForce
    ):
        raise InputError(
            f"{fitted.folder.path}: its model has no learned force of the environment; "
            "fit a kernel or neural model"
        )
    return model


def _influence(fitted: FittedRun, model: Swimmer) -> Influence:
    evidence = fitted.evidence
    assert evidence is not None
    has = {
        "damping": isinstance(model.drag, LinearDrag),
        "gain": isinstance(model.propulsion, MagneticPropulsion),
    }
    constants = {n: attrgetter(path) for n, path in CONSTANTS.items() if has.get(n)}
    return influence(
        model,
        fitted.data,
        evidence.states,
        evidence.hyperparameters,
        learn=fitted.choice.constants,
        constants=constants,
        kernels=evidence.process,
    )


def _potential(force: KernelPotential | NeuralPotential, field: FieldMap) -> np.ndarray:
    points = np.stack(np.meshgrid(field.x, field.y), axis=-1).reshape(-1, 2)
    at = jax.vmap(lambda x: force.potential(0.0, x))
    return np.asarray(at(jnp.asarray(points)), float).reshape(field.distance.shape)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))


def _sobol_rows(indices: SobolIndices) -> list[dict[str, Any]]:
    return [
        {
            "outcome": outcome,
            "factor": factor,
            "first": float(indices.first[i, j]),
            "first_low": float(indices.first_interval[i, j, 0]),
            "first_high": float(indices.first_interval[i, j, 1]),
            "total": float(indices.total[i, j]),
            "total_low": float(indices.total_interval[i, j, 0]),
            "total_high": float(indices.total_interval[i, j, 1]),
            "variance": float(indices.variance[i]),
        }
        for i, outcome in enumerate(indices.outcomes)
        for j, factor in enumerate(indices.factors)
    ]


def _write_tables(found: dict[str, Any], folder: RunFolder) -> None:
    for name in ("influence", "constants", "sobol"):
        if rows := found.get(name):
            values = [list(row.values()) for row in rows]
            folder.write_table(f"analysis-{name}.csv", list(rows[0]), values)


def text(found: dict[str, Any]) -> str:
    """The findings for a terminal."""
    parts, stretch = found["helmholtz"], found["stretch"]
    spread = f" ± {parts['sd']:.2%} (sd)" if "sd" in parts else ""
    lines = [
        f"rotational part: {parts['rotational']:.2%}{spread} of the squared force "
        f"within {parts['reach']:g} of the data; between {parts['least']:.2%} and "
        f"{parts['greatest']:.2%}, whatever harmonic fields count as",
    ]
    if "above_two_sd" in found:
        share = ", ".join(f"{k} {v:.0%}" for k, v in found["above_two_sd"].items())
        lines.append(f"force above two standard deviations: {share} of the ground")
    if "influence" in found:
        most = max(found["influence"], key=lambda row: row["force"])
        lines.append(
            f"most influential: trajectory {most['trajectory']}; without it the force "
            f"changes by {most['force']:.2%}"
        )
    for row in found.get("constants", ()):
        lines.append(
            f"{row['constant']} one percent larger: force {row['force']:.2%}, final "
            f"position {row['final']:.3g}"
        )
    lines.append(
        f"stretch of the final position by the start: median {stretch['median']:.3g}, "
        f"greatest {stretch['greatest']:.3g}"
    )
    lines += [f"left out: {line}" for line in found["left_out"]]
    return "\n".join(lines)


def run(options: AnalyseOptions) -> CommandResult:
    """Analyse as the command line does."""
    metrics = analyse(options.settings, options.run)
    return CommandResult(metrics, text(metrics), RunFolder.open(options.run))
