"""The page of a fit states units, and whether the evidence supports a field."""

import msgspec
import pytest
from pinav.commands.fit.metrics import FitMetrics, RestartRow
from pinav.commands.fit.report import fit_sections
from pinav.commands.fit.structure import StructureRow

from pinav.report import Paragraph, Table
from pinav.runs import RunFolder


@pytest.fixture
def content_with(fitted_run):
    """A section of a fit, the first, whose metrics have other fields."""
    folder, _ = fitted_run("kernel")

    def content(section=0, **fields):
        run = RunFolder.open(folder)
        metrics = run.read_metrics("metrics.json", FitMetrics)
        run.write_metrics("metrics.json", msgspec.structs.replace(metrics, **fields))
        return fit_sections(run)[section].blocks

    return content


def first_table(content):
    return next(part for part in content if isinstance(part, Table))


UNITS = {"x": "um", "y": "um", "vx": "um/s", "vy": "um/s", "t": "s"}


def test_the_errors_of_a_page_have_their_units(content_with):
    header = first_table(content_with(units=UNITS)).header
    assert header[:4] == ("x [um]", "y [um]", "vx [um/s]", "vy [um/s]")
    assert "position [um]" in header


def test_the_page_says_whether_the_evidence_supports_a_field(content_with):

    row = RestartRow({"1": 2.5, "10": None}, 27)
    content = content_with(units=UNITS, restarts=row, support=-2.7)
    assert isinstance(content[0], Paragraph)
    assert "not supported: its log evidence over the known" in content[0].text
    table = first_table(content)
    assert table.header == ("after 1.00 s [um]", "after 10.0 s [um]")
    assert table.rows == [(2.5, None)]


def test_structure_and_rotation_are_two_paragraphs(content_with):
    row = StructureRow((), gain=None, rotation=-3.2)
    first, second = content_with(section=1, structure=row)
    assert isinstance(first, Paragraph)
    assert isinstance(second, Paragraph)
    assert first.text.startswith("structure: free kernels")
    assert second.text.startswith("force: a potential")
