"""Position of a robot now and under commands, by the mixture of the bank."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.identification.running.bank import (
    Bank,
    G,
    P,
    W,
    effective_rates,
    rows,
    wandering,
)
from pinav.identification.running.running_fit import RunningFit

MEMBERS = 48
"""Members with the greatest weights that are asked; the rest weighs little."""


class DriveForecast(eqx.Module):
    """Displacements [L] from a start and their variances [L²], without jitter."""

    displacement: Float[np.ndarray, "*plan time 2"]
    variance: Float[np.ndarray, "*plan time 2"]


class _Members(eqx.Module):
    drive: np.ndarray
    memory: np.ndarray
    weight: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    unit: np.ndarray

    @classmethod
    def of(cls, fit: RunningFit, bank: Bank) -> "_Members":
        weight = bank.weight
        kept = np.argsort(weight, kind="stable")[-MEMBERS:]
        unit = bank.variance_unit[kept]
        return cls(
            fit.grid.drive[kept],
            fit.grid.memory[kept],
            weight[kept] / weight[kept].sum(),
            bank.mean[kept],
            bank.covariance[kept] * unit[:, None, None],
            unit,
        )

    def mix(self, row: np.ndarray, noise: np.ndarray) -> DriveForecast:
        paths = np.einsum("...ms,mas->...ma", row, self.mean)
        # A product with each covariance first: three factors at once are slow.
        by_member = np.einsum("...ms,msu->...mu", row, self.covariance)
        inside = np.einsum("...ms,...ms->...m", by_member, row)
        mean = np.einsum("m,...ma->...a", self.weight, paths)
        apart = (paths - mean[..., None, :]) ** 2
        between = np.einsum("m,...ma->...a", self.weight, apart)
        within = (inside + noise * self.unit) @ self.weight
        return DriveForecast(mean, between + within[..., None])


def locate(fit: RunningFit, time: float) -> DriveForecast | None:
    """Position at a time [s], from closed blocks alone; none before the first one."""
    if fit.bank is None or fit.history is None or fit.cycles is None:
        return None
    members = _Members.of(fit, fit.bank)
    elapsed = time - fit.block_time
    turned = fit.history.at(time - fit.grid.delays[None]) - fit.cycles
    row = rows(turned[:, members.drive], elapsed, members.memory)
    noise, _, _ = wandering(elapsed, members.memory, fit.block_frequency)
    return members.mix(row, noise[None])


def forecast(
    fit: RunningFit,
    times: Float[np.ndarray, " time"],
    frequency: Float[np.ndarray, "*plan time"],
    heading: Float[np.ndarray, "*plan time"],
    *,
    bank: Bank | None = None,
) -> DriveForecast:
    """Displacements from the first of some times on, under commands.

    Args:
        times: times from that of the last frame on [s].
        frequency: held from each time on [Hz]; of one plan or of many.
        heading: likewise [rad].
        bank: another bank, such as an earlier one; its wandering velocity is ignored.
    """
    chosen = fit.bank if bank is None else bank
    assert chosen is not None
    members = _Members.of(fit, chosen)
    turned = _turned_before(fit, members, times)
    turned = turned + _turned_after(fit, members, times, frequency, heading)
    elapsed = times - times[0]
    row = rows(turned, elapsed[:, None], members.memory)
    # Before the first block after a restart the last one is of another clock.
    known = bank is None and fit.cycles is not None
    age = times[0] - fit.block_time if known else np.inf
    faded = np.exp(-age / members.memory)
    row[..., P] = 0.0
    row[..., W] *= faded
    noise = _wandering(elapsed, members.memory, frequency, 1 - faded**2)
    return members.mix(row, noise)


def _turned_before(
    fit: RunningFit, members: _Members, times: np.ndarray
) -> Float[np.ndarray, "time member 2"]:
    """Cycles after the first time by earlier commands that act late [cycles]."""
    assert fit.history is not None
    delayed = np.minimum(times[:, None] - fit.grid.delays, times[0])
    turned = fit.history.at(delayed)[:, members.drive]
    return turned - turned[0]


def _turned_after(
    fit: RunningFit,
    members: _Members,
    times: np.ndarray,
    frequency: np.ndarray,
    heading: np.ndarray,
) -> Float[np.ndarray, "*plan time member 2"]:
    """Cycles by the commands from the first time on [cycles]."""
    late = times[:, None, None] - fit.grid.delays[:, None] - times[:-1]
    held = np.clip(late, 0.0, np.diff(times))
    rates = effective_rates(fit.grid, frequency[..., :-1], heading[..., :-1])
    delay, response = np.divmod(members.drive, rates.shape[-2])
    of_members = rates[..., response, :]
    return np.einsum("tmi,...imk->...tmk", held[:, delay], of_members, optimize=True)


def _wandering(
    elapsed: np.ndarray, memory: np.ndarray, frequency: np.ndarray, fresh: np.ndarray
) -> Float[np.ndarray, "*plan time member"]:
    """Variance of the way that wandering adds, in units of it."""
    _, _, velocity = wandering(np.inf, memory, frequency[..., :1])
    velocity = velocity * fresh
    way, cross = np.zeros_like(velocity), np.zeros_like(velocity)
    variances = [way]
    for place, interval in enumerate(np.diff(elapsed)):
        decay = np.exp(-interval / memory)
        reach = memory * -np.expm1(-interval / memory)
        held = frequency[..., place, None]
        added = wandering(float(interval), memory, held)
        way = way + 2 * reach * cross + reach**2 * velocity + added[0]
        cross = decay * (cross + reach * velocity) + added[1]
        velocity = decay**2 * velocity + added[2]
        variances.append(way)
    return np.stack(variances, axis=-2)


class DriveEstimate(eqx.Module):
    """Main numbers of the drive, with standard deviations.

    Attributes:
        delay: time from command to motion [s].
        gain: speed at 1 Hz, over the frequency [L per cycle].
        offset: angle from the commanded heading to the motion [rad].
        drift: velocity without command [L T⁻¹].
    """

    delay: float
    gain: float
    gain_sd: float
    offset: float
    drift: tuple[float, float]


def gain_at(fit: RunningFit, frequency: float) -> tuple[np.ndarray, float]:
    """Matrix from heading to driven velocity [L T⁻¹] at a frequency [Hz]; its sd."""
    assert fit.bank is not None
    weight = fit.bank.weight
    turned = fit.grid.response(np.array([frequency]))[0][fit.grid.member_response]
    gains = fit.bank.mean[:, :, G] * turned[:, None, None]
    mean = np.einsum("m,mab->ab", weight, gains)
    between = np.einsum("m,mab->ab", weight, (gains - mean) ** 2)
    inside = np.einsum("mss->ms", fit.bank.covariance)[:, G].mean(axis=1)
    within = weight @ (inside * turned**2 * fit.bank.variance_unit)
    return mean, float(np.sqrt(between.mean() + within))


def estimate(fit: RunningFit) -> DriveEstimate | None:
    """Delay, gain, offset and drift; none before the bank begins."""
    if fit.bank is None:
        return None
    weight = fit.bank.weight
    matrix, sd = gain_at(fit, 1.0)
    along = (matrix[0, 0] + matrix[1, 1]) / 2
    across = (matrix[1, 0] - matrix[0, 1]) / 2
    drift = weight @ fit.bank.mean[:, :, 2]
    return DriveEstimate(
        delay=float(weight @ fit.grid.member_delay),
        gain=float(np.hypot(along, across)),
        gain_sd=sd,
        offset=float(np.arctan2(across, along)),
        drift=(float(drift[0]), float(drift[1])),
    )
