"""What a search for a structure says in words."""

import msgspec
import numpy as np
import pytest
from pinav.commands.fit.structure import LawRow, StructureRow, TermRow

CENTRE = TermRow("central", "f(r)", (4.99, 5.01), (0.004, 0.003))


def test_a_term_is_named_with_its_numbers():
    assert CENTRE.text() == "central about (4.990, 5.010) ± 0.0040"
    assert TermRow("linear", "A x", (), ()).text() == "linear"
    wall = TermRow("wall", "f(n x)", (np.pi / 3,), (0.01,))
    assert wall.text() == "wall with its normal at 60.000 ± 0.57 degrees"
    hills = TermRow(
        "hills and wells", "U", (1.0, 2.0, 3.0, 4.0, *[0.1] * 6), (0.2,) * 10
    )
    assert hills.text() == "2 hills and wells at (1.000, 2.000), (3.000, 4.000) ± 0.20"
    other = TermRow("obstacles", "h", (1.0, 2.0), (0.1, 0.2))
    assert other.text() == "obstacles with (1.000, 2.000) ± 0.20"


def test_a_law_is_named_with_its_constants():
    law = LawRow("hill", "L", ("height", "tail"), (3.883, -0.3321), (0.012, 0.0043))
    term = TermRow("central", "f(r)", (4.99, 5.01), (0.004, 0.003), law)
    assert term.text() == (
        "central about (4.990, 5.010) ± 0.0040 (potential: hill of height "
        "3.883 ± 0.012, tail −0.3321 ± 0.0043)"
    )


def test_structures_are_weighed_against_free_kernels():
    found = StructureRow((CENTRE,), gain=31.0)
    assert found.text().endswith("; 31.0 nats over free kernels")
    tied = StructureRow((CENTRE,), gain=-4.0).text()
    assert "simpler than free kernels, which the log evidence cannot tell" in tied
    assert tied.endswith("(−4.00 nats over them)")
    alone = StructureRow((CENTRE,), None).text()
    assert alone.endswith("; a fit of free kernels alone diverges")
    assert "no structure tried explains" in StructureRow((), None).text()
    unsought = StructureRow((), None, sought=False).text()
    assert "none was sought, which takes 6 trajectories and 600 numbers" in unsought
    assert "differs by −4.40 nats" in StructureRow((), -4.4).text()


@pytest.mark.parametrize(
    ("rotation", "turns", "words"),
    [
        (1245.0, True, "prefers to a potential alone by 1245 nats"),
        (-3.2, False, "rotational part beside it differs by −3.20 nats"),
    ],
)
def test_the_run_says_which_kind_of_force_the_evidence_took(rotation, turns, words):
    row = StructureRow((CENTRE,), gain=31.0, rotation=rotation, turns=turns)
    structure, force = row.text().splitlines()
    assert structure.startswith("structure: central about")
    assert words in force
    unweighed = msgspec.structs.replace(row, rotation=None)
    assert unweighed.text() == structure


def test_a_structure_that_a_network_was_taught_is_said_to_be_its_teachers():
    row = StructureRow((CENTRE,), gain=31.0, rotation=-3.2, of_teacher=True)
    structure, force = row.text().splitlines()
    assert structure.startswith("the network's teacher: structure: central about")
    assert force.startswith("the network's teacher: force: a potential")
