"""Systems by what a user writes: a scenario's name, a file, a name in a Python file."""

from collections.abc import Mapping
from typing import Any

from jaxtyping import PRNGKeyArray

from pinav.errors import InputError
from pinav.scenarios.catalogue import SCENARIOS, scenario
from pinav.systems import System, parse_system, read_system


def find_system(
    text: str, key: PRNGKeyArray | None = None, *, count: int | None = None
) -> System:
    """The system of a scenario's name, a file `my.toml`, or `my.py:name`.

    Args:
        text: which system; naming a Python file runs it.
        key: random key of its starts, where a rule draws them.
        count: number of trajectories, where a rule draws the starts.

    Raises:
        InputError: there is no such system, or its file is at fault.
    """
    if text in SCENARIOS:
        return scenario(text, key, count=count)
    if not (text.endswith(".toml") or ".py:" in text):
        raise InputError(
            f"system {text!r} is unknown; name a file such as my.toml, my.py:name, or "
            f"one of the scenarios: {', '.join(sorted(SCENARIOS))}"
        )
    system = read_system(text)
    if count is None and not (key is not None and system.starts_follow_rule):
        return system
    return system.with_starts(key, count)


def source_system(provenance: Mapping[str, Any]) -> System | None:
    """The system that data were simulated from; None where they do not say so.

    Args:
        provenance: of trajectories.

    Raises:
        InputError: the text of the system is damaged, or it names Python code.
    """
    if text := provenance.get("system"):
        return parse_system(str(text))
    name = provenance.get("scenario")
    return SCENARIOS[name]() if name in SCENARIOS else None
