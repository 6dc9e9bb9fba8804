"""Settings of `pinav fit`."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.settings import (
    AsJson,
    ConfigFile,
    OutFolder,
    Overwrite,
    Resume,
    Settings,
    check_counts,
)
from pinav.errors import InputError

ModelName = Literal[
    "kernel-potential",
    "kernel-force",
    "kernel-mixture",
    "kernel-potential-time",
    "neural-potential",
    "neural-force",
    "ude",
    "physics-only",
    "nn-only",
]


FitRecipeName = Literal["default", "bayes", "langevin", "curriculum", "paper"]


DEFAULT_RECIPES: dict[str, FitRecipeName] = {
    "ude": "curriculum",
    "nn-only": "curriculum",
}
"""What `--recipe default` means for a model; `bayes` for all others."""


class FitSettings(Settings, frozen=True):
    """Settings of `pinav fit`."""

    model: Annotated[
        ModelName,
        tyro.conf.arg(
            help="What stands for the unknown. kernel-, neural-: a force that depends "
            "on position alone, -potential: that is conservative, -mixture: with a "
            "gradient and a rotational part, -time: that changes with time; ude: the "
            "paper's "
            "network of position and time; physics-only: nothing (fits --learn); "
            "nn-only: a black box in place of all physics."
        ),
    ] = "kernel-potential"
    recipe: Annotated[
        FitRecipeName,
        tyro.conf.arg(
            help="bayes: noisy or incomplete data, every setting chosen by the "
            "evidence, with uncertainty; langevin: the same for thermal motion without "
            "inertia, with the diffusion coefficient; curriculum: noise-free data, "
            "Gauss-Newton from one-step matching to the full rollout; paper: Adam, "
            "then L-BFGS. The default is bayes, but curriculum for ude and nn-only."
        ),
    ] = "default"
    noise: Annotated[
        float | None,
        tyro.conf.arg(
            help="Recipe bayes: standard deviation of the observations; estimated "
            "unless given."
        ),
    ] = None
    learn: Annotated[
        tuple[Literal["damping", "gain", "drag"], ...],
        tyro.conf.arg(
            help="Known constants to learn beside the unknown; drag: an anisotropic "
            "drag tensor in place of the known drag."
        ),
    ] = ()
    physics: Annotated[
        str | None,
        tyro.conf.arg(
            help="Scenario that supplies propulsion and drag; the one that the data "
            "were simulated from unless given."
        ),
    ] = None
    seed: Annotated[int, tyro.conf.arg(help="Seed of the network.")] = 0
    width: Annotated[int, tyro.conf.arg(help="Neurons of each hidden layer.")] = 32
    depth: Annotated[int, tyro.conf.arg(help="Number of hidden layers.")] = 2
    max_steps: Annotated[
        int,
        tyro.conf.arg(help="Recipes bayes, curriculum: steps (of a window) at most."),
    ] = 20
    adam_steps: Annotated[int, tyro.conf.arg(help="Paper's recipe: steps of Adam.")] = (
        7500
    )
    lbfgs_steps: Annotated[
        int, tyro.conf.arg(help="Paper's recipe: steps of L-BFGS.")
    ] = 500

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        check_counts(self, "width", "depth", "max_steps", "adam_steps", "lbfgs_steps")
        if self.model == "nn-only" and self.learn:
            raise InputError(
                "--learn: the model nn-only has no physical constants; drop --learn or "
                "choose another --model"
            )
        if self.model == "physics-only" and not self.learn:
            raise InputError(
                "--model physics-only: there is nothing to fit; add --learn damping"
            )
        if self.model in DEFAULT_RECIPES and self.recipe == "bayes":
            raise InputError(
                f"--recipe bayes: the model {self.model} has no evidence; choose "
                "--recipe curriculum, or a kernel or neural model"
            )
        if "drag" in self.learn and "damping" in self.learn:
            raise InputError("--learn: drag takes the place of damping; drop one")
        if "drag" in self.learn and self.method != "bayes":
            raise InputError("--learn drag: only the recipe bayes does; drop it")
        if self.method == "langevin":
            self._check_langevin()
        if self.noise is not None and self.method != "bayes":
            raise InputError("--noise: only the recipe bayes uses it; drop --noise")

    def _check_langevin(self) -> None:
        if not self.model.startswith("kernel-"):
            raise InputError(
                f"--recipe langevin: expected a kernel model, got {self.model}; choose "
                "--model kernel-potential"
            )
        if self.learn:
            raise InputError(
                "--recipe langevin: it learns no constant but diffusion; drop --learn"
            )

    @property
    def method(self) -> str:
        """The recipe, with `default` resolved."""
        if self.recipe != "default":
            return self.recipe
        return DEFAULT_RECIPES.get(self.model, "bayes")


class FitOptions(Settings, frozen=True):
    """Fit a model of the unknown force to trajectories or to a recording.

    Trajectories: an .npz or .csv file of pinav. A CSV file has the columns t, x, y, vx,
    vy and, for several trajectories, trajectory; an empty cell is a missing
    observation. The recipe bayes needs positions alone: vx, vy may be missing.

    A recording: the file of a tracker (pinav inspect says what it holds); the options
    of pinav inspect say how it is read. First pinav identify finds how the swimmer
    responds to its commands.
    """

    data: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(help="Trajectories, .npz or .csv, or a recording of a tracker."),
    ]
    out: OutFolder
    settings: FitSettings = FitSettings()
    recording: RecordingSettings = RecordingSettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False
