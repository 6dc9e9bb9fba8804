"""Scenarios whose starts follow a rule: each key draws others, and any number."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from jaxtyping import PRNGKeyArray

from pinav.systems import System


@runtime_checkable
class Scenario(Protocol):
    """A named system."""

    def __call__(
        self, key: PRNGKeyArray | None = None, count: int | None = None
    ) -> System:
        """The system, its starts drawn by its rule.

        Args:
            key: random key of the starts; `jax.random.key(0)` unless given.
            count: number of trajectories; the scenario's own number unless given.
        """
        ...


def with_random_starts(build: Callable[[], System]) -> Scenario:
    """A scenario from a function that states a system and the rule of its starts."""

    def scenario(key: PRNGKeyArray | None = None, count: int | None = None) -> System:
        return build().with_starts(key, count)

    scenario.__doc__, scenario.__name__ = build.__doc__, build.__name__
    return scenario
