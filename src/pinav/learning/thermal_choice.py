"""What a fit of thermal motion may learn: the words of its options as values."""

import dataclasses

from pinav.errors import InputError
from pinav.fitting import (
    ConstantDiffusion,
    KernelDiffusion,
    LearnedObservation,
    Observation,
    SlowReference,
    profile_environment,
    slow_reference,
    warp_at_slow_end,
)
from pinav.fitting.environments.profiles import ProfileSummary
from pinav.forces import KernelAxis
from pinav.learning.recipes import Langevin
from pinav.systems import System
from pinav.systems.thermal_unknown import split_period
from pinav.trajectories import Trajectories

ACROSS = {1: 24, 2: 8}
"""Kernels across the data along each of so many coordinates."""


@dataclasses.dataclass(frozen=True)
class ThermalChoice:
    """What may be learned of thermal motion.

    Attributes:
        axes: the coordinates on which fields depend.
        diffusion: what it may be; None for one number.
        observation: what is known of the camera; None counts positions as exact.
        reference: the coordinate that drifts, if one does.
        einstein: whether the mobility follows from the diffusion.
    """

    axes: tuple[KernelAxis, ...]
    diffusion: ConstantDiffusion | KernelDiffusion | None
    observation: Observation | LearnedObservation | None
    reference: SlowReference | None
    einstein: bool

    @classmethod
    def of(
        cls, recipe: Langevin, system: System, data: Trajectories
    ) -> "ThermalChoice":
        """The values of resolved recipe.

        Raises:
            InputError: a coordinate is not there, a period is none, or what is asked
                for contradicts itself or the system.
        """
        axes = _axes(recipe, system, data)
        varies = recipe.diffusion != "constant"
        diffusion = None
        if varies:
            diffusion = _fields(recipe, axes, system)
        elif recipe.period:
            diffusion = ConstantDiffusion()  # where increments find the short way round
        reference = None
        if recipe.reference is not None:
            reference = _reference(recipe, system, axes, data)
        heat = system.thermal_energy
        return cls(
            axes=axes,
            diffusion=diffusion,
            observation=_observation(recipe, system),
            reference=reference,
            einstein=varies and heat is not None and float(heat) > 0,
        )

    @property
    def is_plain(self) -> bool:
        """Whether positions are exact and the diffusion is one number."""
        return (self.diffusion, self.observation, self.reference) == (None, None, None)

    def profile(self, data: Trajectories) -> ProfileSummary:
        """The untrained force along the coordinates, on which alone it depends."""
        across = ACROSS.get(len(self.axes), min(ACROSS.values()))
        return ProfileSummary.of(profile_environment(data, self.axes, across=across))


def _axes(
    recipe: Langevin, system: System, data: Trajectories
) -> tuple[KernelAxis, ...]:
    channels = system.position_channels
    periods: dict[str, float] = {}
    for text in recipe.period:
        name, period = split_period(text)
        if name in periods:
            raise InputError(
                f"--period: expected one for each coordinate, {name} twice"
            )
        periods[name] = period
    named = recipe.coordinates or channels
    for option, names in (
        ("coordinates", named),
        ("period", periods),
        ("warp", recipe.warp),
    ):
        _check_names(option, tuple(names), system)
        if outside := [name for name in names if name not in named]:
            raise InputError(
                f"--{option} {outside[0]}: fields depend on {', '.join(named)} alone; "
                "name it in --coordinates, too"
            )
    if both := sorted(set(periods) & set(recipe.warp)):
        raise InputError(
            f"--warp {both[0]}: a coordinate that repeats has no slow end; drop its "
            "--period or its --warp"
        )
    axes = []
    for name in (one for one in channels if one in named):
        index = channels.index(name)
        warp = warp_at_slow_end(data, index) if name in recipe.warp else None
        axes.append(KernelAxis(index, periods.get(name), warp))
    return tuple(axes)


def _check_names(option: str, names: tuple[str, ...], system: System) -> None:
    channels = system.position_channels
    for name in names:
        if name not in channels:
            raise InputError(
                f"--{option}: expected coordinates of system {system.name}, "
                f"{', '.join(channels)}; got {name}"
            )
    if len(set(names)) < len(names):
        raise InputError(f"--{option}: expected each coordinate once, got {names}")


def _fields(
    recipe: Langevin, axes: tuple[KernelAxis, ...], system: System
) -> KernelDiffusion:
    """One field of log D, or one along each coordinate and one along all others."""
    if len(axes) not in ACROSS:
        raise InputError(
            f"--diffusion {recipe.diffusion}: expected one or two coordinates on "
            f"which it depends, got {', '.join(system.position_channels)}; name them, "
            "such as --coordinates z"
        )
    groups = None
    if recipe.diffusion == "tensor":
        named = [axis.index for axis in axes]
        others = tuple(index for index in range(system.dim) if index not in named)
        groups = (*((others,) if others else ()), *((index,) for index in named))
        if len(groups) < 2:
            raise InputError(
                "--diffusion tensor: one coordinate has no directions; choose "
                "--diffusion field"
            )
    return KernelDiffusion(axes, groups, ACROSS[len(axes)])


def _observation(
    recipe: Langevin, system: System
) -> Observation | LearnedObservation | None:
    if recipe.observation == "learn":
        return LearnedObservation()
    if recipe.observation == "exact":
        return None
    stated = system.observation
    if stated.noise == 0 and stated.exposure == 0:
        raise InputError(
            f"--observation known: system {system.name} states neither noise nor "
            "exposure; state them in [observation], or choose --observation learn"
        )
    return Observation(float(stated.exposure), float(stated.noise))


def _reference(
    recipe: Langevin,
    system: System,
    axes: tuple[KernelAxis, ...],
    data: Trajectories,
) -> SlowReference:
    name = str(recipe.reference)
    _check_names("reference", (name,), system)
    index = system.position_channels.index(name)
    if index not in [axis.index for axis in axes]:
        raise InputError(
            f"--reference {name}: force and diffusion do not depend on {name}, so that "
            "nothing shows its drift; name it in --coordinates, too"
        )
    return slow_reference(data, index)
