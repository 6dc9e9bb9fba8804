"""The results of `pinav fit`, as `metrics.json` holds them."""

from collections.abc import Mapping

import msgspec

from pinav.commands.cells import EstimateRow
from pinav.commands.fit.structure import StructureRow
from pinav.commands.fit.thermal import ThermalRow
from pinav.evaluation import RestartErrors
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.report import NO_UNIT, measured, number, quantity


class Loss(msgspec.Struct, frozen=True):
    """The training loss of trajectory matching.

    Attributes:
        start: before training.
        end: after training.
    """

    start: float | None
    end: float | None


class RestartRow(msgspec.Struct, frozen=True):
    """Median end-point errors of rollouts that start anew at observed positions.

    Attributes:
        errors: by the length of the rollouts in units of time [L].
        rollouts: their number.
    """

    errors: dict[str, float | None]
    rollouts: int

    @classmethod
    def of_errors(cls, restarts: RestartErrors | None) -> "RestartRow | None":
        """The row of such errors, where there are any."""
        if restarts is None:
            return None
        pairs = zip(restarts.lengths, restarts.errors, strict=True)
        return cls({f"{a:g}": float(b) for a, b in pairs}, restarts.rollouts)

    def text(self, units: Mapping[str, str]) -> str:
        """The errors in words.

        Args:
            units: of the channels and of time.
        """
        errors = (
            f"{quantity(error, units.get('x', ''))} after "
            f"{quantity(float(length), units.get('t', ''))}"
            for length, error in self.errors.items()
        )
        return (
            f"error of rollouts from observed positions, median of {self.rollouts}: "
            f"{', '.join(errors)}"
        )


class FitMetrics(msgspec.Struct, frozen=True, omit_defaults=True):
    r"""The numbers of a fit.

    Attributes:
        model: name of the model that stands for the unknown.
        recipe: how it was fitted.
        outcome: the word for how the fit ended.
        rmse: root-mean-square errors of rollouts on the training data, by channel; of
            a recording each is a whole film long.
        learned: constants learned beside the environment.
        remarks: sentences on what limits the result, each with a remedy.
        force_error: relative error of the force by region, where the truth is known.
        loss: of trajectory matching.
        iterations: steps of a fit by the evidence.
        noise: standard deviation of the observations [L]; for Langevin dynamics
            $\sqrt{2D}$.
        amplitude: of the prior of the force.
        log_evidence: of the fit [nats].
        structure: what the search for a structure came to.
        thermal: checks of thermal motion whose observation is learned.
        restarts: errors of a recording by the length of rollouts.
        support: log evidence of a field beside commands over none [nats].
        units: of the channels and of time.
    """

    model: str
    recipe: str
    outcome: str
    rmse: dict[str, float | None]
    learned: dict[str, EstimateRow]
    remarks: tuple[str, ...] = ()
    force_error: dict[str, float | None] | None = None
    loss: Loss | None = None
    iterations: int | None = None
    noise: float | None = None
    amplitude: float | None = None
    log_evidence: float | None = None
    structure: StructureRow | None = None
    thermal: ThermalRow | None = None
    restarts: RestartRow | None = None
    support: float | None = None
    units: dict[str, str] = {}

    @property
    def name_of_noise(self) -> str:
        """What `noise` is called in a table."""
        thermal = self.recipe == "langevin"
        return "thermal noise, √(2D)" if thermal else "noise of a position"

    def text(self) -> str:
        """The metrics for a terminal."""
        errors = f"RMSE: {self._errors()}"
        if self.restarts is not None:
            errors = self.restarts.text(self.units)
        lines = [self._how(), errors]
        if self.support is not None:
            lines.append(support_sentence(self.support))
        if self.structure is not None:
            lines.append(self.structure.text())
        for name, learned in self.learned.items():
            lines.append(f"{name}: {measured(learned.value, learned.sd)}")
        if self.thermal is not None:
            lines.append(self.thermal.text())
        if self.force_error is not None:
            errors = ", ".join(
                f"{region} {'–' if error is None else f'{error:.2%}'}"
                for region, error in self.force_error.items()
            )
            lines.append(f"force error (truth of the system): {errors}")
        return "\n".join([*lines, *self.remarks])

    def _how(self) -> str:
        if self.loss is not None:
            start, end = number(self.loss.start, 3), number(self.loss.end, 3)
            return f"loss: {start} -> {end} ({self.outcome})"
        return (
            f"{self.name_of_noise}: {quantity(self.noise, self._unit_of_noise())}; "
            "log evidence "
            f"{number(self.log_evidence, 5)}, {self.iterations} steps ({self.outcome})"
        )

    def _unit_of_noise(self) -> str:
        length, time = (self.units.get(name, "") for name in ("x", "t"))
        if self.recipe != "langevin" or {length, time} & set(NO_UNIT):
            return length
        return f"{length}/√{time}"

    def _errors(self) -> str:
        units = {"position": self.units.get("x", "")} | self.units
        return ", ".join(
            f"{name} {quantity(value, units.get(name, ''))}"
            for name, value in self.rmse.items()
        )


def support_sentence(gain: float) -> str:
    """What the evidence says of a field beside the commands, with the remedy.

    Args:
        gain: log evidence of the field over none [nats].
    """
    nats = f"{number(abs(gain), 3)} nats"
    if gain > DECISIVE:
        return f"field of position: supported, by {nats} over the known physics alone"
    lead = (
        "against it"
        if gain < -DECISIVE
        else f"which is not decisive (below {DECISIVE:g})"
    )
    sign = "+" if gain > 0 else "−"
    return (
        "field of position: not supported: its log evidence over the known physics "
        f"alone is {sign}{nats}, {lead}. Do not steer by it: use "
        "the system without a field, which pinav fit --model physics-only gives"
    )
