import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.fields.families import FAMILIES, random_system
from tests.defects import told


@pytest.mark.parametrize("family", FAMILIES)
def test_a_system_of_a_family_is_drawn_by_its_key_alone(family):
    one, again, other = (random_system(family, key) for key in (4, 4, 6))
    np.testing.assert_array_equal(one.starts, again.starts)
    assert not np.array_equal(one.starts, other.starts)
    at, rest = jnp.array([4.0, 6.0]), jnp.zeros(2)
    force = one.environment(0.0, at, rest)
    assert jnp.all(jnp.isfinite(force))
    np.testing.assert_array_equal(force, again.environment(0.0, at, rest))
    drag = float(one.swimmer.drag.damping)
    assert 0.2 <= drag <= 0.5
    assert drag != float(other.swimmer.drag.damping)
    thrust = np.linalg.norm(one.swimmer.propulsion(0.0, at, rest))
    assert 0.01 <= thrust <= 0.1


def test_there_are_enough_families_with_and_without_structure():
    assert len(FAMILIES) >= 14
    assert {family.structure for family in FAMILIES.values()} >= {(), ("central",)}


@pytest.mark.parametrize(
    ("family", "key", "message"),
    [
        ("hills", 0, "family 'hills' is unknown; choose one of: gaussian"),
        ("ring", -1, "random_system key: expected >= 0, got -1"),
    ],
)
def test_what_cannot_be_drawn_is_refused(family, key, message):
    with told(message):
        random_system(family, key)
