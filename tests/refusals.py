"""Tables of what is refused, each with its message in one line."""

from collections.abc import Callable
from typing import Any

import pytest
from tests.defects import told


def refusals(*cases: tuple[Callable[[], Any], str]):
    """A test that each of some calls is refused, with a message that says why.

        test_bad_arguments_are_named = refusals(
            (lambda: LinearDrag(-0.1), "LinearDrag.damping: expected >= 0, got -0.1"),
        )

    Args:
        cases: a call, and a regular expression that its message matches.
    """

    @pytest.mark.parametrize(("make", "message"), cases)
    def refuse(make, message):
        with told(message) as caught:
            make()
        assert "\n" not in str(caught.value)

    return refuse
