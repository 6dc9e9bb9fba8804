"""Learn a force from noisy positions alone, and say how far to trust it
=====================================================================

Eight synthetic crossings of a Gaussian barrier, noise 0.02 on every observation; the
velocities are hidden from the fit.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one pool of threads: see the docs

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", val=True)

from pinav.evaluation import field_map
from pinav.figures import force_comparison
from pinav.fitting import fit_bayes, kernel_environment
from pinav.forces import KernelPotential
from pinav.scenarios import barrier_crossings
from pinav.trajectories import Trajectories, simulate

scenario = barrier_crossings()
noisy = simulate(scenario, key=jax.random.key(1))
positions_only = np.broadcast_to(np.arange(4) < 2, noisy.states.shape)
data = Trajectories.from_arrays(
    list(noisy.times),
    list(noisy.states),
    channels=noisy.channels,
    observed=positions_only,
)

environment = kernel_environment(KernelPotential, data)
unknown = scenario.swimmer.with_environment(environment)
result = fit_bayes(unknown, data)
print(f"{result.outcome} after {result.iterations} iterations")

points = np.array([[3.0, 5.0], [5.0, 3.0], [6.5, 6.5]])
sd = result.posterior.force_sd(points)
for point, spread in zip(points, sd, strict=True):
    x, v = jnp.asarray(point), jnp.zeros(2)
    learned = np.asarray(result.model.environment(0.0, x, v))
    true = np.asarray(scenario.environment(0.0, x, v))
    numbers = (np.round(vector, 4) for vector in (learned, spread, true))
    print("at {}: learned {} ± {}, true {}".format(point, *numbers))

maps = {
    name: field_map(force, data)
    for name, force in (
        ("learned", result.model.environment),
        ("true", scenario.environment),
    )
}
grid = np.stack(np.meshgrid(maps["true"].x, maps["true"].y), axis=-1)
deviation = result.posterior.force_sd(grid.reshape(-1, 2)).reshape(grid.shape)
figure = force_comparison(**maps, sd=deviation)
