"""Many pieces of work: a table of cells, done once each by the workers of Dask.

A cell is text; its result is a folder that is written whole. Workers that are processes
of this machine or of any other leave the same files.
"""

from pinav.sweeps.cluster import Cluster as Cluster
from pinav.sweeps.cluster import cluster_at as cluster_at
from pinav.sweeps.cluster import local_cluster as local_cluster
from pinav.sweeps.store import Cell as Cell
from pinav.sweeps.store import CellOutcome as CellOutcome
from pinav.sweeps.store import CellStore as CellStore
from pinav.sweeps.store import claim as claim
from pinav.sweeps.sweep import CellState as CellState
from pinav.sweeps.sweep import OpenCluster as OpenCluster
from pinav.sweeps.sweep import SweepStatus as SweepStatus
from pinav.sweeps.sweep import map_cells as map_cells
from pinav.sweeps.sweep import sweep_status as sweep_status
