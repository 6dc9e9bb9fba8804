"""GEFF, the graph exchange file format: a folder of Zarr arrays."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.zarr_arrays import Group
from pinav.recordings.rows import Tracks, varying
from pinav.recordings.source import AbstractFormat, Source


@final
class Geff(AbstractFormat):
    """Nodes with the axes x, y, z and t, and edges from one frame to the next; y down.

    Particles are the tracklets that the metadata name, and otherwise stretches of edges
    without a branch. Scale and offset of an axis are applied.
    """

    name = "geff"

    def suits(self, source: Source) -> bool:
        return source.kind == "folder" and is_zarr(source.path)

    def tracks(self, source: Source) -> Tracks:
        group = _graph(source.path)
        said: Any = group.attributes()["geff"]
        axes = {a["name"]: a for a in said.get("axes") or ({"name": n} for n in "tzyx")}
        names = _names(axes, said.get("display_hints") or {})
        values, unit_of = {}, {}
        for quantity, name in names.items():
            column = group.array(f"nodes/props/{name}/values")
            if column is not None:
                column = column.astype(np.float64)
                values[quantity], unit_of[quantity] = _scale(column, axes[name])
        for quantity in ("x", "y", "t"):
            if quantity not in values:
                raise InputError(
                    f"axes {', '.join(axes)}: {quantity} is not among them; name it in "
                    "the metadata, or export the nodes as CSV and give --columns"
                )
        factor, length_unit = units.length(unit_of["x"])
        rate, time_unit = units.duration(unit_of["t"])
        frames = time_unit in ("frame", "?")
        z = varying(values["z"]) if "z" in values else None
        return Tracks(
            x=factor * values["x"],
            y=factor * values["y"],
            z=None if z is None else factor * z,
            place=lambda row: f"node {row}",
            particle=[str(one) for one in _particles(group, said)],
            frame=np.round(values["t"]).astype(np.int64) if frames else None,
            time=None if frames else rate * values["t"],
            length_unit=length_unit,
            time_unit="frame" if frames else time_unit,
            columns={"frame": names["t"], "time": names["t"]},
        )


def is_zarr(folder: Path) -> bool:
    """True if a folder is a Zarr group of version 2 or 3, or is named like one."""
    group = any((folder / name).is_file() for name in ("zarr.json", ".zgroup"))
    return group or folder.suffix in (".zarr", ".geff")


def _graph(folder: Path) -> Group:
    """The group of the graph: the folder itself, or the only one in it that is one."""
    root = Group(folder)
    if "geff" in root.attributes():
        return root
    graphs = [group for group in root.groups() if "geff" in group.attributes()]
    if len(graphs) != 1:
        names = ", ".join(graph.path.name for graph in graphs) or "none"
        raise InputError(
            f"expected one graph of GEFF, got {names}; give its folder, or export "
            "its nodes as CSV and give --columns frame=t x=x y=y particle=track"
        )
    return graphs[0]


def _names(axes: Mapping[str, Any], hints: Mapping[str, str]) -> dict[str, str]:
    """The axis of each quantity: as it is to be displayed, else by its name."""
    shown = {"x": "horizontal", "y": "vertical", "z": "depth", "t": "time"}
    named = {q: hints.get(f"display_{shown[q]}") or q for q in shown}
    timed = [name for name, axis in axes.items() if axis.get("type") == "time"]
    if named["t"] not in axes and len(timed) == 1:
        named["t"] = timed[0]
    return {q: name for q, name in named.items() if name in axes}


def _scale(
    values: Float64[np.ndarray, " node"], axis: Mapping[str, Any]
) -> tuple[Float64[np.ndarray, " node"], str]:
    scale, offset = axis.get("scale"), axis.get("offset")
    unit = axis.get("unit") if scale is None else axis.get("scaled_unit")
    return values * (scale or 1.0) + (offset or 0.0), unit or ""


def _particles(group: Group, said: Mapping[str, Any]) -> Int64[np.ndarray, " node"]:
    name = (said.get("track_node_props") or {}).get("tracklet")
    tracklets = None if name is None else group.array(f"nodes/props/{name}/values")
    if tracklets is not None:
        return tracklets.astype(np.int64)
    ids, edges = group.array("nodes/ids"), group.array("edges/ids")
    if ids is None or edges is None:
        raise InputError("ids of nodes or of edges are missing; export the graph again")
    order = np.argsort(ids)
    ends = order[np.searchsorted(ids, edges.reshape(-1, 2), sorter=order)]
    count = len(ids)
    out, into = (np.bincount(side, minlength=count) for side in ends.T)
    alone = ends[(out[ends[:, 0]] == 1) & (into[ends[:, 1]] == 1)]
    links = coo_array((np.ones(len(alone)), tuple(alone.T)), (count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)
