"""Every figure of the pages: `python -m docs.figures.draw [NAME.png ...]`.

Runs that a figure needs are made below `runs/figures` and kept there, so that a second
call draws again without fitting again. The pictures are written beside this file.
"""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

import jax
from docs.figures import methods, scenarios
from docs.figures.tutorials import from_tutorial, one_shot, swimmer
from docs.figures.workshop import Workshop, save_picture
from matplotlib.figure import Figure

HERE = Path(__file__).parent

Recipe = Callable[[Workshop], Figure | Path]
"""Draws a figure, or names the picture that a run has drawn."""


def figure1(workshop: Workshop) -> Path:
    """The paper's Figure 1 by the paper's recipe."""
    words = ("reproduce", "--recipe", "paper", "--seeds", "42")
    return workshop.run("paper", *words) / "figures" / "figure1-ude.png"


def convergence(workshop: Workshop) -> Path:
    """Error over wall time of three fits; times are those of the machine."""
    words = ("fit", "--only", "paper-recipe", "ude", "ude-kernel")
    return workshop.run("bench", *words, module="benchmarks") / "convergence.png"


def designs(workshop: Workshop) -> Path:
    """How well a way is known after each trajectory of simulated campaigns."""
    places = ("--from=1,5", "--to=9,5", "--arena=0,0,10,10", "--tolerance", "0.4")
    words = ("design", "shear", *places, "--thrust", "1.5", "--noise", "0.05")
    run = workshop.run("designs", *words, "--seeds", "3")
    return run / "figures" / "design-bounds.png"


RECIPES: Mapping[str, Recipe] = {
    "figure1-ude.png": figure1,
    "scenarios.png": scenarios.figure,
    "convergence.png": convergence,
    "designs.png": designs,
    "method-models.png": methods.models,
    "method-identification.png": methods.identification,
    "method-evaluation.png": methods.evaluation,
    "method-analysis.png": methods.analysis,
    "method-discovery.png": methods.discovery,
    "method-adaptive.png": methods.adaptive,
    "method-thermal.png": methods.thermal,
    "tutorial-swimmer.png": swimmer,
    "tutorial-field.png": from_tutorial("tracker", "field", "force"),
    "tutorial-route.png": from_tutorial("tracker", "there", "navigate-closed-loop"),
    "tutorial-wall.png": from_tutorial("bead", "wall", "truth-wall-0"),
    "tutorial-one-shot.png": one_shot,
    "tutorial-perfusion.png": from_tutorial("bioheat", "learn", "heat-perfusion"),
    "tutorial-protocol.png": from_tutorial("bioheat", "optimise", "heat-protocol"),
}
"""By the names of the pictures."""


def main() -> None:
    """Draw the figures that are named, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*RECIPES, []])
    parser.add_argument("--work", type=Path, default=Path("runs/figures"))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", val=True)
    workshop = Workshop(arguments.work)
    for name in arguments.names or RECIPES:
        save_picture(RECIPES[name](workshop), HERE / name)
        print(HERE / name, flush=True)


if __name__ == "__main__":
    main()
