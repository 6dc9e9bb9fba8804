"""Origin of a recording's trajectories: run, particle, segment, and pixels."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.trajectories import Trajectories


def labels(trajectories: Trajectories) -> list[dict[str, str | int]]:
    """Run, particle and segment of each trajectory, after selections and joins too.

    Args:
        trajectories: of a recording, whole or selected, or several joined.

    Raises:
        InputError: they were not read from a recording.
    """
    several = _labels(trajectories.provenance)
    if several is None or len(several) != len(trajectories):
        raise InputError(
            "labels: these trajectories say nothing of runs and particles; expected "
            "those that read_recording gives"
        )
    return several


def _labels(provenance: Mapping[str, Any]) -> list[dict[str, str | int]] | None:
    if "concatenated" in provenance:
        parts = [_labels(part) for part in provenance["concatenated"]]
        known = [label for part in parts if part is not None for label in part]
        several = known if None not in parts else None
    else:
        several = provenance.get("trajectories")
    if several is None or "selection" not in provenance:
        return several
    return [several[index] for index in provenance["selection"]]


def groups(
    trajectories: Trajectories, *names: str
) -> dict[tuple[str | int, ...], list[int]]:
    """Indices of the trajectories with the same labels, in order of appearance.

    Args:
        trajectories: of a recording.
        names: labels that tell groups apart; run and particle unless given.

    Raises:
        InputError: they were not read from a recording, or have no such label.
    """
    names = names or ("run", "particle")
    indices: dict[tuple[str | int, ...], list[int]] = {}
    for index, label in enumerate(labels(trajectories)):
        for name in names:
            if name not in label:
                raise InputError(
                    f"groups: no label {name!r}; expected some of {', '.join(label)}"
                )
        indices.setdefault(tuple(label[name] for name in names), []).append(index)
    return indices


def image_positions(
    recording: Trajectories, positions: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Positions in pixels, as the file of a recording has them; in images, y down.

    Args:
        recording: whose scale and flip are undone; whole or selected.
        positions: observed ones, or those of a model [L].

    Raises:
        InputError: the recording was not read from pixels.
    """
    done = recording.provenance.get("positions", {})
    if done.get("unit in the file") != "px":
        raise InputError(
            "image: positions were not read from pixels; read the recording with mpp "
            "from a file that has them"
        )
    flip = -1.0 if done["y flipped"] else 1.0
    return np.asarray(positions) / done["scale"] * np.array([1.0, flip])
