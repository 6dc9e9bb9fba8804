"""Settings of `pinav fit`."""

from typing import Annotated, Literal

from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.settings import (
    ModelName,
    Range,
    Settings,
    SystemName,
)
from pinav.commands.worker_settings import FilesOptions
from pinav.errors import InputError

FitRecipeName = Literal["default", "bayes", "langevin", "curriculum", "paper"]


EVIDENCE_RECIPES = ("bayes", "langevin")
"""Recipes that choose by the evidence and give a posterior."""

THERMAL_OPTIONS = (
    *("observation", "diffusion", "coordinates", "period", "warp", "reference"),
)
"""Options of the recipe langevin, which [unknown] of a system file may state, too."""

MATCHED_MODELS = ("ude", "nn-only")
"""Models without evidence, which are matched to the trajectories."""


class FitSettings(Settings, frozen=True):
    """Settings of `pinav fit`.

    Attributes:
        model: What stands for the unknown. kernel-, neural-: a force that depends on
            position alone, -potential: that is conservative, -mixture: with a gradient
            and a rotational part, -time: that changes with time; ude: the paper's
            network of position and time; physics-only: nothing (fits --train); nn-only:
            a black box in place of all physics. Unless given: the model that the system
            names, and where that is kernel-potential, kernel-mixture if the evidence of
            planar data prefers it.
        recipe: bayes: noisy or incomplete data, every setting chosen by the evidence,
            with uncertainty; langevin: the same for thermal motion without inertia,
            with the diffusion coefficient; curriculum: noise-free data, Gauss-Newton
            from one-step matching to the full rollout; paper: Adam, then L-BFGS. The
            default is what suits the data: langevin for Brownian paths, curriculum for
            ude and nn-only, else bayes.
        noise: Recipe bayes: standard deviation of the observations; estimated unless
            given.
        structure: Recipe bayes, kernels and networks: search for a structure of the
            force (a centre, a wall, a linear flow), which the evidence may prefer to
            free kernels; a network learns from the fit of kernels that this gives;
            free: kernels alone.
        observation: Recipe langevin: exact: positions without error; learn: the camera
            averages over an exposure and errs, and both are learned, so that neither
            biases the diffusion or the force; known: both are what the system states.
            Exact unless given here or in [unknown] of the system file, as the next
            five.
        diffusion: Recipe langevin: constant: one number; field: it varies in space;
            tensor: it varies, and has a field of its own along each of --coordinates,
            and one along all others. Where the system has a thermal energy, the
            mobility follows from the diffusion (Einstein).
        coordinates: Recipe langevin: names of the coordinates on which force and
            diffusion depend, the force acting along them; all unless given.
        period: Recipe langevin: coordinates that repeat, with their period, such as
            x=6.2832.
        warp: Recipe langevin: coordinates whose kernels are finer at the end of the
            data where motion is slow, as near a wall.
        reference: Recipe langevin: the coordinate whose zero drifts slowly, such as the
            height above a wall that the focus leaves.
        train: Known constants to learn beside the unknown; drag: an anisotropic drag
            tensor in place of the known drag.
        seed: Seed of the network.
        width: Neurons of each hidden layer.
        depth: Number of hidden layers.
        max_steps: Recipes bayes, curriculum: steps (of a window) at most.
        adam_steps: Paper's recipe: steps of Adam.
        lbfgs_steps: Paper's recipe: steps of L-BFGS.
    """

    model: ModelName | None = None
    recipe: FitRecipeName = "default"
    noise: Annotated[float | None, Range(above=0)] = None
    structure: Literal["search", "free"] = "search"
    observation: Literal["exact", "learn", "known"] | None = None
    diffusion: Literal["constant", "field", "tensor"] | None = None
    coordinates: tuple[str, ...] = ()
    period: tuple[str, ...] = ()
    warp: tuple[str, ...] = ()
    reference: str | None = None
    train: tuple[Literal["damping", "gain", "drag"], ...] = ()
    system: SystemName = None
    seed: int = 0
    width: Annotated[int, Range(1)] = 32
    depth: Annotated[int, Range(1)] = 2
    max_steps: Annotated[int, Range(1)] = 20
    adam_steps: Annotated[int, Range(1)] = 7500
    lbfgs_steps: Annotated[int, Range(1)] = 500

    def check_together(self) -> None:
        if self.model == "nn-only" and self.train:
            raise InputError(
                "--train: the model nn-only has no physical constants; drop --train or "
                "choose another --model"
            )
        if self.model == "physics-only" and not self.train:
            raise InputError(
                "--model physics-only: there is nothing to fit; add --train damping"
            )
        if self.model in MATCHED_MODELS and self.recipe == "bayes":
            raise InputError(
                f"--recipe {self.recipe}: the model {self.model} has no evidence; "
                "choose --recipe curriculum, or a kernel or neural model"
            )
        if "drag" in self.train and "damping" in self.train:
            raise InputError("--train: drag takes the place of damping; drop one")
        matched = self.model in MATCHED_MODELS or self.recipe in ("curriculum", "paper")
        if "drag" in self.train and (matched or self.recipe == "langevin"):
            raise InputError("--train drag: only the recipe bayes does; drop it")
        if self.recipe == "langevin":
            self._check_langevin()
        elif self.recipe != "default":
            self._check_not_thermal()
        if self.noise is not None and (matched or self.recipe == "langevin"):
            raise InputError("--noise: only the recipe bayes uses it; drop --noise")
        self._check_unused()

    def _check_not_thermal(self) -> None:
        """Refuse options of thermal motion beside another recipe."""
        for name in THERMAL_OPTIONS:
            if getattr(self, name):
                raise InputError(
                    f"--{name}: only the recipe langevin uses it; drop it or choose "
                    "--recipe langevin"
                )

    @property
    def has_profile(self) -> bool:
        """Whether the force has coordinates of its own."""
        return bool(self.coordinates or self.period or self.warp)

    def _check_langevin(self) -> None:
        if self.model is not None and not self.model.startswith("kernel-"):
            raise InputError(
                f"--recipe langevin: expected a kernel model, got {self.model}; choose "
                "--model kernel-potential"
            )
        if self.train:
            raise InputError(
                "--recipe langevin: it learns no constant but diffusion; drop --train"
            )
        plain = (None, "kernel-potential", "kernel-force")
        if self.has_profile and self.model not in plain:
            raise InputError(
                f"--model {self.model}: a force that depends on --coordinates, with "
                "--period or --warp, is a model of its own; drop --model"
            )

    def _check_unused(self) -> None:
        """Refuse options that the chosen model and recipe never look at."""
        plain = FitSettings()
        for name in ("adam_steps", "lbfgs_steps"):
            if self.recipe != "paper" and getattr(self, name) != getattr(plain, name):
                option = name.replace("_", "-")
                raise InputError(
                    f"--{option}: only the recipe paper uses it; drop it or choose "
                    "--recipe paper"
                )
        if self.model is None or not self.model.startswith(("kernel-", "physics-")):
            return
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

    A recording: the file of a tracker (pinav inspect says what it holds); the options
    of pinav inspect say how it is read. First pinav identify finds how the swimmer
    responds to its commands.
    """

    settings: FitSettings = FitSettings()
    recording: RecordingSettings = RecordingSettings()
