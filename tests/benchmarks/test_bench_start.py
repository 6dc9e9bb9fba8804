import pytest
from benchmarks.start import HEADER, Phases, main, run

from pinav.errors import FitError, InputError


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--commands", "magic"], "--commands: 'magic' is unknown; choose some of"),
        (["--commands", "identify"], "--recording: identify needs a file"),
    ],
)
def test_bad_options_are_refused(words, message):
    with pytest.raises(InputError, match=message):
        main(words)


def test_a_row_has_a_number_for_every_column():
    phases = Phases(12.0, 10.0, 4.0, 3.0, 2.0, 20)
    assert len(phases.line("fit").split()) == len(HEADER.split())
    assert "3.0" in phases.line("fit")


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
