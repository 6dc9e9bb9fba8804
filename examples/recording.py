"""Fit a rolling robot from a tracker's file, and predict where it goes
====================================================================

The recording is synthetic: 60 s of a robot that follows random headings with a gain of
5 um per cycle, a corner of 2 Hz, a delay of 0.25 s and a drift of (0.6, -0.3) um/s.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one pool of threads: see the docs

import jax
import numpy as np

jax.config.update("jax_enable_x64", val=True)

from pinav.evaluation import predict
from pinav.figures import observed_paths
from pinav.fitting import KernelGrid, kernel_environment, model_evidence
from pinav.forces import KernelPotential
from pinav.identification import (
    Rollouts,
    errors,
    estimates,
    fit_commanded,
    fit_track,
    gain_matrix,
    path_of,
    split,
    system_of,
    tracks,
    with_learned,
    with_response,
)
from pinav.trajectories import Trajectories

random = np.random.default_rng(0)
times = np.arange(0.0, 60.0, 0.1)
heading = np.cumsum(random.normal(0.0, 0.15, len(times)))
frequency = 2 + 1.5 * np.sin(times / 4)

fine = np.arange(0.0, 60.0, 0.01)
acting = np.maximum(np.searchsorted(times, fine - 0.25, side="right") - 1, 0)
speed = 5 * frequency / np.sqrt(1 + (frequency / 2) ** 2)
velocity = speed * np.array([np.cos(heading), np.sin(heading)])
velocity = velocity[:, acting] + np.array([[0.6], [-0.3]])
wander = np.cumsum(random.normal(0.0, 0.02, (2, len(fine))), axis=1)
positions = np.cumsum(0.01 * velocity, axis=1) + wander
seen = positions[:, ::10].T + random.normal(0.0, 0.05, (len(times), 2))

recording = Trajectories.from_arrays(  # read_recording(path) gives the same
    [times],
    [seen],
    channels=("x", "y"),
    commands={"frequency": [frequency], "heading": [heading]},
    units={"x": "um", "y": "um", "t": "s", "frequency": "Hz", "heading": "rad"},
)

train, held_out = split(tracks(recording)[0], 0.7)
candidate = with_response(gain_matrix(), "saturating")
candidate = with_learned(candidate, "delay", "propulsion.delay")
fit = fit_track(train, candidate)
for name, estimate in estimates(fit).items():
    print(f"{name}: {estimate.value:.3g} ± {1.96 * estimate.sd:.2g}")

rollouts = Rollouts.of(held_out, 10.0)
found = errors(held_out, rollouts, path_of(fit.model))
print(
    f"{len(rollouts)} open-loop rollouts of 10 s: median error {found.median:.2f} um, "
    f"{100 * found.relative:.1f} % of the path"
)

system = system_of(fit, jitter=0.05, name="robot", units=recording.units)
kernels = kernel_environment(KernelPotential, recording, KernelGrid(across=4), dim=2)
alone = fit_commanded(system, recording, None)
learned = fit_commanded(system, recording, kernels, refine=None)
gained = model_evidence(learned.linear, learned.hyperparameters).log_evidence
gained -= model_evidence(alone.linear, alone.hyperparameters).log_evidence
print(f"a potential on top: {gained:+.1f} nats (this robot has none)")
states, _ = predict(learned.model, recording)
end = float(np.linalg.norm(states[0, 100] - seen[100]))
print(f"10 s from the start, under the recording's own commands: off by {end:.2f} um")

seconds = slice(0, 101)  # the first ten
predicted = np.asarray(states[0, seconds])
ax = observed_paths([seen[seconds]], [predicted], units=recording.units)
