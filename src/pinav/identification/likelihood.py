r"""Evidence of a candidate: the filter's likelihood with gain and drift profiled.

$$-\log Z(\theta) = \tfrac12 |r|^2 + \sum \log S + n \log 2\pi + \tfrac{k}{2} \log 2n$$

with r the whitened residuals of both axes after least squares, S the variances of the
n innovations, k coefficients whose priors hold the information of one observation, and
normal priors of the nonlinear parameters $\theta$.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from pinav.identification.drive import AbstractDrive, drive_of, is_open
from pinav.identification.kalman import (
    Disturbance,
    Innovations,
    innovations,
    transitions,
)
from pinav.identification.parameters import (
    BLOCK_NOISE,
    DISTURBANCE,
    DRIFT,
    GAIN,
    NOISE_PLACES,
    Parameter,
)
from pinav.identification.tracks import Blocks
from pinav.systems import System, WanderingVelocity


def disturbance_of(theta: Float[Array, " parameter"]) -> Disturbance:
    """The noise at these coordinates."""
    number = {path: jnp.exp(theta[place]) for path, place in NOISE_PLACES.items()}
    wandering = {
        field.name: number[f"wandering.{field.name}"]
        for field in dataclasses.fields(WanderingVelocity)
    }
    return Disturbance(
        WanderingVelocity(**wandering),
        gain_wander=number["wander of the gain"],
        gain_memory=number["memory of the gain"],
        noise=number[BLOCK_NOISE],
    )


def in_plane(vectors: Float[Array, "*shape 2"]) -> Complex[Array, "*shape"]:
    """Vectors of the plane as complex numbers."""
    return jax.lax.complex(vectors[..., 0], vectors[..., 1])


def apart(points: Complex[Array, " row *column"]) -> Float[Array, " twice *column"]:
    """Complex numbers as real ones: x of all, and then y of all."""
    return jnp.concatenate([points.real, points.imag])


def rolling_about(frequency: Float[Array, " block"]) -> Float[Array, " step"]:
    """Highest frequency from one block before each step to one block after it.

    When a robot starts or stops it does so within a delay that the logs do not fix; a
    disturbance as small as at rest would make that moment the most exact of data.
    """
    padded = jnp.concatenate([frequency[:1], frequency, frequency[-1:]])
    steps = frequency.shape[0] - 1
    return jnp.max(jnp.stack([padded[i : i + steps] for i in range(4)]), axis=0)


class Regressors(NamedTuple):
    """Means over the blocks of a track, and what a candidate makes of them.

    A tuple, which passes into a compiled program more quickly than a module does.

    Attributes:
        times: since the first sample [T]; zero in padding, as all of these.
        cycles: integral of the response along the heading, delayed and lagged.
        begins: 1 where a segment begins with the block.
        gains: gain matrix by each number of an open gain, zero where absent.
        known: gain matrix that is not open; zero where it is.
        drifts: drift by each number of an open drift, zero where absent.
    """

    times: Float[Array, " block"]
    positions: Float[Array, "block 2"]
    frequency: Float[Array, " block"]
    cycles: Float[Array, "block 2"]
    counts: Float[Array, " block"]
    begins: Float[Array, " block"]
    gains: Float[Array, "4 2 2"]
    known: Float[Array, "2 2"]
    drifts: Float[Array, "2 2"]

    @property
    def steps_within(self) -> Float[Array, " step"]:
        """1 for each step within a segment."""
        present = (self.counts[1:] > 0).astype(self.counts.dtype)
        return present * (1 - self.begins[1:])

    def filter(self, theta: Array, columns: Complex[Array, "block _"]) -> Innovations:
        """Innovations of columns given at each block, x + iy, at this noise."""
        disturbance = disturbance_of(theta)
        # Between segments any positive step does: the filter begins anew there.
        steps = jnp.where(self.steps_within > 0, jnp.diff(self.times), 1.0)
        strength = disturbance.wandering.strength(rolling_about(self.frequency))
        cycles = jnp.diff(in_plane(self.cycles))
        transition = transitions(steps, strength, disturbance, cycles)
        present = (self.counts > 0).astype(self.times.dtype)
        return innovations(columns, present, self.begins, transition, disturbance.noise)

    def combine(
        self, columns: Complex[Array, "*shape 3"]
    ) -> Complex[Array, "*shape coefficient"]:
        """Column of each coefficient, from those along x, along y and of time."""
        gains = in_plane(jnp.swapaxes(self.gains, 1, 2))
        drifts = in_plane(self.drifts)
        by_gain = columns[..., :2] @ gains.T
        return jnp.concatenate([by_gain, columns[..., 2:] @ drifts[None]], axis=-1)


class CommandedPath(NamedTuple):
    """The path that the commands ask for, with its derivatives."""

    cycles: Float[Array, "block 2"]
    slopes: Float[Array, "block 2 parameter"]


class Design(eqx.Module):
    """A track as a candidate sees it, as arrays.

    Attributes:
        still: the regressors before the commands move anything.
    """

    blocks: Blocks
    still: Regressors
    drive: AbstractDrive

    @classmethod
    def of(cls, system: System, blocks: Blocks) -> "Design":
        """The design of the gain and drift that a system leaves open."""
        drive = drive_of(system.swimmer, system.learn)
        gains = float(is_open(system, GAIN)) * drive.basis
        elapsed = (blocks.times - blocks.times[0])[:, None]
        samples = [elapsed, blocks.positions, blocks.frequency[:, None]]
        means = jnp.asarray(blocks.means(np.concatenate(samples, axis=1)))
        still = Regressors(
            times=means[:, 0],
            positions=means[:, 1:3],
            frequency=means[:, 3],
            cycles=jnp.zeros_like(means[:, 1:3]),
            counts=jnp.asarray(blocks.counts),
            begins=jnp.asarray(blocks.begins),
            gains=gains,
            known=jnp.where(jnp.any(gains != 0), 0.0, drive.gain),
            drifts=float(is_open(system, DRIFT)) * jnp.eye(2),
        )
        return cls(jax.tree.map(jnp.asarray, blocks), still, drive)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All nonlinear parameters, in the order of their vector."""
        return (*self.drive.parameters, *DISTURBANCE)

    def commanded_path(
        self, theta: Float[Array | np.ndarray, " parameter"]
    ) -> CommandedPath:
        """The path at these parameters, those of the noise left out or not."""
        return _commanded_path(
            theta[: len(self.drive.parameters)], self.blocks, self.drive
        )

    def regressors(self, theta: Float[Array, " parameter"]) -> Regressors:
        """All regressors at these parameters of the response."""
        return self.still._replace(cycles=self.commanded_path(theta).cycles)


@eqx.filter_jit
def _commanded_path(
    coordinates: Float[Array | np.ndarray, " parameter"],
    blocks: Blocks,
    drive: AbstractDrive,
) -> CommandedPath:
    def cycles(coordinates: Array) -> Float[Array, "block 2"]:
        return block_means(drive.displacements(coordinates, blocks), blocks)

    value, push = jax.linearize(cycles, jnp.asarray(coordinates))
    slopes = jax.vmap(push, out_axes=-1)(jnp.eye(len(coordinates)))
    return CommandedPath(value, slopes)


class Field(eqx.Module):
    """Mean displacements [L] of the blocks along the observed path by a field.

    Attributes:
        offset: displacement by all that is known [L].
        drift: known drift; zero where it is fitted.
    """

    columns: Float[Array, "block 2 weight"]
    offset: Float[Array, "block 2"]
    drift: Float[Array, "2"]

    @classmethod
    def nothing(cls, blocks: Blocks | Regressors) -> "Field":
        """No field, and nothing known."""
        count = len(blocks.counts)
        return cls(
            columns=jnp.zeros((count, 2, 0)),
            offset=jnp.zeros((count, 2)),
            drift=jnp.zeros(2),
        )


UNDETERMINED = 1e-8
"""Information about every gain and drift, in parts of the greatest that the data have
of one: a heading that turns by less than a ten-thousandth of a radian determines one
direction only, and the gain across it stays at zero. What data determine is shifted
by a hundred-millionth of itself."""


class Whitened(eqx.Module):
    """The least-squares problem after filtering; numbers are those of one axis.

    Attributes:
        rows: columns of gains and then drifts; zero where absent.
        log_variance: sum over the innovations.
        count: number of innovations.
    """

    rows: Float[Array, "row coefficient"]
    field: Float[Array, "row weight"]
    target: Float[Array, " row"]
    log_variance: Float[Array, ""]
    count: Float[Array, ""]

    @property
    def information(self) -> Float[Array, "k k"]:
        """Information of the coefficients; 1 on the diagonal where absent.

        A heading that never changes makes the columns of two gains proportional and the
        information of their difference zero. `UNDETERMINED` of that of the better known
        one, the same for both, keeps the gain that nothing tells at zero; in parts of
        its own column it would be as large as that column is small.
        """
        information = self.rows.T @ self.rows
        diagonal = jnp.diagonal(information)
        # Gains and drifts have units of their own, and so a ridge of their own.
        gain, drift = diagonal[:4].max(), diagonal[4:].max()
        greatest = jnp.concatenate([jnp.full(4, gain), jnp.full(2, drift)])
        ridge = jnp.where(diagonal == 0, 1.0, UNDETERMINED * greatest)
        return information + jnp.diag(ridge)

    def solve(self, right: Array) -> Array:
        """The inverse of the information, applied."""
        return jnp.linalg.solve(self.information, right)


def block_means(values: Array, blocks: Blocks) -> Array:
    """Means over the samples of each block; zero in padding."""
    total = jnp.zeros((blocks.counts.shape[0], values.shape[1]))
    # Padding belongs to block 0 and adds nothing there.
    total = total.at[blocks.block].add(jnp.where(blocks.real[:, None], values, 0.0))
    return total / jnp.maximum(blocks.counts, 1.0)[:, None]


def path_displacement(
    velocity: Callable[[Any, Any], Array], blocks: Blocks
) -> Float[Array, "block 2"]:
    """Block means of a velocity field integrated along the observed path."""
    rates = jax.vmap(velocity)(blocks.times, blocks.positions)
    middle = (rates[1:] + rates[:-1]) / 2
    # Leaps between segments add a constant, which the filter forgets at each begin.
    steps = middle * jnp.diff(blocks.times)[:, None]
    path = jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(steps, axis=0)])
    return block_means(path, blocks)


@eqx.filter_jit
def whiten(
    theta: Float[Array, " parameter"],
    regressors: Regressors,
    field: Field | None = None,
) -> Whitened:
    """Filter observations and regressors of a candidate, and those of a field."""
    along, elapsed = regressors.cycles, regressors.times[:, None]
    field = Field.nothing(regressors) if field is None else field
    # What is known is taken from the positions before they are filtered.
    known = along @ regressors.known.T + elapsed * field.drift[None] + field.offset
    observed = in_plane(regressors.positions - known)
    weights = in_plane(jnp.swapaxes(field.columns, 1, 2))
    given = jnp.concatenate([along, elapsed], axis=1).astype(weights.dtype)
    columns = jnp.concatenate([observed[:, None], given, weights], axis=1)
    filtered = regressors.filter(theta, columns)
    rows = regressors.combine(filtered.columns[:, 1:4])
    return Whitened(
        rows=apart(rows),
        field=apart(filtered.columns[:, 4:]),
        target=apart(filtered.columns[:, 0]),
        log_variance=jnp.sum(filtered.log_variance),
        count=jnp.sum(regressors.steps_within),
    )


def evidence_and_coefficients(
    theta: Float[Array, " parameter"],
    regressors: Regressors,
    field: Field | None = None,
) -> tuple[Float[Array, ""], tuple[Float[Array, " coefficient"], Float[Array, "k k"]]]:
    r"""Negative log evidence without the parameters' priors, and the best coefficients.

    Weights of a field, of unit prior variance each, are integrated out: once the
    coefficients are projected out, the whitened targets y have the covariance
    $1 + A A^\top$.
    """
    problem = whiten(theta, regressors, field)
    best = problem.solve(problem.rows.T @ problem.target)
    # Absent coefficients have zero columns and cost nothing.
    present = jnp.sum(jnp.any(problem.rows != 0, axis=0).astype(theta.dtype))
    constant = (
        problem.log_variance
        + problem.count * jnp.log(2 * jnp.pi)
        + 0.5 * present * jnp.log(2 * problem.count)
    )
    residuals = problem.target - problem.rows @ best
    columns = problem.field
    if not columns.shape[1]:
        return 0.5 * residuals @ residuals + constant, (best, problem.information)
    # The coefficients are profiled out of the field's columns, as out of the target.
    columns = columns - problem.rows @ problem.solve(problem.rows.T @ columns)
    # Woodbury's identity: the matrix is as large as the field has weights, not data.
    factor = jnp.linalg.cholesky(jnp.eye(columns.shape[1]) + columns.T @ columns)
    explained = jax.scipy.linalg.solve_triangular(
        factor, columns.T @ residuals, lower=True
    )
    squares = residuals @ residuals - explained @ explained
    value = 0.5 * squares + jnp.sum(jnp.log(jnp.diagonal(factor))) + constant
    return value, (best, problem.information)


@jax.jit
def value_and_slope(
    theta: Float[Array | np.ndarray, " parameter"],
    path: CommandedPath,
    still: Regressors,
    field: Field | None = None,
) -> Any:
    """The negative log evidence with the coefficients, and its gradient.

    The path that the commands ask for is a program of its own, with its derivatives: a
    search that does not move the response does not compute it again. One program
    serves values and coefficients, as a second one would cost more than the gradients
    that it saves.
    """

    def value(theta: Array, cycles: Array) -> Any:
        return evidence_and_coefficients(theta, still._replace(cycles=cycles), field)

    both = jax.value_and_grad(value, argnums=(0, 1), has_aux=True)
    result, (slope, by_cycles) = both(jnp.asarray(theta), path.cycles)
    by_drive = jnp.einsum("ba,bap->p", by_cycles, path.slopes)
    return result, slope.at[: len(by_drive)].add(by_drive)
