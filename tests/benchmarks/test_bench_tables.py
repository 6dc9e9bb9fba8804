"""Small benchmarks: their tables, and a small piece of what each measures."""

import jax
import numpy as np
import pytest
from benchmarks.roofline import HEADER, Machine, Work, bioheat, evidence, recording

from benchmarks import accelerator, growth, heat, roofline, start
from pinav.errors import FitError


def test_the_table_of_work_side_by_side_has_a_line_for_each_number(
    monkeypatch, tmp_path, capsys
):
    def row(number, *_):
        return accelerator.Row("work", number, 2.0, 0.5, 1.25, "result")

    monkeypatch.setattr(accelerator, "loops", row)
    monkeypatch.setattr(accelerator, "fits", row)
    words = ["--cells", "--fits", "1", "--loops", "5", "10"]
    accelerator.main([*words, "--out", str(tmp_path)])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("device: ")
    assert [line.split()[1:5] for line in lines[2:]] == [
        ["5", "2.00", "0.500", "100.00"],
        ["10", "2.00", "0.500", "50.00"],
        ["1", "2.00", "0.500", "500.00"],
    ]
    table = (tmp_path / "accelerator.csv").read_text().splitlines()
    assert [line.split(",")[2] for line in table[1:]] == ["5", "10", "1"]


def test_bioheat_prints_what_its_own_processes_found(monkeypatch, capsys):
    found = heat.Measured(361, 4e-3, 9e-3, 2.0, 30.0, 20.0)
    monkeypatch.setattr(heat, "in_own_process", lambda name: found)
    heat.main(["--cases", "radial", "space"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["grid", "radial", "space"]
    assert lines[1].split()[1:6] == ["361", "0.0040", "0.005", "0.0090", "0.01"]
    calls = []
    value, *times = accelerator.twice(lambda: calls.append(0) or len(calls))
    assert value == 2
    assert min(times) >= 0


@pytest.mark.parametrize("name", ["radial", "plane"])
def test_the_tumour_is_that_of_every_grid(name):
    assert heat.tumour(heat.CASES[name].grid()).perfusion.boxes


def test_the_roofline_has_a_row_for_each_work_and_its_least_time(capsys, monkeypatch):
    machine = Machine(operations=1e9, traffic=1e8)
    copies = Work("copies", 1e6, 1e9, 20.0)
    assert machine.least_time(Work("sums", 1e9, 1e6, 2.0)) == pytest.approx(1.0)
    assert machine.least_time(copies) == pytest.approx(10.0)
    assert copies.row(machine).split()[-2:] == ["50", "%"]
    assert len(HEADER.split()) == 9
    monkeypatch.setattr(Machine, "measure", classmethod(lambda cls: cls(1e10, 1e10)))
    monkeypatch.setattr(roofline, "works", lambda: [Work("nothing", 1.0, 1.0, 1.0)])
    roofline.main([])
    assert "nothing" in capsys.readouterr().out


@pytest.mark.slow
def test_small_pieces_of_work_are_measured():
    with jax.numpy_dtype_promotion("standard"):
        machine = Machine.measure(side=200, length=2**20)
        small = [bioheat(8), evidence(16), recording(32)]
    for work in small:
        assert work.seconds > 0
        # Bounds that are beaten would be counted wrongly; caches may help a little.
        assert machine.least_time(work) < 3 * work.seconds


PHASES = start.Phases(12.0, 10.0, 4.0, 3.0, 2.0, 20)


def test_a_row_of_starts_that_fails_says_why_and_the_table_goes_on(capsys, monkeypatch):
    def fail(folder, *words, cache=None):
        if words[0] == "simulate":
            raise FitError("pinav simulate: no room")
        return PHASES

    monkeypatch.setattr(start, "run", fail)
    start.main(["--commands", "identify", "fit", "heat"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[1:]] == [
        [name, state]
        for name in ("identify", "fit", "heat")
        for state in ("cold", "warm")
    ]
    assert "no figures: --recording: identify needs a file" in lines[1]
    assert "no figures: pinav simulate: no room" in lines[3]
    assert "12.0" in lines[5]
    assert set(start.Options().commands) == set(start.COMMANDS)
    assert len(PHASES.cells().split()) == len(start.HEADER.split()) - 1


@pytest.mark.slow
def test_a_process_reports_where_its_time_went_or_why_it_failed(tmp_path):
    data = tmp_path / "data.csv"
    phases = start.run(tmp_path, "simulate", "paper", "--out", str(data))
    assert data.exists()
    assert phases.programs > 0
    assert 0 < phases.tracing + phases.compiling < phases.clock
    assert 0 < phases.imports < phases.clock
    with pytest.raises(FitError, match="pinav fit nowhere.*nowhere"):
        start.run(tmp_path, "fit", "nowhere", "--out", str(tmp_path / "run"))


def test_calls_take_turns_and_the_slope_of_growth_is_the_exponent():
    times = {n: 0.3 * n**1.7 for n in (1, 4, 16)}
    assert growth.slope(times) == pytest.approx(1.7)
    assert np.isnan(growth.slope({1: 2.0}))
    order = []
    calls = {n: (lambda n=n: order.append(n)) for n in (1, 2)}
    growth.medians(calls, rounds=2)
    assert order == [1, 2, 1, 2]


def test_crossings_differ_and_begin_alike():
    nine = growth.crossings(9)
    starts = nine.states[:, 0]
    assert len(np.unique(starts.round(6), axis=0)) == 9
    assert np.array_equal(starts[:2], growth.crossings(2).states[:, 0])
    fewer = growth.crossings(2, 51)
    assert fewer.times.shape == (2, 51)
    np.testing.assert_allclose(fewer.states[:, -1], nine.states[:2, -1], atol=1e-6)


def test_weights_of_a_network_grow_with_the_square_of_its_width():
    data = growth.crossings(1)
    few, many = (growth.num_weights(data, width) for width in (32, 64))
    assert few == pytest.approx(32 * 32, rel=0.5)
    assert many / few == pytest.approx(4.0, rel=0.2)


@pytest.mark.slow
def test_a_tiny_run_of_growth_prints_and_draws(tmp_path, capsys):
    words = ["--trajectories", "1", "2", "--rounds", "1", "--out", str(tmp_path)]
    with jax.numpy_dtype_promotion("standard"):
        growth.main([*words, "--samples", "--widths", "--fits"])
    printed = capsys.readouterr().out
    assert "slope" in printed
    assert "fits/s" not in printed
    lines = (tmp_path / "growth.csv").read_text().splitlines()
    expected = [["trajectories", "1"], ["trajectories", "2"]]
    assert [line.split(",")[:2] for line in lines[1:]] == expected
    assert (tmp_path / "growth.png").exists()
