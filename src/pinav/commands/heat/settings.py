"""Options of `pinav heat`."""

from pathlib import Path
from typing import Literal

import tyro

from pinav.commands.settings import RunOptions
from pinav.errors import InputError


class HeatOptions(RunOptions, frozen=True, kw_only=True):
    """Bioheat with magnetic heating: synthetic cases of a research code.

    verify: errors of the solver against exact solutions, on this machine; simulate:
    temperature and dose of a case; learn: perfusion from probes, with a band; optimise:
    the protocol of largest dose in the tumour under the limits of the case. A case is a
    TOML file (docs/thermal.md, examples/heat). Perfusion takes a unit: 1/s, kg/m3/s,
    ml/min/kg or ml/min/100g. Not for planning a treatment.

    Attributes:
        task: What to do.
        case: TOML file of the case; verify needs none.
    """

    task: tyro.conf.Positional[Literal["verify", "simulate", "learn", "optimise"]]
    case: tyro.conf.Positional[Path | None] = None
    out: Path = Path("runs/heat")

    def check_together(self) -> None:
        if self.case is None and self.task != "verify":
            raise InputError(
                f"heat {self.task}: expected the TOML file of a case, got none; "
                "examples/heat has some"
            )
        if self.case is not None and self.task == "verify":
            raise InputError(
                f"heat verify: expected no case, got {self.case}; leave it out"
            )
