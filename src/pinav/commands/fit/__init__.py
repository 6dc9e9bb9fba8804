"""Settings of `pinav fit`."""

from typing import Annotated, Literal

from pinav.commands.settings import (
    FilesOptions,
    ModelName,
    Range,
    ReadingWords,
    Settings,
    SystemName,
)
from pinav.errors import InputError
from pinav.learning.recipes import Recipe, Suited
from pinav.reading import PLAIN


class FitSettings(Settings, frozen=True):
    """Settings of `pinav fit` beside those of its recipe.

    Attributes:
        model: What stands for the unknown. kernel-, neural-: a force that depends on
            position alone, -potential: that is conservative, -mixture: with a gradient
            and a rotational part, -time: that changes with time; ude: the paper's
            network of position and time; physics-only: nothing (fits --train); nn-only:
            a black box in place of all physics. Unless given: the model that the system
            names, and where that is kernel-potential, kernel-mixture if the evidence of
            planar data prefers it.
        train: Known constants to learn beside the unknown; drag: an anisotropic drag
            tensor in place of the known drag.
        seed: Seed of the network.
        width: Neurons of each hidden layer.
        depth: Number of hidden layers.
    """

    model: ModelName | None = None
    train: tuple[Literal["damping", "gain", "drag"], ...] = ()
    system: SystemName = None
    seed: int = 0
    width: Annotated[int, Range(1, most=4096)] = 32
    depth: Annotated[int, Range(1, most=64)] = 2

    def check_together(self) -> None:
        if self.model is None or not self.model.startswith(("kernel-", "physics-")):
            return
        plain = FitSettings()
        for name in ("seed", "width", "depth"):
            if getattr(self, name) != getattr(plain, name):
                raise InputError(
                    f"--{name}: the model {self.model} has no network; drop it or "
                    "choose a neural model"
                )


class FitOptions(FilesOptions, frozen=True, kw_only=True):
    """Fit a model of the unknown force to trajectories or to a recording.

    Trajectories: an .npz or .csv file of pinav. A CSV file has the columns t, x, y, vx,
    vy and, for several trajectories, trajectory; an empty cell is a missing
    observation. The recipe bayes needs positions alone: vx, vy may be missing.

    A recording: the file of a tracker (pinav inspect says what it holds); --reading
    says how it is read. First pinav identify finds how the swimmer
    responds to its commands.

    The recipe (--recipe default, bayes, langevin, curriculum, paper) has options of its
    own, which pinav fit --recipe NAME --help shows.
    """

    settings: FitSettings = FitSettings()
    recipe: Recipe = Suited()
    reading: ReadingWords = PLAIN
