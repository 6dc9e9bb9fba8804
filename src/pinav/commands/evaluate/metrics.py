"""The results of `pinav evaluate`, as `evaluation.json` holds them."""

import msgspec

from pinav.commands.cells import Cell, RolloutRow


class ForceRow(msgspec.Struct, frozen=True):
    """Agreement of the learned force with the true one in a region.

    Attributes:
        error: relative L2 error.
        cosine: cosine similarity.
        points: grid points of the region.
    """

    error: Cell
    cosine: Cell
    points: int


class ResidualRow(msgspec.Struct, frozen=True):
    """The residuals of the fit in one channel, and the test that they are white.

    Attributes:
        residuals: number of them.
        statistic: Ljung and Box's Q.
        p_value: chance of a larger one if they were white.
        autocorrelation: at lags 1, 2, ...
    """

    residuals: int
    statistic: Cell
    p_value: Cell
    autocorrelation: tuple[Cell, ...]


class ConstantRow(msgspec.Struct, frozen=True):
    """A learned constant beside its true value.

    Attributes:
        name: of the constant.
        true: its true value.
        value: its learned value.
        sd: standard deviation, where the fit gives one.
        relative_error: learned value over the true one, less 1.
        z: error in standard deviations.
    """

    name: str
    true: float
    value: float
    sd: float | None
    relative_error: Cell
    z: float | None


class CalibrationRow(msgspec.Struct, frozen=True):
    """A conformal band.

    Attributes:
        file: name of the file with the calibration trajectories.
        radius: of the band.
        unit: of the radius.
        count: calibration trajectories.
        says: the band in words.
        covered: fraction of the scored trajectories inside.
    """

    file: str
    radius: Cell
    unit: str
    count: int
    says: str
    covered: float


class EvaluationMetrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """The numbers of an evaluation.

    Attributes:
        data: name of the file that was scored.
        trajectories: in that file.
        starts: the way in which rollouts were started, in words.
        regions: definition of the regions, in words.
        domain: extent of the training data [L]; rollouts that err by more diverged.
        horizon: longest time since the start in the training data [T].
        rmse: root-mean-square errors by model and channel.
        rollouts: by model, source of starts and part of the time.
        force: by model and region, where the truth is known and planar.
        num_training: number of scored trajectories that the run was fitted to.
        units: of channels and time; "1" where dimensionless, "?" where not stated.
        whiteness: of the residuals, by channel.
        constants: recovered constants, where the truth is known.
        coverage: fraction inside nominal 95 % bands, by what and region.
        calibration: a conformal band.
        notes: sentences on what was left out, and why.
    """

    data: str
    trajectories: int
    starts: str
    regions: str
    domain: float
    horizon: float
    rmse: dict[str, dict[str, Cell]]
    rollouts: dict[str, dict[str, dict[str, RolloutRow]]]
    force: dict[str, dict[str, ForceRow]]
    num_training: int = 0
    units: dict[str, str] = {}
    whiteness: dict[str, ResidualRow] | None = None
    constants: tuple[ConstantRow, ...] | None = None
    coverage: dict[str, dict[str, Cell]] | None = None
    calibration: CalibrationRow | None = None
    notes: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Of length."""
        return self.units.get("x", "")

    @property
    def error_name(self) -> str:
        """The name of the errors: of predictions, or of the fit itself."""
        if not self.num_training:
            return "held-out error"
        whole = self.num_training == self.trajectories
        return "training error" if whole else "error, in part on training data"

    @property
    def purpose(self) -> str:
        """A sentence on what the scores say, by the data that were scored."""
        if not self.num_training:
            return (
                "The scores say where the fit can be trusted: the trajectories are "
                "none of those that it was fitted to."
            )
        if self.num_training == self.trajectories:
            return (
                "These are the training data: the scores are training errors and say "
                "how well the run describes what it was fitted to, not how well it "
                "predicts."
            )
        return (
            f"Of the {self.trajectories} trajectories the run was fitted to "
            f"{self.num_training}: the scores are in part training errors; score other "
            "trajectories to learn how well the run predicts."
        )
