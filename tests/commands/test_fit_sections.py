"""The blocks of a fit: units, the support for a field, the search for a structure."""

import dataclasses
import itertools

import numpy as np
import pytest

from pinav.commands.fit.job import sections, structure_sentences, term_words
from pinav.evaluation import RestartErrors
from pinav.fitting import Estimate
from pinav.fitting.structure.trace import Hypothesis
from pinav.learning.findings import FoundLaw, FoundStructure, FoundTerm
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
    verdict, support = content[:2]
    assert isinstance(verdict, Paragraph)
    assert verdict.text.startswith("Verdict: ")
    assert isinstance(support, Paragraph)
    assert "not supported: its log evidence over the known" in support.text
    table = tables(content)[0]
    assert table.header == ("after 1.00 s [um]", "after 10.0 s [um]")
    assert table.rows[0][0] == 2.5


def test_a_section_has_its_paragraphs_in_order(content_with):
    structure = FoundStructure((), gain=None, rotation=-3.2)
    first, second = content_with(section=1, structure=structure)
    assert isinstance(first, Paragraph)
    assert isinstance(second, Paragraph)
    assert first.text.startswith("structure: free kernels")
    assert second.text.startswith("force: a potential")
    assert content_with(remarks=("The kernels are coarse.",))[1].text.startswith(
        "The k"
    )


def test_the_page_shows_what_the_search_tried(content_with):
    tried = (
        Hypothesis(("central", "linear"), 120.5, 1.02, 3.0, "polished"),
        Hypothesis((), None, None, 9.0, "free kernels diverged"),
    )
    structure = FoundStructure((), gain=None, tried=tried)
    (table,) = tables(content_with(section=1, structure=structure))
    assert table.rows == [
        ["central + linear", "120.500", "1.020", "3.00", "polished"],
        ["free kernels", "–", "–", "9.00", "free kernels diverged"],
    ]


def term(kind, formula, values, sd, units=("?",)):
    units = itertools.cycle(units)
    return FoundTerm(kind, formula, tuple(map(Estimate, values, sd, units)))


CENTRE = term("central", "f(r)", (4.99, 5.01), (0.004, 0.003))


HILL = FoundLaw(
    "hill", "L", {"height": Estimate(3.883, 0.012), "tail": Estimate(-0.3321, 0.0043)}
)
NAMED = {
    "central about (4.990, 5.010) ± 0.0040": CENTRE,
    "linear": term("linear", "A x", (), ()),
    "wall with its normal at 60.000 ± 0.57 degrees": term(
        "wall", "f(n x)", (np.pi / 3,), (0.01,)
    ),
    "2 hills and wells at (1.000, 2.000), (3.000, 4.000) ± 0.20": term(
        "hills and wells", "U", (1.0, 2.0, 3.0, 4.0, *[0.1] * 6), (0.2,) * 10
    ),
    "obstacles with (1.000, 2.000) ± 0.20": term(
        "obstacles", "h", (1.0, 2.0), (0.1, 0.2)
    ),
    "central about (4.990, 5.010) ± 0.0040 (potential: hill of height 3.883 ± 0.012, "
    "tail −0.3321 ± 0.0043)": dataclasses.replace(CENTRE, law=HILL),
}

STEP = FoundLaw("step", "L", {"size": Estimate(4.0, 0.1, "um")})
NAMED |= {
    "central about (4.990, 5.010) ± 0.0040 um (potential: step of size 4.000 ± 0.10 "
    "um)": dataclasses.replace(
        term("central", "f(r)", (4.99, 5.01), (0.004, 0.003), ("um",)), law=STEP
    ),
    "elliptic with (1.000, 2.000) ± 0.20 um, (0.3000, 0.1000) ± 0.010": term(
        "elliptic",
        "f",
        (1.0, 2.0, 0.3, 0.1),
        (0.1, 0.2, 0.01, 0.01),
        ("um",) * 2 + ("1",) * 2,
    ),
}


@pytest.mark.parametrize(("words", "named"), NAMED.items(), ids=NAMED)
def test_a_term_is_named_with_its_numbers_and_its_law(words, named):
    assert term_words(named) == words


@pytest.mark.parametrize(
    ("structure", "words"),
    [
        (FoundStructure((CENTRE,), gain=31.0), "; 31.0 nats over free kernels"),
        (FoundStructure((CENTRE,), gain=-4.0), "tell from it (−4.00 nats over them)"),
        (FoundStructure((CENTRE,), None), "; a fit of free kernels alone diverges"),
        (FoundStructure((), None), "no structure tried explains the data"),
        (FoundStructure((), None, sought=False), "6 trajectories and 600 numbers"),
        (FoundStructure((), -4.4), "differs by −4.40 nats"),
    ],
)
def test_structures_are_weighed_against_free_kernels(structure, words):
    (said,) = structure_sentences(structure)
    assert said.endswith(words)


@pytest.mark.parametrize(
    ("rotation", "turns", "said"),
    [
        (1245.0, True, "prefers to a potential alone by 1245 nats"),
        (-3.2, False, "rotational part beside it differs by −3.20 nats"),
    ],
)
def test_the_run_says_which_kind_of_force_the_evidence_took(rotation, turns, said):
    row = FoundStructure((CENTRE,), gain=31.0, rotation=rotation, turns=turns)
    structure, force = structure_sentences(row)
    assert structure.startswith("structure: central about")
    assert said in force
    unweighed = dataclasses.replace(row, rotation=None)
    assert structure_sentences(unweighed) == [structure]


def test_a_structure_that_a_network_was_taught_is_said_to_be_its_teachers():
    row = FoundStructure((CENTRE,), gain=31.0, rotation=-3.2, of_teacher=True)
    structure, force = structure_sentences(row)
    assert structure.startswith("the network's teacher: structure: central about")
    assert force.startswith("the network's teacher: force: a potential")
