# %% [markdown]
"""From A to B through an unknown obstacle
=======================================

Synthetic trajectories at a Gaussian barrier that is stronger than the thrust, noise
0.02. A kernel potential is fitted; then the example shows from where and how soon the
goal can be reached, whether a controller that knows only the fit gets there, and which
further trajectory would be most informative.
"""

# %%
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one pool of threads: see the docs

import dataclasses
import tempfile
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", val=True)

from pinav.figures.images import save_figure
from pinav.figures.navigation import plan_map
from pinav.fitting import fit_bayes, kernel_environment
from pinav.forces import KernelPotential
from pinav.navigation.adaptive.prior import with_prior_of
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.strategies import MEAN_FORCE
from pinav.navigation.control.controller import StraightLine
from pinav.navigation.control.default import controller
from pinav.navigation.design.candidates import Experiment, Stage, suggest_next
from pinav.navigation.planning.plan import time_to_go
from pinav.navigation.task.catalogue import task, training
from pinav.navigation.task.task import Course, Rectangle, steered_swimmer
from pinav.navigation.trials.closed_loop import run_many
from pinav.navigation.trials.metrics import regret, summary

# %% [markdown]
# Data and fit
# ------------
#
# The task is to pass the barrier with less thrust than it has force; what is known of
# it are eight trajectories, which were not recorded for the task.

# %%
crossing = task("barrier-weak")
data = training("barrier-weak", jax.random.key(1))
unknown = crossing.truth.dynamics.with_environment(
    kernel_environment(KernelPotential, data)
)
fit = fit_bayes(unknown, data)
model = steered_swimmer(crossing, fit.model)

# %% [markdown]
# The plan
# --------
#
# The time-to-go from anywhere, on the learned force.

# %%
plan = time_to_go(crossing, model)
route = plan.route(crossing.start)
print(f"planned: {float(route.arrival_time):.1f} from start to goal")
print(f"out of reach in time: {plan.unreachable.mean():.0%} of the arena")

times = np.where(plan.unreachable, np.inf, plan.map)
with tempfile.TemporaryDirectory() as folder:
    ax = plan_map(times, Course.of(crossing), route=np.asarray(route.ys[:, :2]))
    print("drawn:", save_figure(ax.figure, Path(folder), "plan").png.name)

# %% [markdown]
# In closed loop
# --------------
#
# The true environment, with noise; the controllers differ in what they know.

# %%
keys = jax.random.split(jax.random.key(2), 10)
with_truth = run_many(crossing, controller(crossing, crossing.truth), keys)
with_model = run_many(crossing, controller(crossing, model), keys)
straight = StraightLine(crossing.objective, crossing.limits)
for name, episodes in (
    ("truth", with_truth),
    ("learned", with_model),
    ("straight line", run_many(crossing, straight, keys)),
):
    found = summary(episodes, crossing)
    print(
        f"{name}: {found.success.value:.0%} arrive, 95 % interval "
        f"{found.success.lower:.0%} to {found.success.upper:.0%}"
    )
ratio = regret(with_model, with_truth)
print(f"regret, median of the pairs: {ratio.value:.3f}")

# %% [markdown]
# What to record next
# -------------------
#
# Which of many drive programmes, from near the start, tells most of the route?

# %%
start = np.asarray(crossing.start[:2])
recorded = dataclasses.replace(
    crossing, truth=model, sensor_noise=float(fit.hyperparameters.noise)
)
known = with_prior_of(
    AdaptiveController.of(recorded, MEAN_FORCE),
    fit.model,
    fit.posterior,
    data.seen_positions,
)
experiment = Experiment(recorded, Rectangle(start - 0.3, start + 0.3), duration=8.0)
way = np.asarray(route.ys[::10, :2])
stage = Stage(known, experiment, known.believe(known.first_frame), way)
found = suggest_next(stage, key=jax.random.key(3))
assert found is not None
print(f"headings: {np.round(found.heading, 2)}")
print(f"sd of the force along the route: {found.sd:.2g} -> {found.sd_after:.2g}")
