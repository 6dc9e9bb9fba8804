"""Displacements by the commands of a swimmer, whatever drives it.

A rolling propulsion is linear in its gain, and one compiled program serves all of its
responses. Any other propulsion is driven by its own `drive_by`; the open numbers of it
are parameters of the search.
"""

import abc
import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav import actuation
from pinav.dynamics import OverdampedSwimmer, Swimmer, drive_by_arrays
from pinav.errors import InputError
from pinav.fitting import Estimate, EvidenceFit
from pinav.forces import (
    AbstractCommandedForce,
    RollingPropulsion,
    ZeroFlow,
    ZeroForce,
    tensor_matrix,
)
from pinav.identification.parameters import (
    ROLLING,
    Parameter,
    Scale,
)
from pinav.identification.tracks import Blocks
from pinav.systems import FreeNumber, LogNormal, Normal, System

RESPONSES: dict[str, actuation.AbstractResponse] = {
    "linear": actuation.LinearResponse(),
    "saturating": actuation.SaturatingResponse(1.0),
    "slipping": actuation.SlippingResponse(1.0, 0.5),
    "step-out": actuation.StepOutResponse(1.0),
}
"""Responses to high frequencies, with placeholders for their numbers."""


AnySwimmer = Swimmer | OverdampedSwimmer
"""Swimmer of a system, which may have inertia that no drive allows for."""


def response_name(swimmer: AnySwimmer) -> str:
    """Name of the response of a swimmer among `RESPONSES`; linear if it rolls not."""
    kind = type(getattr(swimmer.propulsion, "response", RESPONSES["linear"]))
    return next(name for name, made in RESPONSES.items() if type(made) is kind)


class AbstractDrive(eqx.Module):
    """Displacements of a swimmer as a function of the numbers of its propulsion.

    Attributes:
        parameters: the numbers in which displacements are not linear.
        gain: matrix that makes lengths of displacements.
        basis: gain by each number of it, zero where there are fewer.
    """

    parameters: eqx.AbstractVar[tuple[Parameter, ...]]
    gain: eqx.AbstractVar[Float[Array, "2 2"]]
    basis: eqx.AbstractVar[Float[Array, "4 2 2"]]

    @abc.abstractmethod
    def displacements(
        self, coordinates: Float[Array, " parameter"], blocks: Blocks
    ) -> Float[Array, "sample 2"]:
        """Displacement since the first sample of a track, for a gain of 1."""


def drive_of(swimmer: AnySwimmer, learn: Sequence[FreeNumber] = ()) -> AbstractDrive:
    """The drive of a swimmer, of which these numbers are open."""
    assert isinstance(swimmer, OverdampedSwimmer)
    if isinstance(swimmer.propulsion, RollingPropulsion | ZeroForce):
        return RollingDrive.of(swimmer)
    return OtherDrive.of(swimmer, learn)


def gain_of(swimmer: AnySwimmer) -> Float[np.ndarray, "2 2"] | None:
    """Gain matrix of a swimmer [L per cycle]; None where it does not roll."""
    propulsion = swimmer.propulsion
    if not isinstance(propulsion, RollingPropulsion):
        return None
    return np.asarray(propulsion.matrix, float)


def drive_numbers(fit: EvidenceFit) -> tuple[FreeNumber, ...]:
    """The learned numbers of a drive, with what a fit says of them."""
    rolls = gain_of(fit.model) is not None
    known = {parameter.path: parameter.scale for parameter in ROLLING}
    return tuple(
        FreeNumber(path, _prior(estimate, known.get(path, Scale.PLAIN)))
        for path, estimate in fit.constants.items()
        if (path in known if rolls else path.startswith("propulsion."))
    )


def _prior(estimate: Estimate, scale: Scale) -> Normal | LogNormal:
    value, sd = estimate.value, estimate.sd
    if scale is Scale.LOG:
        return LogNormal(median=value, deviation=max(sd / value, 1e-6))
    return Normal(mean=value, deviation=max(sd, 1e-6))


class RollingDrive(AbstractDrive):
    """The drive of a rolling propulsion, or of none [cycles].

    A swimmer without a lag has one that is too short to matter: one program for all.
    """

    response: Int[Array, ""]
    gain: Float[Array, "2 2"]
    basis: Float[Array, "4 2 2"]
    parameters: tuple[Parameter, ...] = eqx.field(static=True, default=ROLLING)

    @classmethod
    def of(cls, swimmer: OverdampedSwimmer) -> "RollingDrive":
        """The drive of a swimmer."""
        gain, basis = np.zeros((2, 2)), np.zeros((4, 2, 2))
        if (known := gain_of(swimmer)) is not None:
            propulsion: Any = swimmer.propulsion
            numbers = gain_basis(np.ndim(propulsion.gain))
            gain, basis[: len(numbers)] = known, numbers
        # The propulsion is a force: what the gain moves passes through the mobility.
        mobility = tensor_matrix(swimmer.mobility, jnp.zeros(2))
        place = list(RESPONSES).index(response_name(swimmer))
        return cls(
            response=jnp.asarray(place), gain=mobility @ gain, basis=mobility @ basis
        )

    def displacements(
        self, coordinates: Float[Array, "4"], blocks: Blocks
    ) -> Float[Array, "sample 2"]:
        along: Any = blocks  # as JAX arrays
        programme = actuation.HeldProgramme(along.times, along.frequency, along.heading)
        corner, residual, delay, lag = coordinates
        response = SwitchedResponse(self.response, corner, residual)
        times = programme.times - delay
        return programme.lagged_integral(response, times, jnp.exp(lag))


def is_open(system: System, path: str) -> bool:
    """True where a system leaves a number open."""
    return any(number.path == path for number in system.learn)


def gain_basis(ndim: int) -> Float[np.ndarray, "number 2 2"]:
    """Gain matrix by each number of a gain: one, one for each axis, or a matrix."""
    if ndim == 2:
        return np.eye(4).reshape(4, 2, 2)
    axes = np.array([np.diag([1.0, 0.0]), np.diag([0.0, 1.0])])
    return axes if ndim else axes.sum(axis=0, keepdims=True)


class SwitchedResponse(actuation.AbstractResponse):
    """Any of the responses, by a number that may be traced: one compilation for all.

    Attributes:
        log_corner: logarithm of the corner frequency [Hz].
        logit_residual: logit of the part of the gain that remains above it.
    """

    index: Int[Array, ""]
    log_corner: Float[Array, ""]
    logit_residual: Float[Array, ""]

    def __call__(self, frequency: Array) -> Array:
        numbers = {
            "corner": jnp.exp(self.log_corner),
            "residual": jax.nn.sigmoid(self.logit_residual),
        }
        branches = []
        for made in RESPONSES.values():
            has = {name: numbers[name] for name in numbers if hasattr(made, name)}
            response = dataclasses.replace(made, **has)
            branches.append(lambda f, response=response: response(f))
        return jax.lax.switch(self.index, branches, frequency)


class OtherDrive(AbstractDrive):
    """The drive of any propulsion [L], by the force that its commands make of it.

    Its numbers have the priors of the system: nothing else is known of their scales.
    """

    swimmer: OverdampedSwimmer
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    gain: Float[Array, "2 2"]
    basis: Float[Array, "4 2 2"]

    @classmethod
    def of(
        cls, swimmer: OverdampedSwimmer, learn: Sequence[FreeNumber]
    ) -> "OtherDrive":
        """The drive of a swimmer, of which these numbers are open."""
        numbers = [n for n in learn if n.path.startswith("propulsion.")]
        parameters = tuple(_parameter(number, swimmer) for number in numbers)
        propulsion = swimmer.propulsion
        if isinstance(propulsion, AbstractCommandedForce):
            # A programme runs on the clock of a trajectory, not on that of the track.
            propulsion = dataclasses.replace(propulsion, programme=None)
        swimmer = eqx.tree_at(
            lambda s: (s.propulsion, s.environment, s.known_force, s.flow),
            swimmer,
            (propulsion, ZeroForce(), ZeroForce(), ZeroFlow()),
        )
        return cls(
            swimmer=swimmer,
            parameters=parameters,
            gain=jnp.eye(2),
            basis=jnp.zeros((4, 2, 2)),
        )

    def displacements(
        self, coordinates: Float[Array, " parameter"], blocks: Blocks
    ) -> Float[Array, "sample 2"]:
        along: Any = blocks  # as JAX arrays
        swimmer = self.swimmer
        if self.parameters:
            numbers = [
                jnp.exp(at) if one.scale is Scale.LOG else at
                for one, at in zip(self.parameters, coordinates, strict=True)
            ]
            picks = [FreeNumber(one.path).pick for one in self.parameters]
            swimmer = eqx.tree_at(lambda s: [p(s) for p in picks], swimmer, numbers)
        commands = {"frequency": along.frequency, "heading": along.heading}
        driven = drive_by_arrays(swimmer, along.times, commands)
        jumps = getattr(driven.propulsion, "jumps", along.times)
        return integrate_between(driven, jumps, along.times, along.positions)


def _parameter(number: FreeNumber, swimmer: OverdampedSwimmer) -> Parameter:
    """An open number, in the coordinate in which its prior is normal."""
    prior, path = number.prior, number.path
    known = isinstance(prior, Normal | LogNormal)
    if np.ndim(number.pick(swimmer)) or not known:
        raise InputError(
            f"learn: expected a prior Normal or LogNormal of {path!r}, a single "
            "number, because beside commands nothing else tells its scale"
        )
    if isinstance(prior, LogNormal):
        wide = math.log(float(prior.median)), float(prior.deviation)
        return Parameter(path, path, prior=wide)
    wide = float(prior.mean), float(prior.deviation)
    return Parameter(path, path, scale=Scale.PLAIN, prior=wide)


def integrate_between(
    swimmer: OverdampedSwimmer,
    jumps: Float[Array, " jump"],
    times: Float[Array, " sample"],
    positions: Float[Array, "sample 2"],
) -> Float[Array, "sample 2"]:
    """Integral of a swimmer's velocity along a known path.

    By the midpoint rule between all times and jumps, so that a velocity that is held
    from one jump to the next is integrated exactly, and so are derivatives by a delay,
    which moves the jumps.
    """
    knots = jnp.sort(jnp.concatenate([times, jnp.clip(jumps, times[0], times[-1])]))
    middle = (knots[1:] + knots[:-1]) / 2
    places = jnp.stack([jnp.interp(middle, times, x) for x in positions.T], axis=1)
    velocity = jax.vmap(swimmer)(middle, places)
    steps = velocity * jnp.diff(knots)[:, None]
    path = jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps, axis=0)])
    return path[jnp.searchsorted(knots, times)]
