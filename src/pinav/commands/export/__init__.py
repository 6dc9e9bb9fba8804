"""Options of `pinav export`."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.settings import AsJson, Range, Settings

FormatName = Literal["netcdf", "napari", "trackmate"]


class ExportOptions(Settings, frozen=True, kw_only=True):
    """Write what a run has learned in the formats of other programs.

    napari and trackmate are tables of spots: each observed position with the learned
    force there and its standard deviation, so that the tracks can be coloured by the
    force in these programs. netcdf holds draws from the posterior, predictions and
    the observed data, as xarray and ArviZ read them.

    Attributes:
        run: Folder of a fit.
        to: "netcdf" (posterior, predictions and data), "napari" (CSV of a tracks
            layer) or "trackmate" (CSV as TrackMate exports it).
        out: File to write.
        draws: Draws from the posterior in a NetCDF file.
        points: Points of the force map along each side in a NetCDF file.
        seed: Of the draws.
        overwrite: Replace the file.
        json: Print what was written as JSON, for scripts, and nothing else.
    """

    run: tyro.conf.Positional[Path]
    to: FormatName
    out: Path
    draws: Annotated[int, Range(least=1)] = 100
    points: Annotated[int, Range(least=2)] = 41
    seed: Annotated[int, Range(least=0)] = 0
    overwrite: bool = False
    json: AsJson = False
