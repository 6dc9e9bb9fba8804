r"""MR thermometry: temperatures of voxels, frame by frame, as data of a fit.

The shift of the proton resonance gives a phase, and so a temperature up to whole turns;
the field of the magnet drifts, which adds to every frame a phase that is smooth in
space. Turns are removed beside the prediction, and what a drift could explain is
projected out of the residuals of each frame, so that it costs no parameters:

$$r_f \to r_f - B (B^\top B)^{-1} B^\top r_f,\qquad B = W_f P,$$

with $W_f$ one over the noise of each voxel, zero where it is lost, and $P$ the constant
and the coordinates: the same as a flat prior on the coefficients of every frame.

References:
    Rieke and Butts Pauly, J. Magn. Reson. Imaging 27, 376 (2008).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.protocols import AbstractProtocol, Schedule, plan_steps
from pinav.thermal.quantities import Field, Number
from pinav.thermal.solve import run
from pinav.thermal.starts import AT_REST, AbstractStart
from pinav.thermal.steppers import AbstractStepper

GYROMAGNETIC = 42.577478518e6
"""Frequency of protons over the field of the magnet [Hz T⁻¹]."""

DRIFTS = ("none", "constant", "linear")
"""What the drift of the field is in space, at each frame a new one."""


class Thermometry(eqx.Module):
    """Temperatures of voxels over time.

    Attributes:
        times: of the frames [s], increasing.
        values: temperatures [°C] of each frame; NaN where a voxel is lost.
        noise: standard deviation of a reading [K], one for each voxel.
        turn: temperature [K] that a turn of the phase is; None without turns.
        drift: one of `DRIFTS`.

    Raises:
        InputError: times do not increase from above zero, shapes disagree, noise is not
            positive, or nothing was read.
    """

    times: Float[np.ndarray, " frame"]
    values: Float[np.ndarray, "frame ..."]
    noise: Float[np.ndarray, "..."]
    turn: Number | None = None
    drift: str = eqx.field(static=True, default="none")

    def __check_init__(self) -> None:
        if self.values.shape != (len(self.times), *self.noise.shape):
            raise InputError(
                f"Thermometry.values: expected frames of shape {self.noise.shape} at "
                f"{len(self.times)} times, got {self.values.shape}"
            )
        if not (
            len(self.times) and self.times[0] > 0 and np.all(np.diff(self.times) > 0)
        ):
            raise InputError(
                "Thermometry.times: expected increasing times > 0 s; the state at 0 s "
                "is where a run starts, not a reading"
            )
        if not self.observed.any():
            raise InputError("Thermometry.values: expected a reading, got none")
        if not np.all(self.noise[self.observed.any(axis=0)] > 0):
            raise InputError(
                "Thermometry.noise: expected > 0 K at every voxel that is read; give "
                "lost voxels no reading"
            )
        if self.turn is not None and not self.turn > 0:
            raise InputError(f"Thermometry.turn: expected > 0 K, got {self.turn:g}")
        if self.drift not in DRIFTS:
            raise InputError(
                f"Thermometry.drift: expected {', '.join(DRIFTS)}, got {self.drift!r}"
            )

    @property
    def observed(self) -> Bool[np.ndarray, "frame ..."]:
        """Which readings there are."""
        return np.isfinite(self.values) & np.isfinite(self.noise)

    @property
    def spread(self) -> float:
        """Size of what is observed, in units of the noise."""
        scaled = (self.values / self.noise)[self.observed]
        return float(scaled.std()) or 1.0

    def until(self, time: Number) -> "Thermometry":
        """The frames up to a time [s].

        Raises:
            InputError: there is none.
        """
        kept = self.times <= time * (1 + 1e-9)
        return eqx.tree_at(
            lambda data: (data.times, data.values),
            self,
            (self.times[kept], self.values[kept]),
        )


def phase_turn(field: Number, echo: Number, coefficient: Number = -1e-8) -> float:
    r"""Temperature of a turn of the phase [K], $1/|\gamma\alpha B_0 t_E|$.

    Args:
        field: $B_0$ [T].
        echo: $t_E$ [s].
        coefficient: $\alpha$, change of the shift with temperature [K⁻¹].
    """
    return 1 / abs(GYROMAGNETIC * coefficient * field * echo)


class ThermometryResiduals(eqx.Module):
    """Predicted less read temperatures over their noise, less what a drift explains.

    Attributes:
        protocol: the field.
        schedule: time steps, which end at the frames.
        stepper: how time advances.
        cells: voxels that are read in some frame, in the flattened grid.
        values: readings [°C] of these in each frame, zero where lost.
        weights: one over the noise [K⁻¹], zero where lost.
        basis: of the drift at these voxels.
        roots: of the normal matrix of each frame, lower triangular.
        index: places of the readings among all frames and voxels.
        turn: of the phase [K].
        start: where the run begins.
    """

    protocol: AbstractProtocol
    schedule: Schedule
    stepper: AbstractStepper
    cells: Int[Array, " voxel"]
    values: Float[Array, "frame voxel"]
    weights: Float[Array, "frame voxel"]
    basis: Float[Array, "voxel term"]
    roots: Float[Array, "frame term term"]
    index: Int[Array, " reading"]
    turn: Number | None
    start: AbstractStart = AT_REST

    def __call__(self, model: Bioheat) -> Float[Array, " reading"]:
        """The residuals of a model."""
        offsets = self.offsets(self.predict(model))
        return self.project(offsets * self.weights).reshape(-1)[self.index]

    def predict(self, model: Bioheat) -> Float[Array, "frame voxel"]:
        """Temperatures of the voxels that are read [°C]."""
        solution = run(
            model,
            self.protocol,
            self.schedule,
            stepper=self.stepper,
            observe=Voxels(self.cells),
            start=self.start,
        )
        return solution.observed

    def offsets(
        self, predicted: Float[Array, "frame voxel"]
    ) -> Float[Array, "frame voxel"]:
        """Predicted less read [K], turns of the phase taken off.

        Next to the mean of each frame, on the circle: a drift may be more than a turn.
        """
        offsets = predicted - self.values
        if self.turn is None:
            return offsets
        angles = 2 * np.pi / self.turn * jax.lax.stop_gradient(offsets)
        read = self.weights > 0
        mean = jnp.arctan2(
            jnp.sum(jnp.where(read, jnp.sin(angles), 0.0), axis=1),
            jnp.sum(jnp.where(read, jnp.cos(angles), 0.0), axis=1),
        )
        return offsets - self.turn * jnp.round((angles - mean[:, None]) / (2 * np.pi))

    def project(
        self, scaled: Float[Array, "frame voxel"]
    ) -> Float[Array, "frame voxel"]:
        """What of weighted residuals no drift explains."""
        if not self.basis.shape[1]:
            return scaled
        return scaled - self.weights * (self.drifts(scaled) @ self.basis.T)

    def drifts(self, scaled: Float[Array, "frame voxel"]) -> Float[Array, "frame term"]:
        """Coefficients of the drift [K] that explain weighted residuals best."""
        moments = (scaled * self.weights) @ self.basis

        def solve_frame(root: Array, moment: Array) -> Array:
            return jax.scipy.linalg.cho_solve((root, True), moment)

        return jax.vmap(solve_frame)(self.roots, moments)

    @property
    def num_projected(self) -> int:
        """Residuals that the drifts of all frames take away."""
        return self.roots.shape[0] * self.basis.shape[1]


class Voxels(eqx.Module):
    """Temperatures of some cells, as an `observe`.

    Attributes:
        cells: their indices in the flattened grid.
    """

    cells: Int[Array, " voxel"]

    def __call__(self, temperature: Field) -> Float[Array, " voxel"]:
        """Temperatures of the voxels [°C]."""
        return temperature.reshape(-1)[self.cells]


def thermometry_residuals(
    model: Bioheat,
    protocol: AbstractProtocol,
    data: Thermometry,
    *,
    stepper: AbstractStepper,
    start: AbstractStart = AT_REST,
) -> ThermometryResiduals:
    """The residuals of models like `model`.

    Raises:
        InputError: the frames are of another grid or after the protocol, or a frame has
            too few voxels for its drift.
    """
    if data.noise.shape != model.grid.shape:
        raise InputError(
            f"thermometry: expected frames of shape {model.grid.shape}, that of the "
            f"grid, got {data.noise.shape}"
        )
    frames = len(data.times)
    observed = data.observed.reshape(frames, -1)
    cells = np.flatnonzero(observed.any(axis=0))
    read = observed[:, cells]
    noise = np.where(np.isfinite(data.noise), data.noise, 1.0).reshape(-1)[cells]
    weights = np.where(read, 1 / noise, 0.0)
    values = np.where(read, data.values.reshape(frames, -1)[:, cells], 0.0)
    basis = _drift_basis(data.drift, data.noise.shape)[cells]
    return ThermometryResiduals(
        protocol=protocol,
        schedule=plan_steps(
            protocol, stepper.longest_step(model), save_at=data.times.tolist()
        ),
        stepper=stepper,
        cells=jnp.asarray(cells),
        values=jnp.asarray(values),
        weights=jnp.asarray(weights),
        basis=jnp.asarray(basis),
        roots=jnp.asarray(_roots(weights, basis)),
        index=jnp.asarray(np.flatnonzero(read)),
        turn=data.turn,
        start=start,
    )


def _drift_basis(drift: str, shape: tuple[int, ...]) -> Float[np.ndarray, "voxel term"]:
    """One, and the coordinates from -1 to 1."""
    count = int(np.prod(shape))
    if drift == "none":
        return np.zeros((count, 0))
    terms = [np.ones(shape)]
    if drift == "linear":
        lines = [np.linspace(-1.0, 1.0, n) for n in shape]
        terms += np.meshgrid(*lines, indexing="ij")
    return np.stack([term.reshape(-1) for term in terms], axis=1)


def _roots(weights: np.ndarray, basis: np.ndarray) -> np.ndarray:
    normal = np.einsum("fv,vi,vj->fij", weights**2, basis, basis, optimize=True)
    try:
        return np.linalg.cholesky(normal)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "thermometry: expected voxels in every frame that tell its drift, got a "
            "frame without them; leave the frame out, or take a drift of fewer terms"
        ) from error
