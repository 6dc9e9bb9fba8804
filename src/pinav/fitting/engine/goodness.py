"""A statement on how well a fitted model explains its data."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

SIGNIFICANT = 4.0
"""Standard deviations of chance beyond which a statistic counts as a misfit."""


class GoodnessOfFit(eqx.Module):
    r"""Two statistics of the residuals, divided by the standard deviation of the noise.

    The noise of a right model is independent, of variance one. A missing force
    correlates neighbours in time. Where the noise is estimated, $\chi^2$ is one by
    construction and only the correlation tells.

    Fitted numbers take some of the noise with them. Of the hat matrix $H$, with a
    trace of p, they leave neighbours a covariance of $-H_{t,t+1}$. A matrix with no
    negative eigenvalue has $|2 H_{t,t+1}| \le H_{tt} + H_{t+1,t+1}$, so that a right
    model may have a correlation down to $-p$ in the number of degrees of freedom.

    Attributes:
        reduced_chi2: sum of squares per degree of freedom.
        lag1: correlation of neighbours in time.
        num_free: degrees of freedom.
        num_fitted: p, residuals less degrees of freedom.
        noise_known: whether the noise was given.
    """

    reduced_chi2: float
    lag1: float
    num_free: float
    num_fitted: float
    noise_known: bool

    @property
    def is_adequate(self) -> bool:
        """Whether chance explains both statistics."""
        return not (self._correlated or self._too_large)

    @property
    def _correlated(self) -> bool:
        chance = SIGNIFICANT / np.sqrt(self.num_free)
        least = -self.num_fitted / self.num_free - chance
        return bool(not least <= self.lag1 <= chance)

    @property
    def _too_large(self) -> bool:
        excess = (self.reduced_chi2 - 1) * np.sqrt(self.num_free / 2)
        return bool(self.noise_known and excess > SIGNIFICANT)

    @property
    def statement(self) -> str:
        """One sentence for a terminal or a report."""
        numbers = f"lag-1 autocorrelation {self.lag1:+.2f}"
        if self.noise_known:
            numbers = f"reduced chi-squared {self.reduced_chi2:.2f}, {numbers}"
        if self.is_adequate:
            return f"Residuals are consistent with independent noise ({numbers})."
        return (
            f"Residuals are not independent noise ({numbers}): the known forces, the "
            "propulsion or the noise model are wrong, and the learned field and its "
            "bands are not to be trusted."
        )


def goodness_of_fit(
    series: list[Float[np.ndarray, "_ channel"]],
    noise: float,
    num_free: float,
    *,
    noise_known: bool,
) -> GoodnessOfFit:
    """Judge residuals.

    Args:
        series: residuals of each trajectory, in the order of time; NaN where nothing
            was observed.
        noise: their standard deviation.
        num_free: their number less the parameters that the data determine.
        noise_known: whether `noise` was given.
    """
    scale = max(noise, np.finfo(float).tiny)
    scaled = [np.asarray(residuals) / scale for residuals in series]
    squares = sum(float(np.nansum(r**2)) for r in scaled)
    # pairs with a gap between them are left out: how far apart they are varies
    pairs = sum(float(np.nansum(r[1:] * r[:-1])) for r in scaled)
    left, count = max(num_free, 1.0), sum(int(np.isfinite(r).sum()) for r in scaled)
    return GoodnessOfFit(
        reduced_chi2=squares / left,
        lag1=pairs / max(squares, np.finfo(float).tiny),
        num_free=left,
        num_fitted=max(count - left, 0.0),
        noise_known=noise_known,
    )
