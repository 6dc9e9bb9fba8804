# %% [markdown]
"""What was learned, and what does it depend on?
=============================================

Synthetic shots at a Gaussian barrier, noise 0.02. A free kernel force is fitted, which
could be rotational; then: which part of it is a gradient, where is it known, which
trajectory and which constant decide it, and what decides where a swimmer ends?
"""

# %%
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one pool of threads: see the docs

import tempfile
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

jax.config.update("jax_enable_x64", val=True)

from pinav.analysis import (
    RolloutStudy,
    helmholtz_split,
    influence,
    lyapunov_map,
    rotational_fractions,
    sample_forces,
)
from pinav.evaluation import field_map
from pinav.figures import helmholtz_figure, save_figure
from pinav.fitting import KernelGrid, fit_bayes, kernel_environment
from pinav.forces import KernelForce
from pinav.scenarios import barrier_crossings
from pinav.trajectories import simulate

# %% [markdown]
# Data and fit
# ------------
#
# Four short crossings.

# %%
scenario = eqx.tree_at(
    lambda s: (s.starts, s.times),
    barrier_crossings(),
    replace_fn=lambda a: a[:4] if a.ndim == 2 else a[:61],
)
data = simulate(scenario, key=jax.random.key(1))
environment = kernel_environment(KernelForce, data, KernelGrid(across=8, margin=3.0))
unknown = scenario.swimmer.with_environment(environment)
fit = fit_bayes(unknown, data)
print(f"{fit.outcome} after {fit.iterations} iterations")

# %% [markdown]
# Which part is a gradient?
# -------------------------
#
# Nothing told the fit that the force has a potential.

# %%
field = field_map(fit.model.environment, data, points=31)
split = helmholtz_split(field)
forces = sample_forces(fit.posterior, field, 32, key=jax.random.key(2))
spread = rotational_fractions(field, forces).std()
print(f"rotational fraction {split.rotational_fraction:.1%} ± {spread:.1%} (sd)")
# The standard deviation is that of the noise alone: harmonic fields, which are gradient
# and rotational at once, are shared between both parts, so that the least counts.
print(f"what no potential explains: {split.least_fraction:.1%}")

with tempfile.TemporaryDirectory() as folder:
    figure = helmholtz_figure(split, field, spread=spread).draw()
    print("drawn:", save_figure(figure, Path(folder), "helmholtz").png.name)

# %% [markdown]
# Which trajectory, and which constant, decides the force?
# --------------------------------------------------------

# %%
found = influence(
    fit.model,
    data,
    fit.states,
    fit.hyperparameters,
    constants={
        "damping": lambda m: m.drag.damping,
        "gain": lambda m: m.propulsion.gain,
    },
)
point = np.array([[4.0, 3.0]])
for index, change in enumerate(found.force_changes(point, found.removals)[:, 0]):
    print(f"without trajectory {index} the force at (4, 3) changes by {change}")
for name, change in found.constants.items():
    slope = found.force_changes(point, change[None])[0, 0]
    print(f"per unit of {name}: {slope}")

# %% [markdown]
# What decides where a swimmer ends?
# ----------------------------------

# %%
start, times = fit.states[0, 0], data.times[0]
axis = np.linspace(0.0, 10.0, 6)
growth = lyapunov_map(fit.model, axis, axis, times, velocity=lambda _: start[2:])
print(f"greatest Lyapunov exponent over this time: {growth.exponent.max():.3g}")

study = RolloutStudy(fit.model, start, times, np.array([5.0, 5.0]), tolerance=0.35)
indices = study.indices(study.factors(relative=0.1, shift=0.1), samples=64)
for factor, total in zip(indices.factors, indices.total[0], strict=True):
    print(f"final x, total index of {factor}: {total:.2f}")
