"""Options of `pinav analyse`."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import AsJson, Range, Settings


class AnalyseOptions(Settings, frozen=True, kw_only=True):
    """Map what a fit learned, and what it depends on; adds to its report.

    Writes analysis.json, analysis-*.csv, figures and sections of report.html: gradient
    and rotational part of the force, potential, signal to noise, influence of each
    trajectory and constant, dependence of rollouts on start and parameters. What needs
    a posterior is left out where the run has none.

    Attributes:
        run: Folder of a run of pinav fit.
        points: Grid points along each side of the maps.
        draws: Posterior samples behind the spread of fractions.
        samples: Samples of the Sobol' indices, a power of two.
        reference: Trajectory whose rollout is varied; counted from 0.
        relative: Half range of damping, gain and strength of the environment, relative
            to their values.
        shift: Half range of each coordinate of the start, in units of length.
        seed: Seed of all random numbers.
    """

    run: tyro.conf.Positional[Path]
    points: Annotated[int, Range(5)] = 41
    draws: Annotated[int, Range(2)] = 32
    samples: Annotated[int, Range(2, doubling=True)] = 256
    reference: Annotated[int, Range(0)] = 0
    relative: Annotated[float, Range(above=0, below=1)] = 0.1
    shift: Annotated[float, Range(above=0)] = 0.1
    seed: int = 0
    json: AsJson = False
