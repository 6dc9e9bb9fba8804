"""`pinav simulate`: trajectories of a system, in a file."""

import equinox as eqx
import jax

from pinav.commands.command import CommandResult
from pinav.commands.simulate import SimulateOptions
from pinav.scenarios import find_system
from pinav.trajectories import (
    AbstractDegradation,
    FrameLoss,
    Unobserved,
    check_savable,
    degrade,
    save,
    simulate,
)


def run(options: SimulateOptions) -> CommandResult:
    """Simulate a system and save its trajectories, as the command line does."""
    check_savable(options.out, overwrite=options.overwrite)
    starts_key, noise_key = jax.random.split(jax.random.key(options.seed))
    system = find_system(options.system, starts_key, count=options.count)
    if options.noise is not None:
        system = eqx.tree_at(lambda s: s.observation.noise, system, options.noise)
    trajectories = simulate(system, key=noise_key)
    velocities = trajectories.channels[trajectories.dim :]
    steps: list[AbstractDegradation] = []
    if options.frame_loss > 0:
        steps.append(FrameLoss(options.frame_loss))
    if options.positions_only and velocities:
        steps.append(Unobserved(velocities))
    if steps:
        loss_key = jax.random.fold_in(noise_key, 2)
        trajectories = degrade(trajectories, steps, key=loss_key)
    save(trajectories, options.out, overwrite=options.overwrite)
    count, samples = len(trajectories), int(trajectories.lengths.sum())
    noun = "trajectory" if count == 1 else "trajectories"
    metrics = {"file": str(options.out), "trajectories": count, "samples": samples}
    text = f"{options.out}: {count} {noun}, {samples} samples"
    return CommandResult(metrics, text)
