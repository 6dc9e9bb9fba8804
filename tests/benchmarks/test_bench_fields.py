from benchmarks._sweep import measurements
from benchmarks.fields.cells import COLUMNS, Measurement, cell_of, measure
from benchmarks.fields.table import Options, cells, draw, line, summary
from tests.sweeps.here import here

from pinav.sweeps import CellStore, map_cells


def measurement(**changes):
    values = {"family": "ring", "key": 4, "column": "structured", "seconds": 9.0}
    found = {"outcome": "converged", "structure": ("central",), "gain": 31.2}
    scores = {"error": {"visited": 0.015, "near": 0.017, "unvisited": None}}
    return Measurement(**(values | found | scores | changes))


def test_even_keys_are_for_development_and_odd_ones_for_judging():
    both = [Options(half=half, draws=3) for half in ("development", "judged")]
    first, second = ({cell.seed for cell in cells(options)} for options in both)
    assert (first, second) == ({0, 2, 4}, {1, 3, 5})
    assert {cell.seed for cell in cells(Options(keys=(3,)))} == {3}


def test_the_table_says_what_was_found_and_whether_rightly(tmp_path):
    wrong = measurement(key=6, structure=("wall",))
    assert "central (31 nats)" in line(measurement())
    assert "1 of 2" in summary([measurement(), wrong])
    draw([measurement(), wrong], tmp_path)
    assert (tmp_path / "fields.svg").is_file()
    assert {"network", "ude"} <= set(Options().columns) < set(COLUMNS)
    for column in ("structured", "network", "ude", "neural-potential"):
        assert "1 of 1" in summary([measurement(column=column)])
    assert "1 of 1" not in summary([measurement(column="free")])


def test_a_crash_is_a_result_and_a_finished_cell_is_not_run_again(
    tmp_path, monkeypatch
):
    def crash(system, data):
        raise IndexError("no field")

    monkeypatch.setitem(measure.__globals__["COLUMNS"], "free", crash)
    cell, store = cell_of("none", 0, "free", 1), CellStore.of_run(tmp_path)
    map_cells([cell], store, here)
    monkeypatch.setitem(measure.__globals__["COLUMNS"], "free", None)
    options = Options(out=tmp_path)
    (one,) = measurements([cell], Measurement, options, "fields")
    assert one.outcome == "IndexError: no field"


def test_a_cell_that_failed_is_named(tmp_path, capsys):
    lost = cell_of("nowhere", 0, "free", 1)
    map_cells([lost], CellStore.of_run(tmp_path), here)
    assert measurements([lost], Measurement, Options(out=tmp_path), "fields") == []
    assert "nowhere 0 free: " in capsys.readouterr().err
