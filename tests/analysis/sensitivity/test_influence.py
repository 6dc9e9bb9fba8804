import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from tests.fitted_runs import crossings

from pinav.analysis import influence
from pinav.dynamics import FixedStep
from pinav.errors import FitError, InputError
from pinav.evaluation import exact_forces
from pinav.fitting import fit_bayes, kernel_environment
from pinav.fitting.bayes.problem import BayesProblem
from pinav.fitting.engine.multiple_shooting import linearise
from pinav.fitting.evidence.evidence import LinearisedObservations, weight_posterior
from pinav.fitting.evidence.quadratic import Quadratic, eliminate_flat, joint_posterior
from pinav.forces import KernelPotential
from pinav.scenarios import barrier_crossings
from pinav.trajectories import Trajectories

pytestmark = pytest.mark.slow

CONSTANTS = {"damping": lambda m: m.drag.damping, "gain": lambda m: m.propulsion.gain}


def without(data, *indices):
    return data.select([i for i in range(len(data)) if i not in indices])


def with_arrays(swimmer):
    """Constants as arrays: another value is then no other compilation."""
    picks = tuple(CONSTANTS.values())
    return eqx.tree_at(
        lambda m: tuple(pick(m) for pick in picks), swimmer, replace_fn=jnp.asarray
    )


def barrier(model):
    return model.environment


@pytest.fixture(scope="module")
def parametric():
    """The barrier's four numbers, flat priors: a fit that is cheap to repeat."""
    data, swimmer = crossings(61, key=5), with_arrays(barrier_crossings().truth)
    fitted = fit_bayes(swimmer, data, learn=barrier, noise=0.02)
    found = influence(
        fitted.model,
        data,
        fitted.states,
        fitted.hyperparameters,
        learn=barrier,
        constants=CONSTANTS,
    )
    return data, swimmer, fitted, found


def numbers(model):
    """Those of the environment, in one row."""
    return np.asarray(ravel_pytree(model.environment)[0])


def change_of(found, vector):
    """The change of the environment's numbers in one of all that is learned."""
    return numbers(found.free.unravel(jnp.asarray(vector)))


def gap(one, other):
    """How far one change is from another, relative to it."""
    return np.linalg.norm(one - other) / np.linalg.norm(other)


@pytest.mark.parametrize("index", [0, 2])
def test_removals_are_those_of_real_refits(parametric, index):
    data, _, fitted, found = parametric
    refit = fit_bayes(fitted.model, without(data, index), learn=barrier, noise=0.02)
    change = numbers(refit.model) - numbers(fitted.model)
    assert gap(change_of(found, found.removals[index]), change) < 0.05
    point = np.array([[4.0, 3.0]])
    after, before = (exact_forces(f.model.environment, point) for f in (refit, fitted))
    moved, true = found.force_changes(point, found.removals)[index], after - before
    assert np.allclose(moved, true, atol=0.06 * np.linalg.norm(true))


@pytest.mark.parametrize("name", CONSTANTS)
def test_slopes_by_constants_are_those_of_real_refits(parametric, name):
    data, _, fitted, found = parametric
    step, pick = 1e-3, CONSTANTS[name]
    upper, lower = (
        eqx.tree_at(pick, fitted.model, pick(fitted.model) + jnp.asarray(s))
        for s in (step, -step)
    )
    ends = [
        numbers(fit_bayes(model, data, learn=barrier, noise=0.02).model)
        for model in (upper, lower)
    ]
    change = (ends[0] - ends[1]) / (2 * step)
    assert gap(change_of(found, found.constants[name]), change) < 0.02


def test_final_position_follows_parameters_and_constants(parametric):
    data, _, fitted, found = parametric
    y0, ts = fitted.states[0, 0], jnp.asarray(data.times[0][:31])
    changes = np.stack([found.constants["damping"], found.removals[1]])
    slopes = found.final_changes(y0, ts, changes)

    def end(theta):
        model = found.free(jnp.asarray(theta))
        return np.asarray(FixedStep().solve(model, jnp.asarray(y0), ts)[0][-1])

    for change, slope in zip(changes, slopes, strict=True):
        step = 1e-4 / np.abs(change).max()
        ahead, behind = (end(found.theta + s * step * change) for s in (1, -1))
        assert np.allclose((ahead - behind) / (2 * step), slope, rtol=1e-4, atol=1e-7)


def test_leverages_count_the_parameters(parametric):
    _, _, _, found = parametric
    assert found.leverages.sum() == pytest.approx(4.0, rel=1e-6)
    assert np.all(found.distances > 0)


def test_a_kernel_fit_without_a_trajectory_solves_its_normal_equations():
    """Exact for the linear model: compared with a solve that leaves the rows out."""
    data = crossings(21, count=3, key=5)
    swimmer = eqx.tree_at(
        lambda s: s.environment,
        barrier_crossings().truth,
        kernel_environment(KernelPotential, data),
    )

    def damping(m):
        return m.drag.damping

    fitted = fit_bayes(swimmer, data, learn=damping, noise=0.02, throw=False)
    chosen = fitted.hyperparameters
    found = influence(
        fitted.model,
        data,
        fitted.states,
        chosen,
        learn=damping,
        constants={"damping": damping},
    )
    problem = BayesProblem.of(
        fitted.model, data, damping, 0.02, FixedStep(), states=fitted.states
    )
    theta, each = problem.theta, []
    for index in range(3):
        own = jax.tree.map(lambda a, i=index: a[i : i + 1], problem.observations)
        states = problem.states[index : index + 1]
        linear = linearise(
            problem.parametric, jnp.asarray(theta), states, own, problem.solver
        )
        each.append((np.asarray(linear.hessian), np.asarray(linear.gradient)))

    def solved(kept):
        hessian, gradient = (sum(each[i][part] for i in kept) for part in (0, 1))
        whole = Quadratic(theta, hessian, gradient, 0.0, problem.num_free, 0.0)
        quadratic, block = eliminate_flat(whole, problem.flat)
        prior = problem.weights.prior.covariance(chosen.shape)
        weights = weight_posterior(LinearisedObservations.of(quadratic), prior, chosen)
        return joint_posterior(block, *weights, chosen.noise)[0]

    points = np.array([[4.0, 3.0], [6.0, 6.0], [2.0, 7.0]])
    change = (solved([0, 2]) - solved([0, 1, 2]))[None]
    expected = found.force_changes(points, change)
    got = found.force_changes(points, found.removals[1:2])
    assert np.allclose(got, expected, atol=1e-3 * np.abs(expected).max())
    assert found.constants["damping"][~problem.flat].any()
    assert found.constants["damping"][problem.flat] == pytest.approx(1.0)


def test_what_cannot_be_left_out_is_refused(parametric):
    data, _, fitted, _ = parametric

    def moment(model):
        return model.propulsion.moment

    arguments = (fitted.model, data, fitted.states, fitted.hyperparameters)
    with pytest.raises(InputError, match="moment is 3 numbers; expected one"):
        influence(*arguments, learn=barrier, constants={"moment": moment})
    alone = without(data, 1, 2, 3)
    with pytest.raises(InputError, match="expected two or more, got 1"):
        influence(fitted.model, alone, fitted.states[:1], fitted.hyperparameters)


def test_a_trajectory_that_alone_determines_a_parameter_is_named(parametric):
    data, _, fitted, _ = parametric
    far = data.states[:2, :21].copy()
    far[1, :, :2] += 400.0  # no barrier there
    apart = Trajectories.from_arrays(
        list(data.times[:2, :21]), list(far), channels=data.channels
    )
    states = np.asarray(fitted.states[:2, :21]).copy()
    states[1, :, :2] += 400.0
    with pytest.raises(FitError, match="without trajectory 0 the data do not"):
        influence(fitted.model, apart, states, fitted.hyperparameters, learn=barrier)
