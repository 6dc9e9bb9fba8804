"""Which command is given when each must have a way out."""

import numpy as np

from pinav.navigation.adaptive.safety import choose_command


def test_of_the_clear_commands_the_one_that_leads_on_most_is_given():
    margins, lead = np.array([-0.1, 0.2, 5.0, 0.0]), np.array([9.0, 1.0, 0.5, 2.0])
    assert choose_command(margins, lead) == 3


def test_where_none_is_clear_the_lead_does_not_count():
    margins, lead = np.array([-3.0, -1.0, -2.0]), np.array([9.0, 0.0, 9.0])
    assert choose_command(margins, lead) == 1


def test_of_equal_commands_the_first_one_is_given():
    assert choose_command(np.full(3, -1.0), np.arange(3.0)) == 0
    assert choose_command(np.ones(3), np.ones(3)) == 0
