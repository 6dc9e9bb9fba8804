r"""How temperature advances by one time step.

`RKL2` is explicit, for grids of any dimension; `Rosenbrock` is implicit, for radial
ones. Both evaluate perfusion at every stage and are of second order, also where the
power changes with time.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.actuation import Scalar
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat, HeatBalance, Rates, fastest_rate
from pinav.thermal.quantities import Number

Field = Float[Array, "..."]
Levels = Float[Array, "node source"]

MARGIN = 0.9
"""Of the stability limit that is used."""

LONGEST = 10.0
"""Time step [s] beyond which nothing is chosen for stability's sake alone."""

STAGES = (3, 5, 7, 9, 11, 13, 15)
"""Numbers of stages among which is chosen."""


class AbstractStepper(eqx.Module):
    """A one-step method."""

    @property
    @abc.abstractmethod
    def nodes(self) -> Float[np.ndarray, " node"]:
        """Times within a step, as shares of it, at which sources are evaluated."""

    @abc.abstractmethod
    def longest_step(self, model: Bioheat) -> float:
        """Longest time step [s] to take.

        Raises:
            InputError: the step asked for is not positive, or is not stable.
        """

    @abc.abstractmethod
    def step(
        self, balance: HeatBalance, temperature: Field, dt: Scalar, levels: Levels
    ) -> Rates:
        """Change of temperature [K] and of the ledger [J] over a time step [s].

        Args:
            balance: the equation.
            temperature: at the begin [°C].
            dt: the step.
            levels: of the sources at the nodes.
        """


class RKL2(AbstractStepper):
    r"""Runge-Kutta-Legendre super-time-stepping of second order.

    With $s$ stages stable up to $\Delta t = (2/\lambda_{max})(s^2+s-2)/4$: the step
    grows with the square of the work. Stages run in a scan, because XLA recomputes
    stencils that are written out one after the other.

    Attributes:
        stages: $s$, odd, at least 3.
        longest: time step [s]; unless given, 10 s or as much as is stable, whichever is
            less.

    Raises:
        InputError: `stages` is even or below 3.

    References:
        Meyer, Balsara and Aslam, J. Comput. Phys. 257, 594 (2014).
    """

    stages: int = eqx.field(static=True, default=9)
    longest: Number | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.stages < 3 or self.stages % 2 == 0:
            raise InputError(f"RKL2.stages: expected odd and >= 3, got {self.stages}")
        _check_step("RKL2.longest", self.longest)

    @classmethod
    def suited(cls, model: Bioheat) -> "RKL2":
        """The number of stages that covers a time with the fewest evaluations."""
        rate = float(fastest_rate(model))

        def cost(stages):
            return stages / min(MARGIN * _stable_step(stages, rate), LONGEST)

        return cls(min(STAGES, key=cost))

    @property
    def nodes(self):
        s = self.stages
        j = np.arange(s)
        c = (j**2 + j - 2) / (s**2 + s - 2)
        # c_2/4, often used for the first stage, would cost the second order
        c[:2] = 0.0, 4 / (3 * (s**2 + s - 2))
        return c

    def longest_step(self, model):
        limit = _stable_step(self.stages, float(fastest_rate(model)))
        if self.longest is None:
            return min(MARGIN * limit, LONGEST)
        if self.longest > limit:
            raise InputError(
                f"RKL2.longest: expected <= {limit:.4g} s, which {self.stages} stages hold "
                f"stable on this grid, got {self.longest:g} s; take more stages or a "
                "shorter step"
            )
        return self.longest

    def step(self, balance, temperature, dt, levels):
        rows, first = _rkl2_coefficients(self.stages)
        initial = _Stage(temperature, jnp.zeros(3))
        start = _slope(balance, initial, levels[0])
        after = jax.tree.map(lambda y, r: y + first * dt * r, initial, start)

        def stage(carry, inputs):
            (mu, nu, rest, own, of_start), level = inputs
            last, before = carry
            slope = _slope(balance, last, level)

            def combine(y, y_before, y0, rate, rate0):
                drift = dt * (own * rate + of_start * rate0)
                return mu * y + nu * y_before + rest * y0 + drift

            following = jax.tree.map(combine, last, before, initial, slope, start)
            return (following, last), None

        (end, _), _ = jax.lax.scan(stage, (after, initial), (rows, levels[1:]))
        return Rates(end.temperature - temperature, end.ledger)


def _stable_step(stages, rate):
    return 0.5 * (stages**2 + stages - 2) / rate


class _Stage(eqx.Module):
    temperature: Field
    ledger: Float[Array, "3"]


def _slope(balance, stage, level):
    rates = balance.rates(stage.temperature, level)
    return _Stage(rates.temperature, rates.ledger)


def _rkl2_coefficients(s: int) -> tuple[Any, float]:
    """Coefficients of the stages 2 to s, one row for each, and that of the first."""
    j = np.arange(s + 1.0)
    b = np.where(j < 3, 1 / 3, (j**2 + j - 2) / np.where(j < 1, 1, 2 * j * (j + 1)))
    w = 4 / (s**2 + s - 2)
    j, b1, b2 = j[2:], b[1:-1], b[:-2]
    own = b[2:]
    mu = (2 * j - 1) / j * own / b1
    nu = -(j - 1) / j * own / b2
    mu_tilde = mu * w
    gamma = -(1 - b1) * mu_tilde
    columns = np.stack([mu, nu, 1 - mu - nu, mu_tilde, gamma], axis=1)
    return jnp.asarray(columns), b[1] * w


class Rosenbrock(AbstractStepper):
    r"""The two-stage Rosenbrock method ROS2, linearly implicit and L-stable.

    $(1 - \gamma\Delta t J) k_1 = f(T) + \gamma\Delta t f_t$ and
    $(1 - \gamma\Delta t J) k_2 = f(T + \Delta t k_1) - 2 k_1 - \gamma\Delta t f_t$,
    $\gamma = 1 - 1/\sqrt2$, change $\Delta t (3 k_1 + k_2)/2$. Two tridiagonal solves
    and no iteration, whatever the perfusion; it does not ring after a switch, so that
    no starting steps are needed. For radial grids.

    Attributes:
        longest: time step [s].

    Raises:
        InputError: `longest` is not positive.

    References:
        Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci. Comput. 20, 1456 (1999).
    """

    longest: Number = eqx.field(static=True, default=5.0)

    def __check_init__(self):
        _check_step("Rosenbrock.longest", self.longest)

    @property
    def nodes(self):
        return np.array([0.0, 1.0])

    def longest_step(self, model):
        axes = len(model.grid.shape)
        if axes != 1:
            raise InputError(
                f"Rosenbrock: expected a grid with one axis, got {axes}; use RKL2()"
            )
        return self.longest

    def step(self, balance, temperature, dt, levels):
        gamma = 1 - 1 / np.sqrt(2.0)
        solve, slope = _implicit(balance, temperature, gamma * dt)

        def flows(at, level):
            return balance.rates(at, level)

        begin = flows(temperature, levels[0])
        heating = balance.heated(levels[1]) - balance.heated(levels[0])
        drift = gamma * heating * balance.inverse_capacity
        shift = gamma * jnp.stack(
            [jnp.sum(heating), jnp.asarray(0.0), jnp.asarray(0.0)]
        )

        k1 = solve(begin.temperature + drift)
        ledger1 = begin.ledger + gamma * dt * slope(k1) + shift
        later = flows(temperature + dt * k1, levels[1])
        k2 = solve(later.temperature - 2 * k1 - drift)
        ledger2 = later.ledger - 2 * ledger1 + gamma * dt * slope(k2) - shift
        return Rates(0.5 * dt * (3 * k1 + k2), 0.5 * dt * (3 * ledger1 + ledger2))


def _implicit(balance, temperature, weight):
    """Solver of 1 - weight * J at a temperature, and the slope of the ledger there."""
    (conductance,) = balance.conductances
    ones = jnp.ones_like(temperature)
    taken = jax.jvp(balance.sink, (temperature,), (ones,))[1] * balance.volumes
    scale = weight * balance.inverse_capacity
    diagonal = 1 + scale * (conductance[1:] + conductance[:-1] + taken)
    lower = -scale * jnp.concatenate([jnp.zeros(1), conductance[1:-1]])
    upper = -scale * jnp.concatenate([conductance[1:-1], jnp.zeros(1)])

    def solve(right):
        return tridiagonal(lower, diagonal, upper, right)

    def slope(change):
        lost = conductance[0] * change[0] + conductance[-1] * change[-1]
        return jnp.stack([jnp.zeros(()), jnp.sum(taken * change), lost])

    return solve, slope


def tridiagonal(
    lower: Float[Array, " row"],
    diagonal: Float[Array, " row"],
    upper: Float[Array, " row"],
    right: Float[Array, " row"],
) -> Float[Array, " row"]:
    """Solve a tridiagonal system, with derivatives that cost one more solve.

    Args:
        lower: left of the diagonal; the first entry is not used.
        diagonal: of the matrix.
        upper: right of the diagonal; the last entry is not used.
        right: hand side.
    """
    # the derivative that comes with JAX's solver scatters, five times slower
    below, above = lower[1:], upper[:-1]

    def product(x):
        under = jnp.concatenate([jnp.zeros(1), below * x[:-1]])
        over = jnp.concatenate([above * x[1:], jnp.zeros(1)])
        return under + diagonal * x + over

    def solved(dl, du, x):
        return jax.lax.linalg.tridiagonal_solve(dl, diagonal, du, x[:, None])[:, 0]

    def direct(_, x):
        return solved(lower, upper, x)

    def transposed(_, x):
        dl = jnp.concatenate([jnp.zeros(1), above])
        du = jnp.concatenate([below, jnp.zeros(1)])
        return solved(dl, du, x)

    return jax.lax.custom_linear_solve(product, right, direct, transposed)


def _check_step(name, value):
    if value is not None and not 0 < value < np.inf:
        raise InputError(f"{name}: expected a time > 0 s, got {value}")
