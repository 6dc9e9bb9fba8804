"""Many pieces of work: a table of cells, done once each, by any engine.

A cell is text; its result is a folder that is written whole. Workers in this process,
in processes of this machine or on a Dask cluster leave the same files.
"""

from pinav.sweeps.cell import Cell, Outcome
from pinav.sweeps.cluster import DaskCluster, TlsFiles
from pinav.sweeps.engines import AbstractEngine, InThisProcess, WorkerDeath
from pinav.sweeps.engines import OfExecutor as OfExecutor
from pinav.sweeps.processes import LocalProcesses
from pinav.sweeps.status import CellState, SweepStatus, sweep_status
from pinav.sweeps.store import CellStore, claim
from pinav.sweeps.sweep import run_sweep

__all__ = [
    "AbstractEngine",
    "Cell",
    "CellState",
    "CellStore",
    "DaskCluster",
    "InThisProcess",
    "LocalProcesses",
    "OfExecutor",
    "Outcome",
    "SweepStatus",
    "TlsFiles",
    "WorkerDeath",
    "claim",
    "run_sweep",
    "sweep_status",
]
