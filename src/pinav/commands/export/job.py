"""`pinav export`: what a run has learned, in the formats of other programs."""

import importlib.util
from typing import BinaryIO

from pinav.commands.command import CommandResult
from pinav.commands.export import ExportOptions
from pinav.commands.export.datatree import MISSING, datatree_of
from pinav.commands.export.spots import SpotTable, napari_csv, spot_table, trackmate_csv
from pinav.errors import InputError
from pinav.files import atomic_write, check_destination
from pinav.learning.learned import Learned


def run(options: ExportOptions) -> CommandResult:
    """Write one file.

    Raises:
        InputError: the folder holds no fit of a force, the file exists, or a package
            that writes the format is not installed.
    """
    check_destination(options.out, overwrite=options.overwrite)
    fit = Learned.open(options.run)
    table = spot_table(fit)
    content = _content(fit, table, options)

    def write(file: BinaryIO) -> None:
        file.write(content)

    atomic_write(options.out, write, overwrite=options.overwrite)
    spots = len(table.time)
    written = {"file": str(options.out), "format": options.to, "spots": spots}
    return CommandResult(written, f"{options.out}: {spots} spots, {options.to}")


def _content(fit: Learned, table: SpotTable, options: ExportOptions) -> bytes:
    """The bytes of the file."""
    if options.to == "napari":
        return napari_csv(table).encode()
    if options.to == "trackmate":
        return trackmate_csv(table).encode()
    if importlib.util.find_spec("h5netcdf") is None:
        raise InputError(MISSING.format("h5netcdf"))
    tree = datatree_of(
        fit, draws=options.draws, points=options.points, seed=options.seed
    )
    return bytes(tree.to_netcdf(engine="h5netcdf"))
