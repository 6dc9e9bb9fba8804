"""Which systems a fit filters, and which it fits as any other."""

import dataclasses

import pytest

from pinav.identification import needs_kalman_filter
from pinav.scenarios import scenario
from pinav.systems import WanderingVelocity


@pytest.mark.parametrize(
    "name", ["drift-current", "shear-current", "channel-current", "vortex-current"]
)
def test_commands_of_a_programme_are_known_forces(name):
    system = scenario(name)
    assert not needs_kalman_filter(system)
    propulsion = dataclasses.replace(system.swimmer.propulsion, programme=None)
    swimmer = dataclasses.replace(system.swimmer, propulsion=propulsion)
    assert needs_kalman_filter(dataclasses.replace(system, swimmer=swimmer))


def test_a_velocity_that_wanders_is_filtered():
    wandering = WanderingVelocity(still=0.1, driven=0.2, memory=1.0)
    system = dataclasses.replace(scenario("drift-current"), wandering=wandering)
    assert needs_kalman_filter(system)
