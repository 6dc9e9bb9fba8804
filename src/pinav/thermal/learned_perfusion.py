r"""Perfusion laws to be learned: positive, and flat outside a range of temperatures.

$\log w = \log w_0 + g(T)$ with $g$ a network or kernels; $w_0$ has a flat prior, the
weights of $g$ independent normal ones. Perfusion enters the equation as $w (T - T_a)$:
near the arterial temperature no data tell it, and outside the range that the tissue
visited none can.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.perfusion import AbstractPerfusion
from pinav.thermal.quantities import Field, Number

MIDDLE, UNIT = 41.0, 4.0
"""Temperature [°C] that a network sees as 0, and change [K] that it sees as 1."""


class AbstractLearnedPerfusion(AbstractPerfusion):
    r"""A perfusion with weights.

    Attributes:
        log_level: $\log w_0$, with $w_0$ in kg m⁻³ s⁻¹.
        range: temperatures [°C] between which it varies; it is constant outside.
    """

    log_level: eqx.AbstractVar[Scalar]
    range: eqx.AbstractVar[tuple[float, float]]

    @property
    @abc.abstractmethod
    def weights(self) -> PyTree:
        """The leaves with a Gaussian prior."""

    @abc.abstractmethod
    def variation(self, temperature: Field) -> Field:
        """$g$ at temperatures within the range."""

    def __call__(self, temperature: Field) -> Field:
        inside = jnp.clip(temperature, *self.range)
        return jnp.exp(self.log_level + self.variation(inside))


class NeuralPerfusion(AbstractLearnedPerfusion):
    """Perfusion by a small network of the temperature; make one by `neural_perfusion`.

    Attributes:
        log_level: logarithm of the perfusion [kg m⁻³ s⁻¹] where the network is zero.
    """

    network: eqx.nn.MLP
    log_level: Scalar
    range: tuple[float, float] = eqx.field(static=True)

    @property
    def weights(self) -> PyTree:
        return self.network

    def variation(self, temperature: Field) -> Field:
        scaled = (temperature.reshape(-1, 1) - MIDDLE) / UNIT
        return jax.vmap(self.network)(scaled).reshape(temperature.shape)


class KernelPerfusion(AbstractLearnedPerfusion):
    r"""Perfusion by kernels of the temperature; make one by `kernel_perfusion`.

    $g(T) = \sum_j v_j\,(k(T, c)\,L^{-\top})_j$ with
    $k(T, c) = \exp(-(T-c)^2/2\ell^2)$ and $L L^\top = k(c, c)$: for independent $v_j$
    of one variance a Gaussian process of length scale $\ell$.

    Attributes:
        log_level: logarithm of the perfusion [kg m⁻³ s⁻¹] where $g$ is zero.
    """

    values: Float[Array, " kernel"]
    centers: Float[Array, " kernel"]
    root: Float[Array, "kernel kernel"]
    length_scale: Scalar
    log_level: Scalar
    range: tuple[float, float] = eqx.field(static=True)

    @property
    def weights(self) -> PyTree:
        return self.values

    def variation(self, temperature: Field) -> Field:
        # Whitened weights: their prior is the identity, whatever the length scale.
        factors = jax.scipy.linalg.solve_triangular(self.root.T, self.values)
        flat = temperature.reshape(-1)
        offsets = (flat[:, None] - self.centers[None]) / self.length_scale
        return (jnp.exp(-0.5 * offsets**2) @ factors).reshape(temperature.shape)


def neural_perfusion(
    level: Number,
    temperatures: tuple[float, float],
    *,
    key: PRNGKeyArray,
    width: int = 16,
) -> NeuralPerfusion:
    """An untrained network of one hidden layer.

    Args:
        level: perfusion to start from [kg m⁻³ s⁻¹], positive.
        temperatures: range between which it varies [°C].
        key: random key of the weights.
        width: neurons of the hidden layer.

    Raises:
        InputError: the level is not positive, or the range not increasing.
    """
    _check(level, temperatures)
    network = eqx.nn.MLP(1, 1, width, 1, activation=jnp.tanh, key=key)
    return NeuralPerfusion(
        network=network, log_level=jnp.log(jnp.asarray(level)), range=temperatures
    )


def kernel_perfusion(
    level: Number, temperatures: tuple[float, float], *, length_scale: Number = 3.0
) -> KernelPerfusion:
    """Kernels every half length scale, without weight yet.

    Args:
        level: perfusion to start from [kg m⁻³ s⁻¹], positive.
        temperatures: range between which it varies [°C].
        length_scale: over which perfusion changes [K].

    Raises:
        InputError: the level or the length scale is not positive, or the range not
            increasing.
    """
    _check(level, temperatures)
    if not length_scale > 0:
        raise InputError(
            f"kernel_perfusion length_scale: expected > 0 K, got {length_scale}"
        )
    low, high = temperatures
    count = max(3, round(2 * (high - low) / length_scale) + 1)
    centers = np.linspace(low, high, count)
    squares = ((centers[:, None] - centers[None]) / length_scale) ** 2
    # Kernels every half length scale are nearly dependent: a ridge makes the root real.
    root = np.linalg.cholesky(np.exp(-0.5 * squares) + 1e-8 * np.eye(count))
    return KernelPerfusion(
        values=jnp.zeros(count),
        centers=jnp.asarray(centers),
        root=jnp.asarray(root),
        length_scale=length_scale,
        log_level=jnp.log(jnp.asarray(level)),
        range=temperatures,
    )


def _check(level: Any, temperatures: Any) -> None:
    if not 0 < level < np.inf:
        raise InputError(f"perfusion level: expected > 0 kg/(m³ s), got {level}")
    if not temperatures[0] < temperatures[1]:
        raise InputError(
            f"perfusion range: expected increasing temperatures, got {temperatures}"
        )
