r"""What density and current of a driven ring say of drift and diffusion.

In a steady state $J = v p - (D p)'$, so that Ito's drift is $v = J / p + D (\ln p)' +
D'$. The current J through an angle is the number of net crossings of it, known from the
first and the last angle of each track alone; the density is a Poisson regression of the
histogram. No increment is looked at. Errors come from resampling whole tracks, because
the samples of a track are correlated.

References:
    Gomez-Solano et al., Phys. Rev. Lett. 103, 040601 (2009).
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.fitting import Estimate

HARMONICS, BINS, RESAMPLES = 10, 180, 100
"""Harmonics of the logarithm of the density, bins of its histogram, and resamplings."""


class RingTruth(eqx.Module):
    """Density and current on a ring.

    Attributes:
        angles: grid of places [rad, or L], from 0 to below the period.
        period: of the ring.
        density: $p$ at the grid, with the integral 1.
        log_slope: $(ln p)'$ there.
        current: $J$ there [T⁻¹].
        mean_current: over the ring, its error from resampled tracks [T⁻¹].
        samples: density, slope and current of each resampling.
    """

    angles: Float[np.ndarray, " place"]
    period: float
    density: Float[np.ndarray, " place"]
    log_slope: Float[np.ndarray, " place"]
    current: Float[np.ndarray, " place"]
    mean_current: Estimate
    samples: Float[np.ndarray, "resample 3 place"]

    def drift(
        self, diffusion: float, slope: Float[np.ndarray, " place"] | float = 0.0
    ) -> Float[np.ndarray, " place"]:
        """Drift $v$ on the grid.

        Args:
            diffusion: D, the same everywhere or at the grid.
            slope: D' there.
        """
        return self.current / self.density + diffusion * self.log_slope + slope

    def drift_sd(self, diffusion: float) -> Float[np.ndarray, " place"]:
        """Standard deviation of the drift, of resampled tracks."""
        density, slope, current = np.moveaxis(self.samples, 1, 0)
        return np.std(current / density + diffusion * slope, axis=0)

    def diffusion_of(self, drift: Float[np.ndarray, " place"]) -> Estimate:
        """The diffusion with which a drift agrees best with density and current.

        Least squares on $J / p$ and $(ln p)'$, weighted by the density: no
        fluctuation of a step enters.
        """

        def solve(density: np.ndarray, slope: np.ndarray, current: np.ndarray) -> float:
            root = np.sqrt(density)
            columns = np.stack([current / density, slope], axis=1) * root[:, None]
            return np.linalg.lstsq(columns, drift * root)[0][1]

        value = solve(self.density, self.log_slope, self.current)
        others = [solve(*sample) for sample in self.samples]
        return Estimate(float(value), float(np.std(others)))

    def distance(
        self,
        drift: Float[np.ndarray, " place"],
        true: Float[np.ndarray, " place"],
        *,
        weighted: bool = True,
    ) -> float:
        """Relative L2 distance of a drift from the true one, weighted by density."""
        weight = self.density if weighted else np.ones_like(self.density)
        return float(np.sqrt(weight @ (drift - true) ** 2 / (weight @ true**2)))


def ring_truth(
    tracks: Float[np.ndarray, "track time"], interval: float, period: float
) -> RingTruth:
    """Density and current of tracks on a ring.

    Args:
        tracks: unwrapped places; NaN where a frame is lost, but not at either end.
        interval: between frames [T].
        period: of the ring, such as 2 pi.

    Raises:
        InputError: there are fewer than two tracks, or one begins or ends without a
            place.
    """
    if len(tracks) < 2 or not np.isfinite(tracks[:, [0, -1]]).all():
        raise InputError(
            "ring_truth: expected two or more tracks that begin and end with a place, "
            f"got {len(tracks)}"
        )
    angles = (np.arange(BINS) + 0.5) * period / BINS
    edges = np.linspace(0.0, period, BINS + 1)
    counts = np.array(
        [np.histogram(np.mod(t[np.isfinite(t)], period), edges)[0] for t in tracks],
        float,
    )
    first, last = tracks[:, :1], tracks[:, -1:]
    crossings = np.floor((last - angles) / period) - np.floor((first - angles) / period)
    duration = interval * (tracks.shape[1] - 1)

    def fields(chosen: np.ndarray) -> np.ndarray:
        density, slope = _smooth_density(counts[chosen].sum(axis=0), period)
        current = crossings[chosen].sum(axis=0) / (duration * len(chosen))
        return np.stack([density, slope, current])

    random = np.random.default_rng(0)
    size = len(tracks)
    density, slope, current = fields(np.arange(size))
    samples = np.stack(
        [fields(random.integers(size, size=size)) for _ in range(RESAMPLES)]
    )
    turns = (last - first)[:, 0] / period / duration
    mean = Estimate(float(turns.mean()), float(turns.std(ddof=1) / np.sqrt(size)))
    return RingTruth(angles, period, density, slope, current, mean, samples)


def _smooth_density(
    counts: Float[np.ndarray, " bin"], period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Density and slope of its logarithm, by Poisson regression on harmonics."""
    phases = 2 * np.pi * (np.arange(BINS) + 0.5) / BINS
    orders = np.arange(1, HARMONICS + 1)
    cosines, sines = (f(phases[:, None] * orders) for f in (np.cos, np.sin))
    columns = np.concatenate([np.ones((BINS, 1)), cosines, sines], axis=1)
    weights = np.zeros(columns.shape[1])
    weights[0] = np.log(counts.mean())
    for _ in range(50):
        expected = np.exp(np.clip(columns @ weights, -20, 50))
        normal = columns.T @ (expected[:, None] * columns)
        ridge = 1e-6 * np.trace(normal) / len(normal) * np.eye(len(normal))
        step = np.linalg.solve(normal + ridge, columns.T @ (counts - expected))
        weights += np.clip(step, -2.0, 2.0)
        if np.abs(step).max() < 1e-8:
            break
    log_density = columns @ weights
    density = np.exp(log_density - log_density.max())
    density /= density.sum() * period / BINS
    turns = 2 * np.pi / period * orders
    slopes = np.concatenate([-turns * sines, turns * cosines], axis=1)
    return density, slopes @ weights[1:]


def steady_state(
    drift: Float[np.ndarray, " place"],
    diffusion: Float[np.ndarray, " place"],
    period: float,
) -> tuple[Float[np.ndarray, " place"], float]:
    r"""Density and current of a drift and a diffusion on a ring.

    Solves $J' = 0$, $J = v p - (D p)'$, with fluxes between cells that are exact for a
    drift that is constant from one cell to the next (Scharfetter and Gummel).

    Args:
        drift: v at equal steps round the ring.
        diffusion: D there.
        period: of the ring.

    Returns:
        The density with the integral 1, and the current [T⁻¹].
    """
    size, step = len(drift), period / len(drift)
    after = np.roll(np.arange(size), -1)
    # With D in the derivative, D p is what diffuses with a coefficient of one.
    ratio = 0.5 * (drift / diffusion + (drift / diffusion)[after]) * step
    forward, backward = (_bernoulli(sign * ratio) / step for sign in (-1, 1))
    flux = np.zeros((size, size))
    here = np.arange(size)
    flux[here, here] += forward * diffusion
    flux[here, after] -= backward * diffusion[after]
    balance = flux - np.roll(flux, 1, axis=0)
    balance[-1] = step
    density = np.linalg.solve(balance, np.append(np.zeros(size - 1), 1.0))
    return density, float((flux @ density).mean())


def _bernoulli(value: np.ndarray) -> np.ndarray:
    """The function x / (exp(x) - 1)."""
    small = np.abs(value) < 1e-6
    safe = np.where(small, 1.0, value)
    return np.where(small, 1 - value / 2, safe / np.expm1(safe))
