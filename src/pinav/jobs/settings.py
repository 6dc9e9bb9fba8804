"""Settings of the jobs: strict, nested in nothing, readable as TOML.

Only these decide the numbers of a run; where it is written does not belong here.
This module imports no numerical library, so that `--help` is quick.
"""

from typing import Annotated, Literal

import msgspec
import tyro

from pinav.errors import InputError

RecipeName = Literal["default", "paper"]


class ReproduceSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of `pinav reproduce`."""

    recipe: Annotated[
        RecipeName,
        tyro.conf.arg(
            help="default: Gauss-Newton, from one-step matching to the full rollout; "
            "paper: Adam, then L-BFGS, as in its Table 1."
        ),
    ] = "default"
    seeds: Annotated[
        tuple[int, ...],
        tyro.conf.arg(help="Seeds of the networks; several train in one batch."),
    ] = (42,)
    max_steps: Annotated[
        int, tyro.conf.arg(help="Default recipe: steps of each window at most.")
    ] = 20
    adam_steps: Annotated[
        int, tyro.conf.arg(help="Paper's recipe: steps of Adam (7500 in the paper).")
    ] = 7500
    lbfgs_steps: Annotated[
        int, tyro.conf.arg(help="Paper's recipe: steps of L-BFGS (500 in the paper).")
    ] = 500

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if not self.seeds:
            raise InputError("--seeds: expected at least one seed, such as --seeds 42")
        repeated = [seed for seed in self.seeds if self.seeds.count(seed) > 1]
        if repeated:
            raise InputError(f"--seeds: {repeated[0]} is given twice; drop one")
        _check_counts(self, "max_steps", "adam_steps", "lbfgs_steps")


class SimulateSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of `pinav simulate`."""

    seed: Annotated[
        int, tyro.conf.arg(help="Seed of random starts and observation noise.")
    ] = 0
    noise: Annotated[
        float | None,
        tyro.conf.arg(help="Standard deviation of observation noise, in every state."),
    ] = None
    count: Annotated[
        int | None,
        tyro.conf.arg(
            help="Number of trajectories; that of the scenario unless given. More of a "
            "seed begin with the same ones."
        ),
    ] = None
    frame_loss: Annotated[
        float, tyro.conf.arg(help="Probability that a sample is missing.")
    ] = 0.0
    positions_only: Annotated[
        bool, tyro.conf.arg(help="Leave the velocities unobserved.")
    ] = False

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if self.noise is not None and self.noise < 0:
            raise InputError(f"--noise: expected 0 or more, got {self.noise}")
        if not 0 <= self.frame_loss < 1:
            raise InputError(
                f"--frame-loss: expected from 0 to below 1, got {self.frame_loss}"
            )
        if self.count is not None:
            _check_counts(self, "count")


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


class FitSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
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
        _check_counts(self, "width", "depth", "max_steps", "adam_steps", "lbfgs_steps")
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


Candidate = Literal[
    "kernel-potential",
    "kernel-force",
    "kernel-mixture",
    "kernel-potential-time",
    "first-order",
    "isotropic-drag",
    "anisotropic-drag",
    "neural-potential",
    "neural-force",
    "physics-only",
]


class CompareSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of `pinav compare`."""

    models: Annotated[
        tuple[Candidate, ...],
        tyro.conf.arg(
            help="Models to compare. kernel-, neural-: as in pinav fit; physics-only: "
            "no environment; first-order: a kernel potential without inertia "
            "(positions alone); isotropic-drag, anisotropic-drag: a kernel potential, "
            "with the drag learned too."
        ),
    ] = ("kernel-potential", "kernel-force", "kernel-mixture")
    noise: Annotated[
        float | None,
        tyro.conf.arg(
            help="Standard deviation of the observations; estimated unless given."
        ),
    ] = None
    physics: Annotated[
        str | None,
        tyro.conf.arg(
            help="Scenario that supplies propulsion and drag; the one that the data "
            "were simulated from unless given."
        ),
    ] = None
    max_steps: Annotated[int, tyro.conf.arg(help="Steps of each fit at most.")] = 20

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        _check_counts(self, "max_steps")
        if len(set(self.models)) < 2:
            raise InputError(
                "--models: expected two or more different ones, such as --models "
                "kernel-potential kernel-force"
            )


def _check_counts(settings: msgspec.Struct, *names: str) -> None:
    for name in names:
        value = getattr(settings, name)
        if value < 1:
            option = name.replace("_", "-")
            raise InputError(f"--{option}: expected 1 or more, got {value}")


class AnalyseSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of `pinav analyse`."""

    points: Annotated[
        int, tyro.conf.arg(help="Grid points along each side of the maps.")
    ] = 41
    draws: Annotated[
        int, tyro.conf.arg(help="Posterior samples behind the spread of fractions.")
    ] = 32
    samples: Annotated[
        int, tyro.conf.arg(help="Samples of the Sobol' indices, a power of two.")
    ] = 256
    reference: Annotated[
        int,
        tyro.conf.arg(
            help="Trajectory whose rollout is varied; counted from 0.",
        ),
    ] = 0
    relative: Annotated[
        float,
        tyro.conf.arg(
            help="Half range of damping, gain and strength of the environment, "
            "relative to their values."
        ),
    ] = 0.1
    shift: Annotated[
        float,
        tyro.conf.arg(
            help="Half range of each coordinate of the start, in units of length."
        ),
    ] = 0.1
    seed: Annotated[int, tyro.conf.arg(help="Seed of all random numbers.")] = 0

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        _check_counts(self, "samples")
        for name, least in (("points", 5), ("draws", 2), ("reference", 0)):
            if getattr(self, name) < least:
                raise InputError(
                    f"--{name}: expected {least} or more, got {getattr(self, name)}"
                )
        if self.samples & (self.samples - 1) or self.samples < 2:
            raise InputError(
                f"--samples: expected a power of two, such as 256, got {self.samples}"
            )
        if not 0 < self.relative < 1:
            raise InputError(
                f"--relative: expected between 0 and 1, got {self.relative}"
            )
        if not 0 < self.shift < float("inf"):
            raise InputError(f"--shift: expected a length > 0, got {self.shift}")
