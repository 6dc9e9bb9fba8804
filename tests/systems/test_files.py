"""Systems there and back through TOML, and what a bad file is told."""

import equinox as eqx
import pytest

from pinav.scenarios import SCENARIOS, find_system, scenario
from pinav.systems import system_text, write_system


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_comes_back_exactly(name, tmp_path):
    system = scenario(name)
    write_system(system, tmp_path / "system.toml")
    again = find_system(str(tmp_path / "system.toml"))
    assert eqx.tree_equal(system, again, typematch=True)
    assert system_text(again) == system_text(system)
    assert again.name == name
