"""The benchmark of bioheat, without the benchmark."""

import pytest

from benchmarks import heat
from pinav.errors import InputError


def test_it_prints_what_its_own_processes_found(monkeypatch, capsys):
    found = heat.Measured(361, 4e-3, 9e-3, 2.0, 30.0, 20.0)
    monkeypatch.setattr(heat, "in_own_process", lambda name: found)
    heat.main(["--cases", "radial", "space"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["grid", "radial", "space"]
    assert lines[1].split()[1:6] == ["361", "0.0040", "0.005", "0.0090", "0.01"]


def test_an_unknown_grid_is_refused():
    with pytest.raises(InputError, match="--cases: 'torus' is unknown; choose from"):
        heat.main(["--cases", "torus"])


def test_the_tumour_is_that_of_every_grid():
    for name in ("radial", "plane"):
        model = heat.tumour(heat.CASES[name].grid())
        assert model.perfusion.box is not None
