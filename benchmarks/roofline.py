"""What arithmetic would cost at best on this machine, beside what it costs.

Run with `python -m benchmarks roofline`. The machine is measured first: the rate of a
product of matrices and that of moving arrays. A piece of work with so many operations
on so many bytes cannot take less than the longer of both times. Operations and bytes
are counted by hand; each array counts once for each time that it cannot be in a cache.

References:
    Williams, Waterman and Patterson, Communications of the ACM 52, 65 (2009).
"""

from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, Float

from benchmarks._options import begin
from benchmarks.growth import WIDTH, crossings, iteration, num_weights
from benchmarks.heat import best_time, tumour
from pinav.commands.settings import Settings
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    Whitened,
    at_shape,
    shape_slope,
)
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.forces.priors import WeightPrior
from pinav.identification.kalman import Disturbance, innovations, transitions
from pinav.systems import WanderingVelocity
from pinav.thermal.bioheat import HeatBalance
from pinav.thermal.grids import CartesianGrid

BYTES = 8
"""Of a number."""


class Options(Settings, frozen=True):
    """Compare hot paths with what this machine could do at best."""


class Machine(msgspec.Struct, frozen=True):
    """What a machine does at best.

    Attributes:
        operations: of double precision in a second.
        traffic: bytes in a second, between memory and processor.
    """

    operations: float
    traffic: float

    @classmethod
    def measure(cls, side: int = 2000, length: int = 2**25) -> "Machine":
        """This one: by a product of matrices, and by a sum of two long arrays."""
        square, long = jnp.ones((side, side)), jnp.ones(length)
        multiply = jax.jit(lambda a: a @ a)
        add = jax.jit(lambda a, b: a + b)
        other = 2 * long
        return cls(
            2 * side**3 / best_time(lambda: multiply(square)),
            3 * BYTES * length / best_time(lambda: add(long, other)),
        )

    def least_time(self, work: "Work") -> float:
        """Time below which it cannot do that work [s]."""
        return max(work.operations / self.operations, work.moved / self.traffic)


class Work(msgspec.Struct, frozen=True):
    """A piece of work.

    Attributes:
        name: what people call it.
        operations: additions and multiplications.
        moved: bytes between memory and processor.
        seconds: that it takes.
    """

    name: str
    operations: float
    moved: float
    seconds: float

    def row(self, machine: Machine) -> str:
        """A line of the table."""
        least = machine.least_time(self)
        return (
            f"{self.name:<44}{1e-6 * self.operations:>10.2g}{1e-6 * self.moved:>10.2g}"
            f"{1e3 * least:>12.3g}{1e3 * self.seconds:>12.3g}"
            f"{100 * least / self.seconds:>9.2g} %"
        )


HEADER = (
    f"{'work':<44}{'Mflop':>10}{'MB':>10}{'at best ms':>12}{'taken ms':>12}"
    f"{'reached':>11}"
)


def main(argv: Sequence[str]) -> None:
    if begin(Options, argv, "roofline") is None:
        return
    machine = Machine.measure()
    print(
        f"this machine: {1e-9 * machine.operations:.3g} Gflop/s, "
        f"{1e-9 * machine.traffic:.3g} GB/s"
    )
    print(HEADER)
    for work in works():
        print(work.row(machine), flush=True)


def works(side: int = 64, kernels: int = 256, blocks: int = 1024) -> Iterator[Work]:
    """The hot paths.

    Args:
        side: cells of the box of bioheat, along each axis.
        kernels: whose evidence is computed.
        blocks: of a recording.
    """
    yield bioheat(side)
    yield evidence(kernels)
    yield recording(blocks)
    yield gauss_newton()


def bioheat(side: int) -> Work:
    """The rates of a box, of which a run evaluates five in each step."""
    model = tumour(CartesianGrid.cubes((side, side, side), 1e-3))
    balance, levels = HeatBalance.of(model), jnp.ones(1)
    temperature = 37.0 + jnp.zeros((side, side, side))
    rates = jax.jit(lambda at: balance.rates(at, levels).temperature)
    # Read: temperature, three conductances, heat, volumes, capacity and two shares of
    # perfusion; written: the rate. Each axis takes a difference, a product and a sum to
    # both sides, the law of perfusion of two tissues some twenty operations.
    return Work(
        f"rates of bioheat, {side}^3 cells",
        operations=(3 * 6 + 2 * 20 + 6) * side**3,
        moved=10 * BYTES * side**3,
        seconds=best_time(lambda: rates(temperature)),
    )


def evidence(count: int) -> Work:
    """The evidence of one shape of a prior, with its slope."""
    rng = np.random.default_rng(0)
    per_side = round(count**0.5)
    axis = np.arange(float(per_side))
    centers = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    prior, rows = WeightPrior(centers, 1.0), rng.normal(size=(2 * count, count))
    residuals = rng.normal(size=2 * count)
    data = LinearisedObservations.of(
        Quadratic(
            point=np.zeros(count),
            hessian=rows.T @ rows,
            gradient=rows.T @ residuals,
            squares=float(residuals @ residuals),
            num_free=2 * count,
            log_determinant=0.0,
        )
    )

    def evaluate() -> Float[np.ndarray, " shape"]:
        chosen = at_shape(data, prior.covariance, prior.start, 1.0)
        white = Whitened.of(data, prior.covariance(prior.start))
        return shape_slope(data, white, chosen, prior)

    # A search shares the whitened data between value and slope: here they are made
    # twice. In cubes of the number of kernels: a root 1/3, a product 2, an orthogonal
    # and a singular decomposition some 12, twice; the slope two products.
    return Work(
        f"evidence and its slope, {count} kernels",
        operations=(2 * (1 / 3 + 2 + 12) + 4) * count**3,
        moved=20 * BYTES * count**2,
        seconds=best_time(evaluate),
    )


def recording(blocks: int) -> Work:
    """The filter behind the likelihood of a recording, and its gradient."""
    rng = np.random.default_rng(0)
    columns = jnp.asarray(rng.normal(size=(blocks, 4)) + 1j)
    intervals, strength = jnp.full(blocks - 1, 0.5), jnp.ones(blocks - 1)
    begins = jnp.zeros(blocks).at[0].set(1.0)
    some = jnp.asarray([1.0, 0.5, 1.0, 0.1, 100.0, 0.1, 100.0, 0.1])

    def loss(theta: Float[Array, " parameter"]) -> Float[Array, ""]:
        disturbance = Disturbance(WanderingVelocity(*theta[:5]), *theta[5:])
        cycles = jnp.ones(blocks - 1, complex)
        step = transitions(intervals, strength, disturbance, cycles)
        out = innovations(columns, jnp.ones(blocks), begins, step, disturbance.noise)
        return jnp.sum(jnp.abs(out.columns) ** 2) + jnp.sum(out.log_variance)

    slope = jax.jit(jax.value_and_grad(loss))
    # A block: two products of complex matrices 4 x 4, one with four columns, and the
    # update, eight operations each; backwards as much again, and twice that.
    products = 3 * 4**3 + 2 * 4 * (4 + 4)
    return Work(
        f"filter of a recording, {blocks} blocks, gradient",
        operations=4 * 8 * products * blocks,
        moved=4 * BYTES * (2 * 4 + 3 * 16) * blocks,
        seconds=best_time(lambda: slope(some)),
    )


def gauss_newton() -> Work:
    """One iteration of the paper's network on a whole rollout."""
    data = crossings(1)
    weights, samples = num_weights(data, WIDTH), data.states.shape[1]
    call, rank, dampings, chords = iteration(data, WIDTH), 64, 5, 6
    rows = 4 * samples
    # Rollouts take two steps of six stages between samples, each a pass through the
    # network; the Jacobian costs some three passes for each of two outputs.
    passes = 2 * 6 * samples * (dampings * chords + 2 * 3)
    return Work(
        "Gauss-Newton iteration, paper's network",
        operations=2 * weights * passes + 4 * rows * weights * rank,
        moved=4 * BYTES * rows * weights,
        seconds=best_time(call),
    )
