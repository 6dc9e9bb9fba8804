"""Parameter recovery: learned constants beside their true values."""

import equinox as eqx


class ParameterRecovery(eqx.Module):
    """A learned constant beside its truth.

    Attributes:
        name: what `pinav fit --train` calls it.
        true: its true value.
        value: its learned value.
        sd: its standard deviation, where the fit gives one.
    """

    name: str
    true: float
    value: float
    sd: float | None

    @property
    def relative_error(self) -> float:
        """Learned value over the true one, less 1; NaN where the truth is zero."""
        return self.value / self.true - 1.0 if self.true else float("nan")

    @property
    def z(self) -> float | None:
        """Error in standard deviations; beyond 2 or 3 the interval is wrong."""
        return None if not self.sd else (self.value - self.true) / self.sd
