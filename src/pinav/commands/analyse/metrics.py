"""The results of `pinav analyse`, as `analysis.json` holds them."""

from collections.abc import Mapping

import msgspec

from pinav.report import quantity


class HelmholtzMetrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """The Helmholtz split of the learned force.

    Attributes:
        reach: distance from the data up to which the force was split [L].
        rotational: fraction of the squared force that is rotational.
        gradient: fraction that is a gradient.
        least: rotational fraction where harmonic fields count as gradients.
        greatest: the same where they count as rotational.
        misfit: relative error of the split.
        sd: standard deviation of the rotational fraction over posterior samples.
    """

    reach: float
    rotational: float
    gradient: float
    least: float
    greatest: float
    misfit: float
    sd: float | None = None

    def sentence(self, units: Mapping[str, str]) -> str:
        """The rotational fraction in words, and what its bounds mean.

        Args:
            units: of the channels and of time.
        """
        reach = quantity(self.reach, units.get("x", ""))
        spread = "" if self.sd is None else f" ± {self.sd:.2%} (sd)"
        return (
            f"rotational part: {self.rotational:.2%}{spread} of the square of the "
            f"learned field within {reach} of the data. Near the data alone some "
            "fields are gradient and rotational at once (harmonic fields): counted as "
            f"gradient they leave {self.least:.2%}, counted as rotational "
            f"{self.greatest:.2%}"
        )


class EntropyMetrics(msgspec.Struct, frozen=True):
    """How far thermal motion is from equilibrium.

    Attributes:
        rate: entropy production [k_B T⁻¹].
        sd: its standard deviation.
        speed: root mean square of the current velocity at the samples [L T⁻¹].
    """

    rate: float
    sd: float
    speed: float

    def sentence(self) -> str:
        """The rate in words, and whether equilibrium is excluded."""
        out = self.rate > 2 * self.sd
        verdict = "out of equilibrium" if out else "equilibrium is not excluded"
        return (
            f"entropy production of a steady state: {self.rate:.3g} ± {self.sd:.2g} "
            f"(sd) k_B per unit of time: {verdict}; current velocity {self.speed:.3g} "
            "(rms)"
        )


class InfluenceRow(msgspec.Struct, frozen=True):
    """The influence of a trajectory on the fit.

    Attributes:
        trajectory: its index.
        leverage: number of parameters that it determines.
        cook: Cook's distance.
        force: relative change of the force near the data without it.
        final: change of the final position of the reference rollout [L].
    """

    trajectory: int
    leverage: float
    cook: float
    force: float
    final: float


class ConstantEffect(msgspec.Struct, frozen=True):
    """The effect of a constant that is one percent larger.

    Attributes:
        constant: its name.
        value: its value.
        learned: it was learned beside the force.
        force: relative change of the force near the data.
        final: change of the final position of the reference rollout [L].
    """

    constant: str
    value: float
    learned: bool
    force: float
    final: float


class SobolRow(msgspec.Struct, frozen=True):
    """Sobol' indices of one outcome by one factor, with 95 % intervals.

    Attributes:
        outcome: its name.
        factor: its name.
        first: first-order index.
        first_low: lower end of its interval.
        first_high: upper end of its interval.
        total: total index.
        total_low: lower end of its interval.
        total_high: upper end of its interval.
        variance: of the outcome.
    """

    outcome: str
    factor: str
    first: float | None
    first_low: float | None
    first_high: float | None
    total: float | None
    total_low: float | None
    total_high: float | None
    variance: float


class LyapunovMetrics(msgspec.Struct, frozen=True):
    """Finite-time Lyapunov exponents of rollouts.

    Attributes:
        horizon: time over which separations grow [T].
        median: median growth of separations.
        greatest: greatest growth of separations.
        exponent: median exponent [T⁻¹].
    """

    horizon: float
    median: float | None
    greatest: float | None
    exponent: float | None

    def sentence(self, time: str) -> str:
        """The growth and the exponent in words; with the unit of time."""
        if self.median is None or self.greatest is None or self.exponent is None:
            return "separations of neighbouring starts: no finite growth"
        return (
            f"separations of neighbouring starts grow by {self.median:.3g} (median) to "
            f"{self.greatest:.3g} (greatest) over {quantity(self.horizon, time)}; "
            f"median finite-time Lyapunov exponent {self.exponent:.2g} per unit of time"
        )


class AnalysisMetrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """The numbers of an analysis.

    Attributes:
        model: name of the model that stands for the unknown.
        posterior: the run has a posterior.
        order: of the dynamics in time.
        settings: of the analysis.
        helmholtz: the split of the force.
        potential: origin of the potential, in words.
        lyapunov: sensitivity of rollouts to their starts.
        left_out: sentences on what could not be done, and why.
        above_two_sd: fraction of each region in which the force is above two standard
            deviations.
        influence: of each trajectory.
        constants: effects of constants.
        sobol: indices of rollouts.
        landmark: highest point of the potential near the data [L].
        entropy: production of thermal motion, where it can be told.
    """

    model: str
    posterior: bool
    order: int
    settings: dict[str, int | float]
    helmholtz: HelmholtzMetrics
    potential: str
    lyapunov: LyapunovMetrics
    left_out: tuple[str, ...] = ()
    above_two_sd: dict[str, float] | None = None
    influence: tuple[InfluenceRow, ...] | None = None
    constants: tuple[ConstantEffect, ...] | None = None
    sobol: tuple[SobolRow, ...] | None = None
    landmark: tuple[float, float] | None = None
    entropy: EntropyMetrics | None = None

    def text(self, units: Mapping[str, str]) -> str:
        """The findings for a terminal.

        Args:
            units: of the channels and of time.
        """
        length, time = units.get("x", ""), units.get("t", "")
        lines = [self.helmholtz.sentence(units)]
        if self.entropy is not None:
            lines.append(self.entropy.sentence())
        if self.above_two_sd is not None:
            parts = ", ".join(f"{k} {v:.0%}" for k, v in self.above_two_sd.items())
            lines.append(f"field above two standard deviations: {parts} of the region")
        if self.influence:
            most = max(self.influence, key=lambda row: row.force)
            lines.append(
                f"most influential: trajectory {most.trajectory}; without it the field "
                f"changes by {most.force:.2%}"
            )
        for row in self.constants or ():
            lines.append(
                f"{row.constant} one percent larger: field {row.force:.2%}, final "
                f"position {quantity(row.final, length)}"
            )
        lines.append(self.lyapunov.sentence(time))
        return "\n".join([*lines, *(f"left out: {line}" for line in self.left_out)])
