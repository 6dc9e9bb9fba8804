"""Systems by their names: built-in scenarios, files, names in a Python file."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

from jaxtyping import PRNGKeyArray

from pinav.errors import InputError
from pinav.systems import System, parse_system, read_system


@runtime_checkable
class Scenario(Protocol):
    """A named system."""

    def __call__(
        self, key: PRNGKeyArray | None = None, count: int | None = None
    ) -> System:
        """The system with starts of its rule, by default of `jax.random.key(0)`."""
        ...


SCENARIOS: dict[str, Scenario] = {}
"""Built-in scenarios by their names, in the order in which they are defined."""


def with_random_starts(build: Callable[[], System]) -> Scenario:
    """The scenario of a function that states a system and the rule of its starts.

    Its name is that of the function, with hyphens.
    """

    def scenario(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
        return build().with_starts(key, count)

    for name in ("__doc__", "__module__", "__name__"):
        setattr(scenario, name, getattr(build, name))
    SCENARIOS[build.__name__.replace("_", "-")] = scenario
    return scenario


def scenario(
    name: str, key: PRNGKeyArray | None = None, *, count: int | None = None
) -> System:
    """The system of that name, with its true environment.

    Args:
        key: random key of random starts.
        count: number of trajectories with random starts, the scenario's own by default;
            larger numbers begin with the same ones.

    Raises:
        InputError: no scenario has that name, or `count` is not positive.
    """
    if name not in SCENARIOS:
        known = ", ".join(sorted(SCENARIOS))
        raise InputError(f"scenario {name!r} is unknown; choose one of: {known}")
    return SCENARIOS[name](key, count)


def find_system(
    text: str, key: PRNGKeyArray | None = None, *, count: int | None = None
) -> System:
    """The system of a scenario, of `my.toml`, or of `my.py:name`, which is run.

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

    Raises:
        InputError: the text of the system is damaged, or it names Python code.
    """
    if text := provenance.get("system"):
        return parse_system(str(text))
    name = provenance.get("scenario")
    return SCENARIOS[name]() if name in SCENARIOS else None
