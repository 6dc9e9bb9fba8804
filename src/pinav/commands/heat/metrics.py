"""Metrics of the tasks of `pinav heat`."""

import msgspec

from pinav.commands.cells import EstimateRow, Row


class RunMetrics(msgspec.Struct, frozen=True, tag="simulate", tag_field="task"):
    """Temperatures and doses that a run reached.

    Attributes:
        highest: highest temperature [°C].
        t10: temperature that 10 % of the tumour exceed at the end of heating [°C].
        t50: the same for 50 %.
        t90: the same for 90 %.
        d90: dose that 90 % of the tumour exceed [CEM43 min].
        v43: fraction of the tumour above 43 °C at the end of heating.
        heated: the end of heating, after which the field is off [s].
        t90_dose: CEM43 T90, the dose of a place that is always at T90 [min].
        time_to_therapy: time at which D90 reaches 10 min [s]; none where it does not.
        healthy_dose: largest dose outside the tumour [CEM43 min].
        hf: largest product of amplitude and frequency [A m⁻¹ s⁻¹].
        imbalance: relative error of the energy balance.
        dead_target: fraction of the target that is dead by Arrhenius' law, if the case
            has one.
        dead_outside: largest such fraction outside it.
        warnings: laws that were used outside their range, one sentence each.
    """

    highest: float = msgspec.field(name="T_max")
    t10: float = msgspec.field(name="T10")
    t50: float = msgspec.field(name="T50")
    t90: float = msgspec.field(name="T90")
    d90: float = msgspec.field(name="D90")
    v43: float = msgspec.field(name="V43")
    heated: float
    t90_dose: float = msgspec.field(name="CEM43T90")
    time_to_therapy: float | None
    healthy_dose: float
    hf: float = msgspec.field(name="Hf")
    imbalance: float
    warnings: tuple[str, ...]
    dead_target: float | None = None
    dead_outside: float | None = None


class ConstraintMetrics(Row, frozen=True):
    """A constraint at the optimum.

    Attributes:
        name: of the constraint.
        value: largest value of the constrained quantity.
        bound: upper bound.
        unit: of both.
        active: whether the quantity is at its bound.
    """

    name: str
    value: float
    bound: float
    unit: str
    active: bool


class JudgedMetrics(Row, frozen=True):
    """A plan made with a learned tissue, run on the true one.

    Attributes:
        d90: D90 that it reaches [CEM43 min].
        best_d90: D90 of a plan made with the truth, under the same bounds.
        highest: highest temperature that it reaches [°C].
        amplitudes: of the plan made with the truth [A m⁻¹].
    """

    d90: float = msgspec.field(name="D90")
    best_d90: float = msgspec.field(name="best_D90")
    highest: float = msgspec.field(name="T_max")
    amplitudes: tuple[float, ...]


class OptimumMetrics(
    msgspec.Struct, frozen=True, tag="optimise", tag_field="task", kw_only=True
):
    """An optimised protocol.

    Attributes:
        result: of its run.
        outcome: how the optimisation ended.
        evaluations: number of runs with their gradients.
        start_d90: D90 at the start [CEM43 min].
        constraints: with their values.
        amplitudes: of the field in each interval [A m⁻¹].
        max_temperature: bound of the temperature [°C].
        judged: the plan on the true tissue, where that is known.
    """

    result: RunMetrics
    outcome: str
    evaluations: int
    start_d90: float = msgspec.field(name="start_D90")
    constraints: tuple[ConstraintMetrics, ...]
    amplitudes: tuple[float, ...]
    max_temperature: float
    judged: JudgedMetrics | None = None


class LawMetrics(msgspec.Struct, frozen=True):
    """A learned law of perfusion.

    Attributes:
        visited: lowest and highest temperature of its tissue [°C].
        covered: fraction of these temperatures at which the truth lies in the band, of
            synthetic readings.
    """

    visited: tuple[float, float]
    covered: float | None = None


class HeldOutMetrics(msgspec.Struct, frozen=True):
    """Predictions at a power that was not fitted.

    Attributes:
        power: relative to that of the fit.
        learned: largest error of the temperature with the learned laws [K].
        constant: the same with the best constant perfusion.
        true_dose: largest dose [CEM43 min].
        learned_dose: the same by the learned laws.
        constant_dose: the same by the best constant perfusion.
    """

    power: float
    learned: float
    constant: float
    true_dose: float
    learned_dose: float
    constant_dose: float


class QuantityMetrics(Row, frozen=True):
    """A number that was learned, and its true value where that is known.

    Attributes:
        name: with its unit.
        value: learned.
        sd: its standard deviation.
        true: its true value.
    """

    name: str
    value: float
    sd: float
    true: float | None = None

    @property
    def within(self) -> bool | None:
        """Whether the truth is in the band of 95 %."""
        if self.true is None:
            return None
        return abs(self.value - self.true) <= 1.96 * self.sd


class ForecastMetrics(Row, frozen=True):
    """Predictions of times after the readings that were fitted.

    Attributes:
        fitted_until: time of the last of these [s].
        residual: root mean square residual of the later readings, as that of the fit.
        sd: largest standard deviation of the predicted temperatures of the target [K].
        error: largest error of these, where the truth is known [K].
        covered: fraction of them with the truth in the band of 95 %.
    """

    fitted_until: float
    residual: float | None
    sd: float
    error: float | None
    covered: float | None


class LearnMetrics(
    msgspec.Struct, frozen=True, tag="learn", tag_field="task", kw_only=True
):
    """A fit of perfusion to probes.

    Attributes:
        outcome: how the fit ended.
        iterations: number of steps.
        residual: root mean square of the residuals [K].
        noise: estimated standard deviation of a reading [K].
        relative: whether both are in units of a map of the noise instead.
        log_evidence: of the fit [nats].
        constants: other numbers learned, by name.
        laws: by tissue.
        constant_residual: root mean square residual of the best constant perfusion [K].
        held_out: predictions at other powers.
        quantities: numbers that were learned, beside the truth.
        forecast: predictions after the readings that were fitted.
    """

    outcome: str
    iterations: int
    residual: float
    noise: float
    log_evidence: float | None
    constants: dict[str, EstimateRow]
    laws: dict[str, LawMetrics]
    constant_residual: float
    held_out: tuple[HeldOutMetrics, ...] = ()
    relative: bool = False
    quantities: tuple[QuantityMetrics, ...] = ()
    forecast: ForecastMetrics | None = None


HeatMetrics = RunMetrics | OptimumMetrics | LearnMetrics
