"""Which run, particle and segment of a recording a trajectory was."""

from collections.abc import Mapping
from typing import Any

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
