"""What a search for a structure says in words."""

import dataclasses

import numpy as np
import pytest

from pinav.commands.fit.job import structure_sentences, term_words
from pinav.fitting import Estimate
from pinav.learning.findings import FoundLaw, FoundStructure, FoundTerm


def term(kind, formula, values, sd, law=None):
    return FoundTerm(kind, formula, tuple(map(Estimate, values, sd)), law)


CENTRE = term("central", "f(r)", (4.99, 5.01), (0.004, 0.003))


def test_a_term_is_named_with_its_numbers():
    assert term_words(CENTRE) == "central about (4.990, 5.010) ± 0.0040"
    assert term_words(term("linear", "A x", (), ())) == "linear"
    wall = term("wall", "f(n x)", (np.pi / 3,), (0.01,))
    assert term_words(wall) == "wall with its normal at 60.000 ± 0.57 degrees"
    hills = term("hills and wells", "U", (1.0, 2.0, 3.0, 4.0, *[0.1] * 6), (0.2,) * 10)
    assert (
        term_words(hills)
        == "2 hills and wells at (1.000, 2.000), (3.000, 4.000) ± 0.20"
    )
    other = term("obstacles", "h", (1.0, 2.0), (0.1, 0.2))
    assert term_words(other) == "obstacles with (1.000, 2.000) ± 0.20"


def test_a_law_is_named_with_its_constants():
    law = FoundLaw(
        "hill",
        "L",
        {"height": Estimate(3.883, 0.012), "tail": Estimate(-0.3321, 0.0043)},
    )
    hill = term("central", "f(r)", (4.99, 5.01), (0.004, 0.003), law)
    assert term_words(hill) == (
        "central about (4.990, 5.010) ± 0.0040 (potential: hill of height "
        "3.883 ± 0.012, tail −0.3321 ± 0.0043)"
    )


def words(structure):
    return "\n".join(structure_sentences(structure))


def test_structures_are_weighed_against_free_kernels():
    found = FoundStructure((CENTRE,), gain=31.0)
    assert words(found).endswith("; 31.0 nats over free kernels")
    tied = words(FoundStructure((CENTRE,), gain=-4.0))
    assert "simpler than free kernels, which the log evidence cannot tell" in tied
    assert tied.endswith("(−4.00 nats over them)")
    alone = words(FoundStructure((CENTRE,), None))
    assert alone.endswith("; a fit of free kernels alone diverges")
    assert "no structure tried explains" in words(FoundStructure((), None))
    unsought = words(FoundStructure((), None, sought=False))
    assert "none was sought, which takes 6 trajectories and 600 numbers" in unsought
    assert "differs by −4.40 nats" in words(FoundStructure((), -4.4))


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
