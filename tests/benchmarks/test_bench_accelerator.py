"""The benchmark of work side by side, on small numbers."""

import pytest

from benchmarks import accelerator
from pinav.errors import InputError


def test_the_table_has_a_line_for_each_number(monkeypatch, tmp_path, capsys):
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
    assert [line.split(",")[1:3] for line in table[1:]] == [
        ["work", "5"],
        ["work", "10"],
        ["work", "1"],
    ]


def test_a_result_is_computed_twice():
    calls = []
    value, first, second = accelerator.twice(lambda: calls.append(0) or len(calls))
    assert value == 2
    assert first >= 0
    assert second >= 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fits", "0"], "--fits: expected numbers of 1 or more"),
        (["--max-steps", "0"], "--max-steps: expected 1 or more"),
    ],
)
def test_mistakes_get_one_line(words, message):
    with pytest.raises(InputError, match=message):
        accelerator.main(words)
