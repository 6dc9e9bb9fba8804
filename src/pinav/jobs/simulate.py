"""`pinav simulate`: trajectories of a named scenario, in a file."""

from pathlib import Path

import equinox as eqx
import jax

from pinav.errors import InputError
from pinav.jobs.settings import SimulateSettings
from pinav.scenarios import scenario
from pinav.trajectories import Trajectories
from pinav.trajectories import simulate as simulate_scenario
from pinav.trajectory_files import save


def simulate(
    name: str, settings: SimulateSettings, out: Path, *, overwrite: bool
) -> Trajectories:
    """Simulate a scenario and save its trajectories.

    Raises:
        InputError: the scenario is unknown, the noise negative, or the file there.
    """
    if settings.noise is not None and settings.noise < 0:
        raise InputError(f"--noise: expected 0 or more, got {settings.noise}")
    starts_key, noise_key = jax.random.split(jax.random.key(settings.seed))
    chosen = scenario(name, starts_key)
    if settings.noise is not None:
        chosen = eqx.tree_at(lambda s: s.noise, chosen, settings.noise)
    trajectories = simulate_scenario(chosen, key=noise_key)
    save(trajectories, out, overwrite=overwrite)
    return trajectories
