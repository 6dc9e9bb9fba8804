"""The program of the benchmarks: what it lists, refuses and runs."""

from benchmarks.__main__ import names, run


def test_the_names_are_those_of_the_modules(capsys):
    assert run([]) == 0
    text = capsys.readouterr().out
    assert {"fit", "gradient", "paper-weakness"} <= set(names())
    assert all(name in text for name in names())


def test_an_unknown_name_gets_one_line(capsys):
    assert run(["nothing"]) == 2
    line = capsys.readouterr().err
    assert "benchmark 'nothing' is unknown; choose one of: accelerator" in line


def test_a_benchmark_parses_its_own_options(capsys):
    assert run(["gradient", "--help"]) == 0
    assert "python -m benchmarks gradient" in capsys.readouterr().out
    assert run(["gradient", "--nonsense"]) == 2
    assert "--nonsense" in capsys.readouterr().err
