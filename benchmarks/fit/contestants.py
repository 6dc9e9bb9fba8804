"""Who takes part, and how much work each is given. Imports nothing heavy."""

import importlib.util
from typing import Literal

import msgspec

ScenarioName = Literal["paper", "barrier-crossings"]


class Effort(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How far the recipes go.

    Attributes:
        adam_steps: of the paper's recipe; 7500 in the paper.
        lbfgs_steps: of the paper's recipe; 500 in the paper.
        gauss_newton_steps: of each window of our default recipe, at most.
        marquardt_steps: of optimistix's Levenberg-Marquardt, at most.
        seconds: after which the training loop of another tool is cut short [s].
    """

    adam_steps: int = 7500
    lbfgs_steps: int = 500
    gauss_newton_steps: int = 20
    marquardt_steps: int = 200
    seconds: float = 300.0


class Contestant(msgspec.Struct, frozen=True):
    """One row of the table.

    Attributes:
        name: what files and `--only` call it.
        label: what the table calls it.
        scenario: what it is fitted to.
        train: module of this package, and its function.
        packages: what must be installed beyond pinav itself.
        seeded: whether a seed changes it: that of the network on `paper`, that of the
            noise on `barrier-crossings`.
    """

    name: str
    label: str
    scenario: ScenarioName
    train: str
    packages: tuple[str, ...] = ()
    seeded: bool = True

    def missing(self) -> list[str]:
        """Packages that are not installed."""
        return [p for p in self.packages if importlib.util.find_spec(p) is None]


CONTESTANTS = (
    Contestant("paper-recipe", "paper's recipe, pinav", "paper", "ours:paper_network"),
    Contestant(
        "paper-diffrax", "paper's recipe, diffrax", "paper", "diffrax_adam:train"
    ),
    Contestant(
        "paper-torch",
        "paper's recipe, torchdiffeq",
        "paper",
        "torch_adam:train",
        ("torch", "torchdiffeq"),
    ),
    Contestant("optimistix", "optimistix LM", "paper", "marquardt:train"),
    Contestant("ude", "ours, network", "paper", "ours:network"),
    Contestant("ude-kernel", "ours, kernel", "paper", "ours:kernel", seeded=False),
    Contestant(
        "sfi",
        "SFI, positions, drag and thrust too",
        "barrier-crossings",
        "force_inference:train",
        ("SFI",),
    ),
    Contestant(
        "positions-learn",
        "ours, positions, drag and thrust too",
        "barrier-crossings",
        "ours:positions_and_constants",
    ),
    Contestant("positions", "ours, positions", "barrier-crossings", "ours:positions"),
    Contestant("states", "ours, four states", "barrier-crossings", "ours:states"),
)

BY_NAME = {contestant.name: contestant for contestant in CONTESTANTS}

OURS = {"paper": "ude", "barrier-crossings": "positions-learn"}
"""The row that the others of its scenario are divided by."""
