"""Registries of defects, each with the message that it must bring."""

import contextlib

import pytest

from pinav.errors import InputError


def defects(names, cases):
    """A test for each case, known by its message, which stands last."""
    return pytest.mark.parametrize(names, cases, ids=[case[-1] for case in cases])


@contextlib.contextmanager
def told(message):
    """An error of input with the message, in one line."""
    with pytest.raises(InputError, match=message) as caught:
        yield caught
    assert "\n" not in str(caught.value)
