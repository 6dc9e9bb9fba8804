"""The blocks of a fit state units, and whether the evidence supports a field."""

import dataclasses

import numpy as np
import pytest

from pinav.commands.fit.job import sections
from pinav.evaluation import RestartErrors
from pinav.fitting import Estimate
from pinav.learning.findings import FoundStructure
from pinav.learning.learned import Learned
from pinav.report import Paragraph, Table, number


@pytest.fixture
def content_with(fitted_run):
    """A section of a fit, the first, whose findings have other fields."""
    folder, _ = fitted_run("kernel")
    findings = Learned.open(folder).findings

    def content(section=0, **fields):
        return sections(dataclasses.replace(findings, **fields))[section].blocks

    return content


def tables(content):
    return [part for part in content if isinstance(part, Table)]


UNITS = {"x": "um", "y": "um", "vx": "um/s", "vy": "um/s", "t": "s"}


def test_the_errors_of_a_fit_have_their_units(content_with):
    header = tables(content_with(units=UNITS))[0].header
    assert header[:4] == ("x [um]", "y [um]", "vx [um/s]", "vy [um/s]")
    assert "position [um]" in header


def test_constants_have_units_and_intervals(content_with):
    constants = {"gain": Estimate(2.0, 0.5, "um² s⁻¹"), "delay": Estimate(1.0, np.nan)}
    table = tables(content_with(constants=constants))[-1]
    assert list(table.rows[0]) == [
        "gain",
        "um² s⁻¹",
        "2.00000",
        0.5,
        "1.02002",
        "2.97998",
    ]
    name, unit, value, sd, *ends = table.rows[1]
    assert [name, unit, value, *ends] == ["delay", "?", "1.00000", "–", "–"]
    assert isinstance(sd, float)
    assert number(sd) == "–"


def test_a_fit_says_whether_the_evidence_supports_a_field(content_with):
    restarts = RestartErrors(np.array([1.0, 10.0]), np.array([2.5, np.nan]), 27)
    content = content_with(units=UNITS, restarts=restarts, support=-2.7)
    assert isinstance(content[0], Paragraph)
    assert "not supported: its log evidence over the known" in content[0].text
    table = tables(content)[0]
    assert table.header == ("after 1.00 s [um]", "after 10.0 s [um]")
    assert table.rows[0][0] == 2.5


def test_structure_and_rotation_are_two_paragraphs(content_with):
    structure = FoundStructure((), gain=None, rotation=-3.2)
    first, second = content_with(section=1, structure=structure)
    assert isinstance(first, Paragraph)
    assert isinstance(second, Paragraph)
    assert first.text.startswith("structure: free kernels")
    assert second.text.startswith("force: a potential")


def test_remarks_are_said_first(content_with):
    assert content_with(remarks=("The kernels are coarse.",))[0].text.startswith(
        "The k"
    )
