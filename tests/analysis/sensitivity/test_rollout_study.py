import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.analysis import Factor, RolloutStudy
from pinav.dynamics import FixedStep, Swimmer, rollout
from pinav.errors import InputError
from pinav.forces import LinearDrag, ZeroForce
from pinav.scenarios import barrier_crossings

TIMES = np.linspace(0.0, 4.0, 41)
LANDMARK = np.array([5.0, 5.0])


def study():
    start = np.array([1.0, 2.0, 3.0, 3.0])
    return RolloutStudy(barrier_crossings().truth, start, TIMES, LANDMARK, 0.35)


@eqx.filter_jit
def path(swimmer, start):
    fine = FixedStep(substeps=8)
    return rollout(swimmer, jnp.asarray(start), jnp.asarray(TIMES), solver=fine).ys


def test_outcomes_are_those_of_rollouts_with_changed_constants():
    own = study()
    factors = own.factors(relative=0.1, shift=0.2)
    assert [f.name for f in factors] == [
        "environment",
        "damping",
        "gain",
        "start x",
        "start y",
    ]
    scale = {"height": 1.1, "damping": 0.9, "gain": 1.05}
    changed = eqx.tree_at(
        lambda s: (s.environment.height, s.drag.damping, s.propulsion.gain),
        own.swimmer,
        (
            scale["height"] * own.swimmer.environment.height,
            scale["damping"] * own.swimmer.drag.damping,
            scale["gain"] * own.swimmer.propulsion.gain,
        ),
    )
    moved = own.start + np.array([0.1, -0.2, 0.0, 0.0])
    true = np.asarray(path(changed, moved))[:, :2]
    nominal = np.asarray(path(own.swimmer, own.start))[-1, :2]
    parameters = np.array([[1.1, 0.9, 1.05, 0.1, -0.2], [1.0, 1.0, 1.0, 0.0, 0.0]])
    found = own.outcomes(factors, parameters)
    displacement = np.linalg.norm(true[-1] - nominal)
    nearest = np.linalg.norm(true - LANDMARK, axis=1).min()
    expected = [*true[-1], displacement, nearest, float(displacement <= 0.35)]
    assert np.allclose(found[0], expected, atol=1e-4)
    assert found[1, 2] == pytest.approx(0.0, abs=1e-12)
    assert found[1, 4] == 1.0


def test_a_coasting_swimmer_depends_on_start_and_damping_as_it_should():
    """x(T) = x0 + v0 (1 - exp(-eta T)) / eta: nearly linear in a small change."""
    coasting = Swimmer(ZeroForce(), LinearDrag(0.5), ZeroForce())
    start = np.array([0.0, 0.0, 1.0, 0.0])
    own = RolloutStudy(coasting, start, TIMES, LANDMARK, 0.35)
    factors = own.factors(relative=0.01, shift=0.01)
    assert [f.name for f in factors] == [
        "environment",
        "damping",
        "start x",
        "start y",
    ]
    found = own.indices(factors, samples=128)
    decay = np.exp(-2.0)
    slope = decay * 4.0 / 0.5 - (1 - decay) / 0.5**2
    spread = np.array([0.0, slope * 0.005, 0.01, 0.0])
    assert np.allclose(found.total[0], spread**2 / (spread**2).sum(), atol=0.03)
    assert np.allclose(found.total[1], [0.0, 0.0, 0.0, 1.0], atol=0.03)


def test_unknown_factors_are_refused():
    with pytest.raises(InputError, match="'moment' is unknown; choose from damping"):
        study().indices((Factor("moment", 0.0, 1.0),))
