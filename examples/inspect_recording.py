"""From a tracker's file to what it can teach, on a small synthetic recording
==========================================================================

A rolling robot obeys its commands 0.2 s late, in images with y down, and the log holds
the azimuth of its rotation axis: what a reader cannot guess is said, the rest is found.
"""

import tempfile
from pathlib import Path

import numpy as np

from pinav.figures import recording_figure
from pinav.recordings import Reading, labels, read_recording
from pinav.recordings.quality import quality

MPP, DELAY, GAIN = 0.345, 0.2, 4.0  # um/px, s, um/s/Hz

random = np.random.default_rng(0)
times = np.cumsum(random.uniform(0.035, 0.05, 2000))
rates = np.repeat(random.uniform(-1.5, 1.5, 50), 40)
heading = np.cumsum(rates * np.diff(times, prepend=0.0))
frequency = np.repeat([0.0, 2.0, 4.0, 6.0, 8.0], 400)

late = np.maximum(np.searchsorted(times, times - DELAY) - 1, 0)
way = np.stack([np.cos(heading[late]), np.sin(heading[late])], axis=1)
steps = GAIN * (frequency[late] * np.diff(times, prepend=0.0))[:, None] * way
pixels = np.cumsum(steps, axis=0) / MPP * [1.0, -1.0] + 500.0
pixels += 0.5 * random.standard_normal(pixels.shape)

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "roller.csv"
    table = np.column_stack([times, pixels, frequency, heading - np.pi / 2])
    header = "t_s,x_px,y_px,freq_hz,alpha_rad"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6f")
    recording = read_recording(path, Reading(mpp=MPP, heading_offset=np.pi / 2))

found = quality(recording)
run = found.runs[0]
print(f"{labels(recording)[0]}, {run.samples} rows at {run.clock.rate:.1f} Hz")
print(f"scatter of a row {run.scatter:.3f} um, given 0.5 px = {0.5 * MPP:.3f} um")
for speed in run.speeds:
    print(f"{speed.frequency:4.1f} Hz: {speed.median:5.1f} um/s")
print("what a fit cannot tell:", run.warnings or "nothing of gain, drift and delay")

figure = recording_figure(recording, found).draw()
