import pytest
from benchmarks.start import COMMANDS, HEADER, Options, Phases, main, run

from benchmarks import start
from pinav.errors import FitError, InputError


def test_an_unknown_command_is_refused():
    with pytest.raises(
        InputError, match="--commands: 'magic' is unknown; choose some of"
    ):
        main(["--commands", "magic"])


def test_a_row_that_fails_says_why_and_the_table_goes_on(capsys, monkeypatch):
    def fail(folder, *words, cache=None):
        if words[0] == "simulate":
            raise FitError("pinav simulate: no room")
        return Phases(12.0, 10.0, 4.0, 3.0, 2.0, 20)

    monkeypatch.setattr(start, "run", fail)
    main(["--commands", "identify", "fit", "heat"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[1:]] == [
        [name, state]
        for name in ("identify", "fit", "heat")
        for state in ("cold", "warm")
    ]
    assert "no figures: --recording: identify needs a file" in lines[1]
    assert "no figures: pinav simulate: no room" in lines[3]
    assert "12.0" in lines[5]


def test_every_command_is_measured_unless_asked_otherwise():
    assert set(Options().commands) == set(COMMANDS)


def test_a_row_has_a_number_for_every_column():
    phases = Phases(12.0, 10.0, 4.0, 3.0, 2.0, 20)
    assert len(phases.cells().split()) == len(HEADER.split()) - 1
    assert "3.0" in phases.cells()


@pytest.mark.slow
def test_a_process_reports_where_its_time_went(tmp_path):
    data = tmp_path / "data.csv"
    phases = run(tmp_path, "simulate", "paper", "--out", str(data))
    assert data.exists()
    assert phases.programs > 0
    assert 0 < phases.tracing + phases.compiling < phases.clock
    assert 0 < phases.imports < phases.clock


@pytest.mark.slow
def test_a_command_that_fails_is_named(tmp_path):
    with pytest.raises(FitError, match="pinav fit nowhere.*nowhere"):
        run(tmp_path, "fit", "nowhere", "--out", str(tmp_path / "run"))
