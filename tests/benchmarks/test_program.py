"""The program of the benchmarks: what it lists, refuses and runs."""

import pytest
from benchmarks.__main__ import names, run


def test_the_names_are_those_of_the_modules(capsys):
    assert run([]) == 0
    text = capsys.readouterr().out
    assert {"fit", "gradient", "paper-weakness"} <= set(names())
    assert all(name in text for name in names())


def test_a_benchmark_parses_its_own_options(capsys):
    assert run(["gradient", "--help"]) == 0
    assert "python -m benchmarks gradient" in capsys.readouterr().out


MISTAKES = {
    "nothing": "benchmark 'nothing' is unknown; choose one of: accelerator",
    "gradient --nonsense": "--nonsense",
    "accelerator --fits 0": "--fits: expected numbers of 1 or more",
    "accelerator --max-steps 0": "--max-steps: expected 1 or more",
    "choice --groups fish": "--groups: expected some of sessions",
    "fields --columns magic": "--columns: 'magic' is unknown; choose some of",
    "fields --families hills": "--families: 'hills' is unknown; choose some of",
    "fields --draws 0": "--draws and --count: expected one or more",
    "fields --keys -1": "--keys: expected 0 or more, got -1",
    "fit --only nobody": "--only: 'nobody' is unknown; choose some of: paper-re",
    "fit --seeds 1 1": "--seeds: expected one or more, each once",
    "fit --adam-steps 0": "--adam-steps: expected 1 or more",
    "growth --fits 0": "--fits: expected numbers of 1 or more",
    "growth --rounds 0": "--rounds: expected 1 or more",
    "heat --cases torus": "--cases: 'torus' is unknown; choose from",
    "recordings --only zebra": "no recordings that match 'zebra'; set it",
    "start --commands magic": "--commands: 'magic' is unknown; choose some of",
    "trainer --columns magic": "--columns: 'magic' is unknown; choose some of",
    "trainer --keys -1": "--keys: expected 0 or more, got -1",
    "trainer --workers 0": "--workers: expected 1 or more, got 0",
    "trainer --seeds": "--seeds: expected one or more",
}


@pytest.mark.parametrize(("words", "message"), MISTAKES.items())
def test_mistakes_get_one_line(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(words.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not list(tmp_path.iterdir())
