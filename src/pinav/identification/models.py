"""The candidates: what of the first-order swimmer is free, as values.

All candidates are one model with other free parameters, so that one compiled likelihood
serves them all, and evidence and errors can be compared.
"""

import math
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.actuation import (
    AbstractResponse,
    LinearResponse,
    SaturatingResponse,
    SlippingResponse,
    StepOutResponse,
)
from pinav.arguments import Scalar

NOISE = ("log_still", "log_driven", "log_memory", "log_noise")
"""Parameters of the noise, free in every candidate."""

COMMAND_RESPONSE = ("log_corner", "logit_residual", "delay", "log_lag")
"""Parameters of the drive."""

SLOW_DRIFT = ("log_slow", "log_slow_memory")
"""Parameters of a drift that changes."""

WANDERING_GAIN = ("log_gain_wander", "log_gain_memory")
"""Parameters of a gain that wanders."""

NAMES = (*COMMAND_RESPONSE, *NOISE, *SLOW_DRIFT, *WANDERING_GAIN)
"""All nonlinear parameters, in their order."""

ABSENT = {
    "log_corner": 0.0,
    "logit_residual": 0.0,
    "delay": 0.0,
    "log_lag": math.log(1e-9),
    "log_slow": math.log(1e-9),
    "log_slow_memory": math.log(60.0),
    "log_gain_wander": math.log(1e-9),
    "log_gain_memory": math.log(60.0),
}
"""Values of parameters that a candidate has not."""


class CandidateModel(eqx.Module):
    r"""One model of the selection.

    Attributes:
        name: in tables.
        gains: matrices of which the gain is a combination; none means no propulsion.
        drifts: velocities of which the drift is a combination.
        response: a name in `RESPONSES`.
        free: nonlinear parameters that are learned, beside those of the noise.
        fixed: values of parameters that are not 0 or absent although not learned.
    """

    name: str = eqx.field(static=True)
    gains: tuple[tuple[tuple[float, float], tuple[float, float]], ...] = eqx.field(
        static=True, default=()
    )
    drifts: tuple[tuple[float, float], ...] = eqx.field(static=True, default=())
    response: str = eqx.field(static=True, default="linear")
    free: tuple[str, ...] = eqx.field(static=True, default=())
    fixed: Mapping[str, float] = eqx.field(static=True, default_factory=dict)

    @property
    def learned(self) -> tuple[str, ...]:
        """Nonlinear parameters that are learned, in the order of `NAMES`."""
        return tuple(name for name in NAMES if name in (*NOISE, *self.free))

    @property
    def num_linear(self) -> int:
        """Number of coefficients of gain and drift."""
        return len(self.gains) + len(self.drifts)

    def matrices(self) -> Float[np.ndarray, "4 2 2"]:
        """The gain matrices, with zeros for those that are absent."""
        matrices = np.zeros((4, 2, 2))
        if self.gains:
            matrices[: len(self.gains)] = self.gains
        return matrices

    def velocities(self) -> Float[np.ndarray, "2 2"]:
        """The drift velocities, with zeros for those that are absent."""
        velocities = np.zeros((2, 2))
        if self.drifts:
            velocities[: len(self.drifts)] = self.drifts
        return velocities


ISOTROPIC = (((1.0, 0.0), (0.0, 1.0)),)
DIAGONAL = (((1.0, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.0, 1.0)))
FULL = (*DIAGONAL, ((0.0, 1.0), (0.0, 0.0)), ((0.0, 0.0), (1.0, 0.0)))
"""Gains: a number; one for each axis; any matrix."""

BOTH = ((1.0, 0.0), (0.0, 1.0))
"""A drift in any direction."""

RESPONSES = ("linear", "saturating", "slipping", "step-out")
"""What becomes of the speed at high frequencies."""


def response_of(
    name: str, log_corner: Scalar = 0.0, logit_residual: Scalar = 0.0
) -> AbstractResponse:
    """The response of a candidate with its parameters."""
    values = jnp.asarray(log_corner), jnp.asarray(logit_residual)
    return _RESPONSES[RESPONSES.index(name)](*values)


_RESPONSES = (
    lambda corner, residual: LinearResponse(),
    lambda corner, residual: SaturatingResponse(jnp.exp(corner)),
    lambda corner, residual: SlippingResponse(
        jnp.exp(corner), jax.nn.sigmoid(residual)
    ),
    lambda corner, residual: StepOutResponse(jnp.exp(corner)),
)


class SwitchedResponse(AbstractResponse):
    """Any of the responses, by a number that may be traced: one compilation for all.

    Attributes:
        index: place in `RESPONSES`.
        log_corner: logarithm of the corner frequency [Hz].
        logit_residual: of the part of the gain that remains above it.
    """

    index: Int[Array, ""]
    log_corner: Float[Array, ""]
    logit_residual: Float[Array, ""]

    def __call__(self, frequency: Array) -> Array:
        branches = [lambda f, a, b, make=make: make(a, b)(f) for make in _RESPONSES]
        return jax.lax.switch(
            self.index, branches, frequency, self.log_corner, self.logit_residual
        )


CORNERS = {
    "linear": (),
    "saturating": ("log_corner",),
    "slipping": ("log_corner", "logit_residual"),
    "step-out": ("log_corner",),
}
"""Parameters of each response."""

DRIFT_ONLY = CandidateModel("drift only", drifts=BOTH)
SCALAR = CandidateModel("scalar gain", gains=ISOTROPIC)
MATRIX = CandidateModel("gain matrix and drift", gains=FULL, drifts=BOTH)


def with_response(candidate: CandidateModel, response: str) -> CandidateModel:
    """The candidate with another response, whose parameters are learned."""
    free = tuple(
        name for name in candidate.free if name not in ("log_corner", "logit_residual")
    )
    return CandidateModel(
        f"{candidate.name} + {response}" if response != "linear" else candidate.name,
        candidate.gains,
        candidate.drifts,
        response,
        (*CORNERS[response], *free),
        candidate.fixed,
    )


def with_free(candidate: CandidateModel, label: str, *names: str) -> CandidateModel:
    """The candidate with further nonlinear parameters learned, such as `delay`."""
    return CandidateModel(
        f"{candidate.name} + {label}",
        candidate.gains,
        candidate.drifts,
        candidate.response,
        (*candidate.free, *names),
        candidate.fixed,
    )


def like(
    base: CandidateModel, other: CandidateModel, *, without: Sequence[str] = ()
) -> CandidateModel:
    """A candidate with the gains and drifts of one and all else of another.

    Args:
        base: whose gains and drifts these are.
        other: whose response and free parameters these are.
        without: parameters that are not free; without the corner the law is linear.

    Returns:
        The base itself where nothing is added to it.
    """
    free = tuple(name for name in other.free if name not in without)
    response = other.response if set(CORNERS[other.response]) <= set(free) else "linear"
    if response == "linear" and not free:
        return base
    return CandidateModel(
        f"{base.name}, else as chosen",
        base.gains,
        base.drifts,
        response,
        free,
        other.fixed,
    )
