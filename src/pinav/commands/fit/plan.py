"""The plan of a fit: its system, model and recipe, checked before a run begins."""

import dataclasses
import os

import msgspec
import numpy as np
from jaxtyping import Float

from pinav.commands.fit.settings import (
    EVIDENCE_RECIPES,
    THERMAL_OPTIONS,
    FitSettings,
)
from pinav.commands.fit.thermal_choice import ThermalChoice
from pinav.commands.matching import check_starts
from pinav.errors import InputError
from pinav.fitting.environments.choice import PROFILE, ModelChoice
from pinav.fitting.environments.mean_drag import mean_drag
from pinav.fitting.environments.summary import (
    DataSummary,
    summarise_for,
    summarise_for_matching,
)
from pinav.forces import LinearDrag
from pinav.identification import (
    needs_kalman_filter,
    record_commands,
    trajectories_of,
)
from pinav.systems import System
from pinav.trajectories import Trajectories, with_all_channels

LARGEST = 1e12
"""Largest value of a state, whose fourth power a fit can still sum up."""

SHARE_OF_MEMORY = 0.8
"""The part of the free memory that a fit may ask for."""


@dataclasses.dataclass(frozen=True)
class FitPlan:
    """Everything that decides a fit.

    Attributes:
        settings: with model and recipe resolved; the model stays open where neither
            the user nor the system names another than the default.
        system: the known physics.
        data: as the recipe needs them.
        choice: the model that is learned.
        summary: what the untrained model takes from the data.
        thermal: what the fit of thermal motion may learn; None for another recipe.
    """

    settings: FitSettings
    system: System
    data: Trajectories
    choice: ModelChoice
    summary: DataSummary
    thermal: ThermalChoice | None = None

    @property
    def weigh_rotation(self) -> bool:
        """Whether the evidence chooses between a potential and a mixture."""
        return self.settings.model is None


def plan_fit(settings: FitSettings, system: System, data: Trajectories) -> FitPlan:
    """Choose model and recipe, and refuse what cannot be fitted.

    Raises:
        InputError: the recipe cannot use the data or the system, or the fit would need
            more memory than there is.
    """
    if np.abs(data.states[data.observed]).max(initial=0.0) > LARGEST:
        raise InputError(
            f"data: expected values up to {LARGEST:g}, got larger ones; check the "
            "file, or give it in larger units"
        )
    commanded = needs_kalman_filter(system)
    if commanded:
        data = record_commands(system, trajectories_of(data, system.name))
    thermal = system.thermal_energy is not None or (
        not commanded and looks_brownian(data)
    )
    is_open = settings.model is None and system.model == ModelChoice().name
    settings = resolve(settings, system, thermal=thermal)
    settings.check()
    check_system(settings, system)
    if settings.recipe == "bayes":
        data = with_all_channels(data, system)
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
    if settings.recipe not in EVIDENCE_RECIPES:
        check_starts(data)
    chosen = None
    if settings.recipe == "langevin":
        chosen = ThermalChoice.of(settings, system, data)
    choice = ModelChoice(
        name=PROFILE if settings.has_profile else str(settings.model),
        seed=settings.seed,
        width=settings.width,
        depth=settings.depth,
        learn=settings.train + tuple(number.path for number in system.learn),
    )
    if settings.recipe in EVIDENCE_RECIPES:
        summary = summarise_for(choice, data)
    else:
        summary = summarise_for_matching(choice, system.swimmer, data)
    if chosen is not None and settings.has_profile:
        summary = msgspec.structs.replace(summary, profile=chosen.profile(data))
    check_memory(data, summary)
    if is_open and settings.recipe == "bayes":
        settings = msgspec.structs.replace(settings, model=None)
    return FitPlan(settings, system, data, choice, summary, chosen)


def resolve(settings: FitSettings, system: System, *, thermal: bool) -> FitSettings:
    """The settings with what the system states, and the recipe that suits the data.

    Args:
        settings: as given.
        system: which names a model where none is given.
        thermal: the paths are those of Brownian motion.

    Raises:
        InputError: the paths are Brownian and the system has inertia.
    """
    name = settings.model or system.model
    recipe = settings.recipe
    if recipe == "default" and thermal:
        if system.order == 2:
            raise InputError(
                "the positions look like Brownian motion (second differences "
                f"correlate by -1/2), but system {system.name} has inertia and no "
                "thermal noise; give a --system without inertia, or choose a --recipe "
                "to fit it all the same"
            )
        recipe = "langevin"
    elif recipe == "default":
        recipe = "curriculum" if name in ("ude", "nn-only") else "bayes"
    settings = msgspec.structs.replace(settings, model=name, recipe=recipe)
    if recipe != "langevin":
        return settings
    stated = {
        option: getattr(settings, option) or getattr(system.thermal, option)
        for option in THERMAL_OPTIONS
    }
    stated["observation"] = stated["observation"] or "exact"
    stated["diffusion"] = stated["diffusion"] or "constant"
    return msgspec.structs.replace(settings, **stated)


def looks_brownian(data: Trajectories) -> bool:
    r"""The paths have independent increments, as thermal motion without inertia has.

    Second differences of Brownian motion correlate by -1/2 with the next one and by 0
    with the one after; those of a smooth path correlate positively, and those of
    independent errors of observation by -2/3 and 1/6.
    """
    one, two = _correlations(data)
    return bool(-0.58 < one < -0.42 and abs(two) < 0.1)


def _correlations(data: Trajectories) -> Float[np.ndarray, " lag"]:
    """Correlation of second differences of positions with those one and two later."""
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
    return products[1:] / products[0] if products[0] > 0 else np.ones(2)


def check_system(settings: FitSettings, system: System) -> None:
    """Refuse a recipe, a model or a constant that the system does not have.

    Raises:
        InputError: something does not suit the order or the drag of the system.
    """
    drag = getattr(system.swimmer, "drag", None)
    if "damping" in settings.train and not isinstance(drag, LinearDrag):
        raise InputError(
            f"--train damping: system {system.name} has no such constant: its drag is "
            f"{'a mobility' if drag is None else type(drag).__name__}; drop it"
        )
    if "drag" in settings.train:
        try:
            mean_drag(system.swimmer)
        except InputError as error:
            raise InputError(f"--train drag: {error}") from error
    if settings.recipe == "langevin" and system.order == 2:
        raise InputError(
            "--recipe langevin: expected a system without inertia, such as brownian, "
            f"got {system.name}; choose --recipe bayes"
        )
    if system.order == 1 and settings.model == "ude":
        raise InputError(
            f"--model ude: expected a system with inertia, got {system.name}; choose a "
            "kernel or neural model"
        )


def check_memory(data: Trajectories, summary: DataSummary) -> None:
    """Refuse data whose linearised problem does not fit into the memory.

    Raises:
        InputError: it needs more than there is.
    """
    weights = len(summary.centers) * summary.dim
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
    """Memory that this process may still use [bytes]; infinite where nobody says."""
    try:
        return float(os.sysconf("SC_AVPHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return float("inf")
