r"""Brownian motion of a swimmer: the stochastic differential equation and its paths.

Forces and mobility are those of an `OverdampedSwimmer`; the noise follows from the
mobility, $D = k_B T M$ (fluctuation and dissipation), so that no strength of noise is
set apart from the temperature.
"""

from typing import cast

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray, PyTree

from pinav.arguments import Scalar, State, Vector
from pinav.dynamics.rollout import Outcome, Rollout
from pinav.dynamics.swimmers import AbstractDynamics, OverdampedSwimmer
from pinav.errors import InputError
from pinav.forces import tensor_matrix

BOLTZMANN = 1.380649e-5
"""Boltzmann's constant [pN µm K⁻¹]."""


def thermal_energy(temperature: float) -> float:
    """Thermal energy $k_B T$ [pN µm] at a temperature [K]; 4.116e-3 at 298.15 K."""
    return BOLTZMANN * temperature


class BrownianSwimmer(AbstractDynamics):
    r"""An overdamped swimmer that thermal noise kicks, in Ito's sense.

    $$dX = \left(u + M F + k_B T\, \nabla\cdot M\right) dt + \sqrt{2 k_B T M}\, dW.$$

    The divergence of the mobility makes Boltzmann's distribution the stationary one
    where the mobility varies; it vanishes where it does not. Called, it gives the
    drift: the rollout of that is the path without noise. `sample_path` draws paths.

    Attributes:
        swimmer: forces, mobility and flow.
        thermal_energy: $k_B T$ [F L], not negative.

    Raises:
        InputError: `thermal_energy` is a negative number.

    References:
        Einstein 1905; Ermak and McCammon, J. Chem. Phys. 69, 1352 (1978).
    """

    swimmer: OverdampedSwimmer
    thermal_energy: Scalar

    def __check_init__(self) -> None:
        if isinstance(self.thermal_energy, float | int) and self.thermal_energy < 0:
            raise InputError(
                "BrownianSwimmer.thermal_energy: expected >= 0, got "
                f"{self.thermal_energy}"
            )

    def __call__(self, t: Scalar, y: State) -> State:
        def mobility(x: Vector) -> Float[Array, "dim dim"]:
            return tensor_matrix(self.swimmer.mobility, x)

        divergence = jnp.trace(jax.jacfwd(mobility)(y), axis1=1, axis2=2)
        return self.swimmer(t, y) + self.thermal_energy * divergence

    def noise(self, y: Vector, kick: Vector) -> Vector:
        r"""$\sqrt{2 k_B T M}$ at the position `y`, applied to an increment of $W$."""
        scale = jnp.sqrt(2 * jnp.asarray(self.thermal_energy, y.dtype))
        return scale * self.swimmer.mobility.factor(y, kick)

    def diffusion(self, y: Vector) -> Float[Array, "dim dim"]:
        """Diffusion tensor $D = k_B T M$ [L² T⁻¹] at the position `y`."""
        return self.thermal_energy * tensor_matrix(self.swimmer.mobility, y)


def sample_path(
    dynamics: BrownianSwimmer,
    y0: ArrayLike,
    ts: ArrayLike,
    *,
    key: PRNGKeyArray,
    substeps: int = 20,
) -> Rollout:
    r"""Draw one path of a Brownian swimmer and save it at each time.

    Euler and Maruyama's scheme, `substeps` equal steps from each time to the next. It
    converges in Ito's sense where the mobility varies too, which Heun's does not; where
    it is constant its strong order is one, as that of Milstein's scheme. In a trap of
    relaxation time $\tau$ a step $h$ makes the variance too large by $h / 2\tau$.

    Args:
        y0: initial position [L], a vector.
        ts: times [T], increasing, at least two.
        key: random key of the path: the Brownian motion is the same whatever the steps.
        substeps: steps between two times, positive.

    Raises:
        InputError: `substeps` is not positive, `y0` is not a vector or `ts` has fewer
            than two times.
    """
    y0, ts = jnp.asarray(y0), jnp.asarray(ts)
    if y0.ndim != 1 or ts.ndim != 1 or ts.shape[0] < 2 or substeps < 1:
        raise InputError(
            "sample_path: expected one position, two or more times and one or more "
            f"substeps; got shapes {y0.shape}, {ts.shape} and {substeps} substeps"
        )
    ts = ts.astype(y0.dtype)
    parts = jnp.arange(substeps, dtype=y0.dtype)[None] / substeps
    grid = (ts[:-1, None] + (ts[1:] - ts[:-1])[:, None] * parts).reshape(-1)
    grid = jnp.append(grid, ts[-1])
    shortest = jnp.min(jnp.diff(grid))
    motion = diffrax.VirtualBrownianTree(
        ts[0], ts[-1], tol=shortest / 2, shape=y0.shape, key=key
    )

    def noise_matrix(t: ArrayLike, y: Vector, args: PyTree) -> Float[Array, "dim dim"]:
        units = jnp.eye(y.shape[0], dtype=y.dtype)
        return jax.vmap(lambda unit: dynamics.noise(y, unit), out_axes=1)(units)

    terms = diffrax.MultiTerm(
        diffrax.ODETerm(lambda t, y, args: dynamics(t, y)),  # pyright: ignore
        diffrax.ControlTerm(noise_matrix, motion),
    )
    solution = diffrax.diffeqsolve(
        terms,
        diffrax.Euler(),
        ts[0],
        ts[-1],
        None,
        y0,
        saveat=diffrax.SaveAt(ts=ts),
        stepsize_controller=diffrax.StepTo(ts=grid),
        max_steps=grid.shape[0],
        throw=False,
    )
    ys = cast(Array, solution.ys)
    finite = jnp.all(jnp.isfinite(ys))
    return Rollout(ts, ys, jnp.where(finite, Outcome.SUCCESS, Outcome.DIVERGED))
