"""The results of `pinav fit`, as `metrics.json` holds them."""

import msgspec

from pinav.commands.cells import EstimateRow
from pinav.commands.fit.structure import StructureRow
from pinav.commands.fit.thermal import ThermalRow
from pinav.evaluation import RestartErrors
from pinav.report import number


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

    def text(self) -> str:
        """The errors in words."""
        errors = (
            f"{number(error, 3)} after {length}"
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

    @property
    def name_of_noise(self) -> str:
        """What `noise` is called in a table."""
        thermal = self.recipe == "langevin"
        return "thermal noise, √(2D)" if thermal else "noise of a position"

    def text(self) -> str:
        """The metrics for a terminal."""
        errors = f"RMSE: {_list_values(self.rmse)}"
        if self.restarts is not None:
            errors = self.restarts.text()
        lines = [self._how(), errors]
        if self.structure is not None:
            lines.append(self.structure.text())
        for name, learned in self.learned.items():
            spread = "" if learned.sd is None else f" ± {number(learned.sd, 2)} (sd)"
            lines.append(f"{name}: {number(learned.value, 6)}{spread}")
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
            f"{self.name_of_noise}: {number(self.noise, 3)}; log evidence "
            f"{number(self.log_evidence, 5)}, {self.iterations} steps ({self.outcome})"
        )


def _list_values(values: dict[str, float | None]) -> str:
    return ", ".join(f"{name} {number(value, 3)}" for name, value in values.items())
