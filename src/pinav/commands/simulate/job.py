"""`pinav simulate`: trajectories of a system, in a file."""

from pathlib import Path

import equinox as eqx
import jax

from pinav.commands.command import CommandResult
from pinav.commands.simulate import SimulateOptions, SimulateSettings
from pinav.scenarios import find_system
from pinav.trajectories import (
    AbstractDegradation,
    FrameLoss,
    Trajectories,
    Unobserved,
    check_savable,
    degrade,
    save,
)
from pinav.trajectories import simulate as simulate_system


def simulate(
    name: str, settings: SimulateSettings, out: Path, *, overwrite: bool
) -> Trajectories:
    """Simulate a system and save its trajectories."""
    settings.check()
    check_savable(out, overwrite=overwrite)
    starts_key, noise_key = jax.random.split(jax.random.key(settings.seed))
    system = find_system(name, starts_key, count=settings.count)
    if settings.noise is not None:
        system = eqx.tree_at(lambda s: s.observation.noise, system, settings.noise)
    trajectories = simulate_system(system, key=noise_key)
    velocities = trajectories.channels[trajectories.dim :]
    steps = _degradations(settings, velocities)
    if steps:
        loss_key = jax.random.fold_in(noise_key, 2)
        trajectories = degrade(trajectories, steps, key=loss_key)
    save(trajectories, out, overwrite=overwrite)
    return trajectories


def _degradations(
    settings: SimulateSettings, velocities: tuple[str, ...]
) -> list[AbstractDegradation]:
    steps: list[AbstractDegradation] = []
    if settings.frame_loss > 0:
        steps.append(FrameLoss(settings.frame_loss))
    if settings.positions_only and velocities:
        steps.append(Unobserved(velocities))
    return steps


def run(options: SimulateOptions) -> CommandResult:
    """Simulate as the command line does."""
    trajectories = simulate(
        options.system, options.settings, options.out, overwrite=options.overwrite
    )
    count, samples = len(trajectories), int(trajectories.lengths.sum())
    noun = "trajectory" if count == 1 else "trajectories"
    metrics = {"file": str(options.out), "trajectories": count, "samples": samples}
    text = f"{options.out}: {count} {noun}, {samples} samples"
    return CommandResult(metrics, text)
