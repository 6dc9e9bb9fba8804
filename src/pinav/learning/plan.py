"""The plan of a fit: its system, model and recipe, checked before it begins."""

import dataclasses
import hashlib
import os
import re
from pathlib import Path

import msgspec
import numpy as np

from pinav.errors import InputError
from pinav.fitting import TrajectoryLoss
from pinav.fitting.environments.catalogue import mean_drag
from pinav.fitting.environments.kernels import kernel_environment
from pinav.fitting.environments.summary import (
    PROFILE,
    DataSummary,
    ModelChoice,
    summarise_for,
    summarise_for_matching,
)
from pinav.forces import KernelPotential, LinearDrag
from pinav.identification import needs_kalman_filter, record_commands, trajectories_of
from pinav.learning.recipes import (
    SUITED,
    Bayes,
    Curriculum,
    Inferring,
    Langevin,
    Matching,
    Recipe,
    Suited,
    name_of,
)
from pinav.learning.thermal import ThermalChoice
from pinav.runs import RunFolder
from pinav.scenarios import find_system, source_system
from pinav.systems import System, read_system, system_text
from pinav.trajectories import Trajectories, with_all_channels

SYSTEM_FILE, CODE_FILE = "system.toml", "system-code.json"

_CODE = re.compile(r'"([^"\n]+\.py):\w+"')


def choose_system(text: str | None, data: Trajectories) -> System:
    """The system that the option names, or the one that the data come from.

    Raises:
        InputError: no system is named and the data do not say where they come from.
    """
    if text is not None:
        return find_system(text)
    source = source_system(data.provenance)
    if source is None:
        raise InputError(
            "--system: the data do not say which system they come from; give a "
            "system file, or the name of a built-in one such as --system paper"
        )
    return source


def write_system_of(folder: RunFolder, system: System) -> None:
    """Keep the system of a run, and a hash of each Python file that it needs."""
    text = system_text(system)
    folder.write_text(SYSTEM_FILE, text)
    code = {path: _hash(path) for path in sorted(set(_CODE.findall(text)))}
    if code:
        folder.write_json(CODE_FILE, code)


def read_system_of(folder: RunFolder) -> System:
    """The system of a run; InputError if its file is damaged or has changed."""
    code = folder.read_json(CODE_FILE) if folder.has(CODE_FILE) else {}
    for path, digest in code.items():
        if _hash(path) != digest:
            raise InputError(
                f"{path} has changed since {folder.path} was fitted; restore it, or "
                "fit again with --overwrite"
            )
    if not folder.has(SYSTEM_FILE):
        raise InputError(
            f"{folder.path} holds no {SYSTEM_FILE}, which says what was fitted; fit "
            "again with --overwrite"
        )
    return read_system(folder.path / SYSTEM_FILE)


def _hash(path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from error


LARGEST = 1e12
"""Largest value of a state, whose fourth power a fit can still sum up."""

SHARE_OF_MEMORY = 0.8
"""The part of the free memory that a fit may ask for."""

MATCHED_MODELS = ("ude", "nn-only")
"""Models without evidence, which are matched to the trajectories."""


@dataclasses.dataclass(frozen=True)
class FitPlan:
    """Everything that decides a fit.

    Attributes:
        recipe: chosen for the data where none was asked for.
        is_open: neither the user nor the system names another model than the default,
            so that the evidence chooses between a potential and a mixture.
        thermal: what the fit of thermal motion may learn; None for another recipe.
    """

    recipe: Inferring | Matching
    system: System
    data: Trajectories
    choice: ModelChoice
    summary: DataSummary
    is_open: bool = False
    thermal: ThermalChoice | None = None


def plan_fit(
    system: System,
    data: Trajectories,
    *,
    model: str | None = None,
    recipe: Recipe = SUITED,
    train: tuple[str, ...] = (),
    seed: int = 0,
    width: int = 32,
    depth: int = 2,
) -> FitPlan:
    """Choose model and recipe, and refuse what cannot be fitted; see `learn`.

    Raises:
        InputError: the recipe cannot use the data or the system, or the fit would need
            more memory than there is.
    """
    recipe.check()
    if np.abs(data.states[data.observed]).max(initial=0.0) > LARGEST:
        raise InputError(
            f"data: expected values up to {LARGEST:g}, got larger ones; check the "
            "file, or give it in larger units"
        )
    commanded = needs_kalman_filter(system)
    if commanded:
        data = record_commands(system, trajectories_of(data, system.name))
    name = model or system.model
    is_open = model is None and system.model == ModelChoice().name
    if isinstance(recipe, Suited):
        thermal = system.thermal_energy is not None or (
            not commanded and looks_brownian(data)
        )
        recipe = suitable_recipe(recipe, name, system, thermal=thermal)
    if isinstance(recipe, Langevin):
        recipe = _with_stated(recipe, system)
    check_model(name, recipe, train)
    check_system(name, recipe, train, system)
    if isinstance(recipe, Bayes):
        data = with_all_channels(data, system)
    _check_channels(data, system)
    if isinstance(recipe, Matching):
        TrajectoryLoss().check(data)
    chosen = None
    if isinstance(recipe, Langevin):
        chosen = ThermalChoice.of(recipe, system, data)
        name = PROFILE if recipe.has_profile else name
    learned = train + tuple(number.path for number in system.learn)
    choice = ModelChoice(name, seed=seed, width=width, depth=depth, learn=learned)
    summary = (
        summarise_for_matching(choice, system.swimmer, data)
        if isinstance(recipe, Matching)
        else summarise_for(choice, data)
    )
    if chosen is not None and name == PROFILE:
        summary = dataclasses.replace(summary, environment=chosen.profile(data))
    check_memory(data, summary)
    is_open &= isinstance(recipe, Bayes)
    return FitPlan(recipe, system, data, choice, summary, is_open, chosen)


def suitable_recipe(
    asked: Suited, model: str, system: System, *, thermal: bool
) -> Inferring | Matching:
    """The recipe that suits the data, with the options that were stated.

    Raises:
        InputError: it lacks one of them, or the system has no thermal noise.
    """
    if thermal and system.order == 2:
        raise InputError(
            "the positions look like Brownian motion (second differences "
            f"correlate by -1/2), but system {system.name} has inertia and no "
            "thermal noise; give a --system without inertia, or choose a --recipe "
            "to fit it all the same"
        )
    suited = Curriculum() if model in MATCHED_MODELS else Bayes()
    suited = Langevin() if thermal else suited
    stated = {
        name: getattr(asked, name)
        for name in asked.__struct_fields__
        if getattr(asked, name) != getattr(SUITED, name)
    }
    for name in stated:
        if name not in suited.__struct_fields__:
            raise InputError(
                f"--{name.replace('_', '-')}: the recipe {name_of(suited)}, which "
                "suits the data, has no such option; drop it, or choose a --recipe"
            )
    return msgspec.structs.replace(suited, **stated)


def _with_stated(recipe: Langevin, system: System) -> Langevin:
    """The recipe with what the system states of thermal motion, and with defaults."""
    stated = {
        name: getattr(recipe, name) or getattr(system.thermal, name)
        for name in recipe.__struct_fields__
    }
    stated["observation"] = stated["observation"] or "exact"
    stated["diffusion"] = stated["diffusion"] or "constant"
    return Langevin(**stated)


def _check_channels(data: Trajectories, system: System) -> None:
    if len(system.channels) != len(data.channels):
        raise InputError(
            f"data: expected the channels {', '.join(system.channels)} of system "
            f"{system.name}, got {', '.join(data.channels)}"
            + (
                "; --recipe bayes needs positions alone"
                if data.channels == system.position_channels
                else ""
            )
        )


def check_model(
    model: str, recipe: Inferring | Matching, train: tuple[str, ...]
) -> None:
    """Refuse a model that the recipe cannot fit, or constants that it cannot learn."""
    if isinstance(recipe, Langevin):
        _check_thermal_model(model, recipe, train)
    if model == "nn-only" and train:
        raise InputError(
            "--train: the model nn-only has no physical constants; drop --train or "
            "choose another --model"
        )
    if model in MATCHED_MODELS and isinstance(recipe, Bayes):
        raise InputError(
            f"--recipe {name_of(recipe)}: the model {model} has no evidence; "
            "choose --recipe curriculum, or a kernel or neural model"
        )
    if "drag" in train and not isinstance(recipe, Bayes):
        raise InputError("--train drag: only the recipe bayes does; drop it")
    if "drag" in train and "damping" in train:
        raise InputError("--train: drag takes the place of damping; drop one")


def _check_thermal_model(model: str, recipe: Langevin, train: tuple[str, ...]) -> None:
    if not model.startswith("kernel-"):
        raise InputError(
            f"--recipe langevin: expected a kernel model, got {model}; choose "
            "--model kernel-potential"
        )
    if train:
        raise InputError(
            "--recipe langevin: it learns no constant but diffusion; drop --train"
        )
    if recipe.has_profile and model not in ("kernel-potential", "kernel-force"):
        raise InputError(
            f"--model {model}: a force that depends on --coordinates, with "
            "--period or --warp, is a model of its own; drop --model"
        )


def looks_brownian(data: Trajectories) -> bool:
    r"""The paths have independent increments, as thermal motion without inertia has.

    Second differences of Brownian motion correlate by -1/2 with the next one and by 0
    with the one after; those of a smooth path correlate positively, and those of
    independent errors of observation by -2/3 and 1/6.
    """
    products = np.zeros(3)
    for piece in data:
        observed_times = piece.observed[:, 0]
        positions = piece.states[observed_times][:, : data.dim]
        second = np.diff(positions, n=2, axis=0)
        if len(second) < 3:
            continue
        scale = np.abs(second).max()
        second = second / scale if scale > 0 else second
        products += [
            np.sum(second[lag:] * second[: len(second) - lag]) for lag in range(3)
        ]
    if not products[0] > 0:
        return False
    one, two = products[1:] / products[0]
    return bool(-0.58 < one < -0.42 and abs(two) < 0.1)


def check_system(
    model: str, recipe: Inferring | Matching, train: tuple[str, ...], system: System
) -> None:
    """Refuse a recipe, a model or a constant that the system does not have."""
    knows_all = not (train or system.learn or needs_kalman_filter(system))
    if model == "physics-only" and knows_all:
        raise InputError(
            "--model physics-only: there is nothing to fit; add --train damping"
        )
    drag = getattr(system.swimmer, "drag", None)
    if "damping" in train and not isinstance(drag, LinearDrag):
        raise InputError(
            f"--train damping: system {system.name} has no such constant: its drag is "
            f"{'a mobility' if drag is None else type(drag).__name__}; drop it"
        )
    if "drag" in train:
        try:
            mean_drag(system.swimmer)
        except InputError as error:
            raise InputError(f"--train drag: {error}") from error
    if isinstance(recipe, Langevin) and system.order == 2:
        raise InputError(
            "--recipe langevin: expected a system without inertia, such as brownian, "
            f"got {system.name}; choose --recipe bayes"
        )
    if system.order == 1 and model == "ude":
        raise InputError(
            f"--model ude: expected a system with inertia, got {system.name}; choose a "
            "kernel or neural model"
        )


def check_memory(data: Trajectories, summary: DataSummary) -> None:
    """Refuse data whose linearised problem does not fit into the memory."""
    force = summary.environment
    laid = None if force is None else force.kernels
    if laid is None:  # a network is taught by kernels
        laid = kernel_environment(KernelPotential, data, dim=data.dim).kernels
    weights = len(laid.centers) * summary.dim
    needed = 8.0 * data.states.size * weights
    available = SHARE_OF_MEMORY * free_memory()
    if needed > available:
        raise InputError(
            f"data: {data.states.shape[0] * data.states.shape[1]} samples and "
            f"{weights} weights need about {needed / 1e9:.1f} GB of memory, but "
            f"{available / 1e9:.1f} GB are free; fit fewer trajectories, or every "
            f"{int(np.ceil(needed / available))}th sample"
        )


def free_memory() -> float:
    """Free memory [bytes]; infinite where the operating system does not report it."""
    try:
        return float(os.sysconf("SC_AVPHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return float("inf")
