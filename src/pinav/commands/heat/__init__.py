"""Options of `pinav heat`."""

from pathlib import Path
from typing import Literal

import tyro

from pinav.commands.settings import RunOptions


class HeatOptions(RunOptions, frozen=True, kw_only=True):
    """Bioheat with magnetic heating: synthetic cases of a research code.

    simulate: temperature and dose of a case; learn: perfusion from probes, with a
    band; optimise: the protocol of largest dose in the tumour under the limits of the
    case. A case is a
    TOML file (docs/thermal.md, examples/heat). Perfusion takes a unit: 1/s, kg/m3/s,
    ml/min/kg or ml/min/100g. Not for planning a treatment.

    Attributes:
        task: What to do.
        case: TOML file of the case.
    """

    task: tyro.conf.Positional[Literal["simulate", "learn", "optimise"]]
    case: tyro.conf.Positional[Path]
    out: Path = Path("runs/heat")
