"""The results of `pinav discover`, as `laws.json` holds them."""

import numpy as np

from pinav.commands.cells import Row

CLOSE = 6.0
"""Laws within this difference of BIC to the best one are not told apart."""


class ConstantRow(Row, frozen=True):
    """A constant of a law, as the trajectories determine it.

    Attributes:
        name: in words.
        symbol: in LaTeX.
        unit: dimension in length L, time T and force F; "1" means dimensionless.
        value: best value.
        sd: standard deviation; none where the data say nothing.
        low: lower end of the 95 % interval.
        high: upper end.
        identifiable: the interval is short enough to mean anything.
    """

    name: str
    symbol: str
    unit: str
    value: float
    sd: float | None
    low: float | None
    high: float | None
    identifiable: bool

    def text(self) -> str:
        """The constant with its 95 % interval, or that it is not identifiable."""
        line = f"{self.name} = {self.value:.6g}"
        if self.low is not None and self.high is not None:
            line += f", 95 % from {self.low:.6g} to {self.high:.6g}"
        return line if self.identifiable else f"{line}: not identifiable"


class LawRow(Row, frozen=True):
    """A law refitted to the trajectories.

    Attributes:
        name: of the law.
        num_constants: number of its constants.
        bic: Bayesian information criterion; none where the refit diverged.
        delta_bic: that of this law less that of the best one.
        noise: standard deviation of the observations that the law needs.
        outcome: the word for how the refit ended.
        fits: the law explains the data as well as the learned force does.
        extends_best: the best law is a special case of it.
        latex: the formula in LaTeX.
        sympy: both components of the force as SymPy prints and parses them.
        constants: their values and intervals.
    """

    name: str
    num_constants: int
    bic: float | None
    delta_bic: float | None
    noise: float | None
    outcome: str
    fits: bool
    latex: str
    sympy: str
    constants: tuple[ConstantRow, ...]
    extends_best: bool = False

    @property
    def difference(self) -> float:
        """Difference of BIC to the best law; infinite where the refit diverged."""
        return np.inf if self.delta_bic is None else self.delta_bic


class CentralRow(Row, frozen=True):
    """The test for a central force.

    Attributes:
        verdict: central, not central or not identifiable.
        center: place to or from which the force points [L].
        center_sd: its standard deviations [L].
        ratio: tangential over radial force.
        noise_ratio: what the uncertainty of a central force makes of it.
        p_value: probability of a ratio this large if the force is central.
    """

    verdict: str
    center: tuple[float, float]
    center_sd: tuple[float | None, float | None]
    ratio: float
    noise_ratio: float
    p_value: float

    def sentence(self) -> str:
        """The test in words, with the centre where there is one."""
        line = (
            f"central force: {self.verdict}; tangential over radial {self.ratio:.3g}, "
            f"{self.noise_ratio:.3g} expected of a central one, p = {self.p_value:.3g}"
        )
        sds = self.center_sd
        if self.verdict == "not central":
            return line
        if self.verdict == "not identifiable" or None in sds:
            return f"{line}; the data do not determine a centre"
        (x, y), (sd_x, sd_y) = self.center, sds
        return f"{line}; centre ({x:.5g} ± {sd_x:.2g}, {y:.5g} ± {sd_y:.2g})"


class DiscoveryMetrics(Row, frozen=True):
    """The numbers of a discovery.

    Attributes:
        verdict: identified, not identifiable or no law fits.
        laws: refitted laws, the best one first.
        screened: all laws and their criterion on the learned force.
        central: the test for a central force.
        noise: standard deviation of the observations about the learned force.
        num_effective: independent numbers that the data tell about the force.
        structure: kinds of the terms whose laws were sought; none where the laws are
            those of the whole force.
    """

    verdict: str
    laws: tuple[LawRow, ...]
    screened: tuple[tuple[str, float | None], ...]
    central: CentralRow
    noise: float
    num_effective: float
    structure: tuple[str, ...] = ()

    @property
    def close_laws(self) -> tuple[LawRow, ...]:
        """The laws that are not told apart from the best one."""
        return tuple(
            law for law in self.laws if law.difference < CLOSE and not law.extends_best
        )

    def sentences(self) -> list[str]:
        """The finding on the law, its candidates, and whether the force is central."""
        names = ", ".join(law.name for law in self.close_laws)
        sentences = {
            "identified": f"law: {names}",
            "not identifiable": f"law: not identifiable from these data ({names})",
            "no law fits": "law: none; no candidate explains the data as well as the "
            f"learned force, and the nearest is {self.laws[0].name}",
        }
        terms = " + ".join(self.structure)
        candidates = (
            f"candidates: the laws that have the structure of the fit ({terms})"
            if self.structure
            else "candidates: laws of the whole force, and sums of up to three; the "
            "fit has no structure that laws could follow"
        )
        return [sentences[self.verdict], candidates, self.central.sentence()]
