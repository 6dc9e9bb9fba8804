"""What a process holds of compiled programs."""

import jax
import jax.numpy as jnp
import pytest

from pinav import numerics
from pinav.numerics import free_programs


@pytest.fixture
def regions(tmp_path, monkeypatch):
    """A list of three regions of memory."""
    monkeypatch.setattr(numerics, "MANY_REGIONS", 2)
    file = tmp_path / "maps"
    file.write_text("7f00-7f01\n7f01-7f02\n7f02-7f03\n", encoding="utf-8")
    return file


def test_programs_go_where_they_hold_many_regions(regions):
    traced = []

    @jax.jit
    def double(x):
        traced.append(x)
        return 2 * x

    double(jnp.asarray(1.0))
    double(jnp.asarray(2.0))
    assert len(traced) == 1
    assert free_programs(regions)
    assert double(jnp.asarray(3.0)) == 6.0
    assert len(traced) == 2


def test_programs_stay_where_few_or_none_are_held(regions, monkeypatch, tmp_path):
    with monkeypatch.context() as patch:
        patch.delitem(numerics.sys.modules, "jax")  # which is not imported for it
        assert not free_programs(regions)
    monkeypatch.setattr(numerics, "MANY_REGIONS", 3)
    assert not free_programs(regions)
    assert not free_programs(tmp_path / "no such file")  # not Linux
