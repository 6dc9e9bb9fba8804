r"""Evidence of a candidate: the filter's likelihood with gain and drift profiled.

$$-\log Z(\theta) = \tfrac12 |r|^2 + \sum \log S + n \log 2\pi + \tfrac{k}{2} \log 2n$$

with r the whitened residuals of both axes after least squares, S the variances of the
n innovations, k coefficients whose priors hold the information of one observation, and
normal priors of the nonlinear parameters $\theta$.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Int

from pinav.actuation import HeldProgramme
from pinav.identification.blocks_filter import (
    Drive,
    apart,
    in_plane,
    innovations_of_columns,
    steps_within,
)
from pinav.identification.models import (
    COMMAND_RESPONSE,
    RESPONSES,
    CandidateModel,
    SwitchedResponse,
)
from pinav.identification.tracks import Blocks


class Design(eqx.Module):
    """What a candidate makes of a track, as arrays.

    Attributes:
        blocks: the track.
        gains: gain matrices, zero where absent.
        drifts: drift velocities, zero where absent.
        response: place in `RESPONSES`.
    """

    blocks: Blocks
    gains: Float[Array, "4 2 2"]
    drifts: Float[Array, "2 2"]
    response: Int[Array, ""]

    @classmethod
    def of(cls, candidate: CandidateModel, blocks: Blocks) -> "Design":
        """The design of a candidate."""
        return cls(
            jax.tree.map(jnp.asarray, blocks),
            jnp.asarray(candidate.matrices()),
            jnp.asarray(candidate.velocities()),
            jnp.asarray(RESPONSES.index(candidate.response)),
        )

    def combine(
        self, columns: Complex[Array, "*shape 3"]
    ) -> Complex[Array, "*shape coefficient"]:
        """What each coefficient makes of columns along x, along y and of time."""
        gains = in_plane(jnp.swapaxes(self.gains, 1, 2))
        drifts = in_plane(self.drifts)
        by_gain = columns[..., :2] @ gains.T
        return jnp.concatenate([by_gain, columns[..., 2:] @ drifts[None]], axis=-1)


class Field(eqx.Module):
    """Displacements along the observed path by a field, and by what is known.

    Attributes:
        columns: mean displacement in each block for each weight of the field [L].
        offset: displacement that belongs to no weight [L].
        gain: a gain matrix that is known; zero where it is fitted.
        drift: a drift that is known; zero where it is fitted.
    """

    columns: Float[Array, "block 2 weight"]
    offset: Float[Array, "block 2"]
    gain: Float[Array, "2 2"]
    drift: Float[Array, "2"]

    @classmethod
    def nothing(cls, blocks: Blocks) -> "Field":
        """No field, and nothing known."""
        count = len(blocks.counts)
        return cls(
            columns=jnp.zeros((count, 2, 0)),
            offset=jnp.zeros((count, 2)),
            gain=jnp.zeros((2, 2)),
            drift=jnp.zeros(2),
        )


UNDETERMINED = 1e-8
"""Information about every gain and drift, in parts of the greatest that the data have
of one: a heading that turns by less than a ten-thousandth of a radian determines one
direction only, and the gain across it stays at zero. What data determine is shifted
by a hundred-millionth of itself."""


class Whitened(eqx.Module):
    """The least-squares problem that the filter leaves.

    Attributes:
        rows: of the coefficients, gains before drifts; zero columns where absent.
        field: of the weights of a field.
        target: of the observed positions, x above y.
        log_variance: sum over the innovations of one axis.
        count: number of innovations of one axis.
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

    def coefficients(self) -> tuple[Float[Array, " coefficient"], Float[Array, "k k"]]:
        """Best coefficients and their information."""
        return self.solve(self.rows.T @ self.target), self.information


def displacements(theta: Array, design: Design) -> Float[Array, "sample 2"]:
    """Integral of the response along the heading, delayed and lagged [cycles]."""
    return _displacements(theta[: len(COMMAND_RESPONSE)], design)


@eqx.filter_custom_vjp
def _displacements(drive: Array, design: Design) -> Array:
    return jax.lax.cond(_lags(drive), _lag_response, _follow_at_once, drive, design)


@_displacements.def_fwd
def _displacements_forward(
    perturbed: Any, drive: Array, design: Design
) -> tuple[Array, None]:
    del perturbed
    return _displacements(drive, design), None


@_displacements.def_bwd
def _displacements_reverse(
    residuals: None, cotangent: Array, perturbed: Any, drive: Array, design: Design
) -> Array:
    """Differentiates the branch that was taken, without room for the other one.

    Without a lag in forward mode: few parameters stand before thousands of samples.
    """
    del residuals, perturbed

    def lagged(drive: Array, cotangent: Array) -> Array:
        return jax.vjp(lambda d: _lag_response(d, design), drive)[1](cotangent)[0]

    def prompt(drive: Array, cotangent: Array) -> Array:
        # Four parameters and a path: forward derivatives are cheaper than to go back
        # through the whole integral.
        jacobian = jax.jacfwd(lambda d: _follow_at_once(d, design))(drive)
        return jnp.einsum("sa,sad->d", cotangent, jacobian)

    return jax.lax.cond(_lags(drive), lagged, prompt, drive, cotangent)


def _lags(drive: Array) -> Array:
    return jnp.exp(drive[3]) > 2e-4


def _lag_response(drive: Array, design: Design) -> Array:
    programme, response, ts = _programme_of(drive, design)
    return programme.lagged_integral(response, ts, jnp.exp(drive[3]))


def _follow_at_once(drive: Array, design: Design) -> Array:
    programme, response, ts = _programme_of(drive, design)
    return programme.integral(response, ts)


def _programme_of(
    drive: Array, design: Design
) -> tuple[HeldProgramme, SwitchedResponse, Array]:
    blocks: Any = design.blocks  # as JAX arrays
    programme = HeldProgramme(blocks.times, blocks.frequency, blocks.heading)
    response = SwitchedResponse(design.response, drive[0], drive[1])
    return programme, response, blocks.times - drive[2]


def block_means(values: Array, blocks: Blocks) -> Array:
    """Means over the samples of each block; zero in padding."""
    total = jnp.zeros((blocks.counts.shape[0], values.shape[1]))
    # Padding belongs to block 0 and adds nothing there.
    total = total.at[blocks.block].add(jnp.where(blocks.real[:, None], values, 0.0))
    return total / jnp.maximum(blocks.counts, 1.0)[:, None]


def whiten(
    theta: Float[Array, " parameter"], design: Design, field: Field | None = None
) -> Whitened:
    """Filter observations and regressors of a candidate, and those of a field."""
    blocks = design.blocks
    field = Field.nothing(blocks) if field is None else field
    along = displacements(theta, design)
    elapsed = (blocks.times - blocks.times[0])[:, None]
    # What is known is taken from the positions before they are filtered.
    known = along @ field.gain.T + elapsed * field.drift[None]
    samples = [blocks.positions - known, along, elapsed, blocks.frequency[:, None]]
    means = block_means(jnp.concatenate(samples, axis=-1), blocks)
    drive = Drive(means[:, 4], means[:, 5], in_plane(means[:, 2:4]))
    observed = in_plane(means[:, :2] - field.offset)
    weights = in_plane(jnp.swapaxes(field.columns, 1, 2))
    given = means[:, 2:5].astype(weights.dtype)
    columns = jnp.concatenate([observed[:, None], given, weights], axis=1)
    filtered = innovations_of_columns(theta, columns, drive, blocks)
    rows = design.combine(filtered.columns[:, 1:4])
    return Whitened(
        rows=apart(rows),
        field=apart(filtered.columns[:, 4:]),
        target=apart(filtered.columns[:, 0]),
        log_variance=jnp.sum(filtered.log_variance),
        count=jnp.sum(steps_within(blocks)),
    )


@eqx.filter_jit
def drive_of(theta: Float[Array, " parameter"], design: Design) -> Drive:
    """The drive of a candidate on a track."""
    blocks = design.blocks
    rest = jnp.stack([blocks.times, blocks.frequency], axis=-1)
    samples = jnp.concatenate([rest, displacements(theta, design)], axis=-1)
    means = block_means(samples, blocks)
    return Drive(means[:, 0], means[:, 1], in_plane(means[:, 2:]))


def evidence_and_coefficients(
    theta: Float[Array, " parameter"],
    design: Design,
    field: Field | None = None,
) -> tuple[Float[Array, ""], tuple[Float[Array, " coefficient"], Float[Array, "k k"]]]:
    r"""Negative log evidence, without the priors of the nonlinear parameters.

    Weights of a field, of unit prior variance each, are integrated out: once the
    coefficients are projected out, the whitened targets y have the covariance
    $1 + A A^\top$.

    Args:
        theta: nonlinear parameters.
        design: the track, as the candidate sees it.
        field: displacements by a field; none unless given.

    Returns:
        It, and the best coefficients with their information, a field left out.
    """
    problem = whiten(theta, design, field)
    best, information = problem.coefficients()
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
        return 0.5 * residuals @ residuals + constant, (best, information)
    # The coefficients are profiled out of the field's columns, as out of the target.
    columns = columns - problem.rows @ problem.solve(problem.rows.T @ columns)
    # Woodbury's identity: the matrix is as large as the field has weights, not data.
    factor = jnp.linalg.cholesky(jnp.eye(columns.shape[1]) + columns.T @ columns)
    explained = jax.scipy.linalg.solve_triangular(
        factor, columns.T @ residuals, lower=True
    )
    squares = residuals @ residuals - explained @ explained
    value = 0.5 * squares + jnp.sum(jnp.log(jnp.diagonal(factor))) + constant
    return value, (best, information)


value_and_slope = eqx.filter_jit(
    eqx.filter_value_and_grad(evidence_and_coefficients, has_aux=True)
)
"""The negative log evidence with the coefficients, and its gradient, compiled once for
each size of track: a second program for the coefficients alone costs more than the
gradients that it saves."""


compiled_whiten = eqx.filter_jit(whiten)
"""The least-squares problem, compiled."""
