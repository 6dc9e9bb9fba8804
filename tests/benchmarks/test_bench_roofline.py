"""The roofline: what a machine cannot beat, and small pieces of every hot path."""

import jax
import pytest
from benchmarks.roofline import HEADER, Machine, Work, bioheat, evidence, recording

from benchmarks import roofline


def test_the_longer_of_both_times_is_the_least():
    machine = Machine(operations=1e9, traffic=1e8)
    assert machine.least_time(Work("sums", 1e9, 1e6, 2.0)) == pytest.approx(1.0)
    assert machine.least_time(Work("copies", 1e6, 1e9, 20.0)) == pytest.approx(10.0)


def test_a_row_states_the_share_that_is_reached():
    row = Work("copies", 1e6, 1e9, 20.0).row(Machine(1e9, 1e8))
    assert row.split()[-2:] == ["50", "%"]
    assert len(HEADER.split()) == 9


@pytest.mark.slow
def test_small_pieces_of_work_are_measured():
    with jax.numpy_dtype_promotion("standard"):
        machine = Machine.measure(side=200, length=2**20)
        small = [bioheat(8), evidence(16), recording(32)]
    for work in small:
        assert work.seconds > 0
        # Bounds that are beaten would be counted wrongly; caches may help a little.
        assert machine.least_time(work) < 3 * work.seconds


@pytest.mark.slow
def test_the_table_has_a_row_for_each(capsys, monkeypatch):
    monkeypatch.setattr(Machine, "measure", classmethod(lambda cls: cls(1e10, 1e10)))
    monkeypatch.setattr(roofline, "works", lambda: [Work("nothing", 1.0, 1.0, 1.0)])
    roofline.main([])
    assert "nothing" in capsys.readouterr().out
