"""All scenarios.

Grey is the size of the environment's force at t = 0, lines are trajectories without
observation noise, dots their starts, sky blue the medium.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from docs.figures.workshop import Workshop
from jaxtyping import Array, Float, PRNGKeyArray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinav.arguments import State
from pinav.dynamics import BrownianSwimmer, FixedStep, rollout, sample_path
from pinav.figures.palette import BLACK, PLAIN, SKY, TRACK
from pinav.forces import BrinkmanTensor, InFlow, TensorDrag, UniaxialTensor
from pinav.scenarios import SCENARIOS, scenario
from pinav.systems import System


def paths(shown: System) -> np.ndarray:
    """Positions of all swimmers at the times of the scenario."""

    def one(y0: State, key: PRNGKeyArray) -> Float[Array, "time state"]:
        if isinstance(shown.truth, BrownianSwimmer):
            return sample_path(shown.truth, y0, shown.times, key=key, substeps=4).ys
        solver = FixedStep(substeps=2)
        return rollout(shown.truth, y0, shown.times, solver=solver).ys

    keys = jax.random.split(jax.random.key(1), len(shown.starts))
    return np.asarray(eqx.filter_jit(jax.vmap(one))(shown.starts, keys))[..., :2]


def draw(shown: System, ax: Axes) -> None:
    """One scenario."""
    lines = paths(shown)
    low, high = lines.min(axis=(0, 1)) - 1, lines.max(axis=(0, 1)) + 1
    side = (high - low).max() / 2
    low, high = (low + high) / 2 - side, (low + high) / 2 + side
    xs, ys = (jnp.linspace(a, b, 100) for a, b in zip(low, high, strict=True))
    grid = jnp.stack(jnp.meshgrid(xs, ys), axis=-1)
    truth = shown.truth
    swimmer = truth.swimmer if isinstance(truth, BrownianSwimmer) else truth
    force = jax.vmap(jax.vmap(lambda x: swimmer.environment(0.0, x, jnp.zeros(2))))
    size = jnp.linalg.norm(force(grid), axis=-1)
    ax.pcolormesh(xs, ys, size, cmap=PLAIN, vmax=1.6 * size.max(), rasterized=True)
    draw_medium(getattr(swimmer, "drag", None), grid, ax)
    for line in lines:
        ax.plot(*line.T, color=TRACK, lw=0.6)
    ax.plot(*lines[:, 0].T, ".", color=BLACK, ms=2)
    ax.set_aspect("equal")
    ax.set_title(shown.name, fontsize=6.5)
    ax.tick_params(labelsize=5.5, length=2, pad=1.5)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=3, integer=True))


def draw_medium(drag: Any, grid: Float[Array, "row column 2"], ax: Axes) -> None:
    """Contours of a porous medium, directors of a fibrous one, arrows of a flow."""
    x, y = np.asarray(grid[..., 0]), np.asarray(grid[..., 1])
    coarse = (slice(5, None, 10), slice(5, None, 10))
    look = {"color": SKY, "pivot": "mid", "width": 0.004, "alpha": 0.7}
    if isinstance(drag, TensorDrag) and isinstance(drag.tensor, BrinkmanTensor):
        value = jax.vmap(jax.vmap(drag.tensor.value))(grid)
        ax.contour(x, y, value, 3, colors=SKY, linewidths=0.6)
    elif isinstance(drag, TensorDrag) and isinstance(drag.tensor, UniaxialTensor):
        angle = jax.vmap(jax.vmap(drag.tensor.director))(grid[coarse])
        headless = {"headwidth": 0, "headlength": 0, "headaxislength": 0, "scale": 18}
        ax.quiver(
            x[coarse], y[coarse], np.cos(angle), np.sin(angle), **look, **headless
        )
    elif isinstance(drag, InFlow):
        flow = jax.vmap(jax.vmap(lambda x: drag.flow(0.0, x)))(grid[coarse])
        ax.quiver(x[coarse], y[coarse], flow[..., 0], flow[..., 1], **look)


def figure(workshop: Workshop) -> Figure:
    """All planar scenarios; no run is needed."""
    del workshop
    drawn = Figure(figsize=(5.0, 5.6), layout="constrained")
    systems = [system for name in SCENARIOS if (system := scenario(name)).dim == 2]
    for system, ax in zip(systems, drawn.subplots(4, 4).flat, strict=True):
        draw(system, ax)
    return drawn
