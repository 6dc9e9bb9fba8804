"""Options of `pinav heat`."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.settings import (
    AsJson,
    OutFolder,
    Overwrite,
    Settings,
)
from pinav.errors import InputError


class HeatOptions(Settings, frozen=True):
    """Bioheat with magnetic heating: synthetic cases of a research code.

    verify: errors of the solver against exact solutions, on this machine; simulate:
    temperature and dose of a case; learn: perfusion from probes, with a band; optimise:
    the protocol of largest dose in the tumour under the limits of the case. A case is a
    TOML file (docs/thermal.md, examples/heat). Perfusion takes a unit: 1/s, kg/m3/s,
    ml/min/kg or ml/min/100g. Not for planning a treatment.
    """

    task: Annotated[
        Literal["verify", "simulate", "learn", "optimise"],
        tyro.conf.Positional,
        tyro.conf.arg(help="What to do."),
    ]
    case: Annotated[
        Path | None,
        tyro.conf.Positional,
        tyro.conf.arg(help="TOML file of the case; verify needs none."),
    ] = None
    out: OutFolder = Path("runs/heat")
    overwrite: Overwrite = False
    json: AsJson = False

    def check(self) -> None:
        """Raise `InputError` if a task has no case."""
        if self.case is None and self.task != "verify":
            raise InputError(
                f"heat {self.task}: expected the TOML file of a case, got none; "
                "examples/heat has some"
            )
