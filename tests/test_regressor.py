"""`ForceRegressor`: the fit with the interface of scikit-learn."""

import jax
import numpy as np
import pytest
from tests.fitted_runs import crossings

from pinav.errors import InputError
from pinav.trajectories import save

pytestmark = pytest.mark.extras("sklearn")


@pytest.fixture(scope="module", autouse=True)
def standard_promotion():
    """Commands run with the standard promotion of types."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="module")
def regressor():
    """Fitted to four short crossings of a barrier, as an array."""
    from pinav.regressor import ForceRegressor

    return ForceRegressor("barrier-crossings", structure="free").fit(table())


def table():
    columns = crossings(61).to_table()
    return np.stack([columns[name] for name in ("trajectory", "t", "x", "y")], axis=1)


def test_an_array_gives_the_fit_of_the_command_line(regressor, tmp_path):
    from pinav import cli
    from pinav.learning.learned import Learned

    data, out = tmp_path / "data.npz", tmp_path / "run"
    save(crossings(61).only(("x", "y")), data)
    words = ["fit", str(data), "--system", "barrier-crossings", "--structure", "free"]
    assert cli.run([*words, "--out", str(out)]) == 0
    run = Learned.open(out)
    points = np.array([[5.0, 5.0], [4.0, 6.5]])
    force, sd = regressor.predict(points, return_std=True)
    np.testing.assert_allclose(sd, run.posterior.force_sd(points), rtol=1e-6)
    expected = [
        run.model.environment(0.0, x, jax.numpy.zeros(2))
        for x in jax.numpy.asarray(points)
    ]
    np.testing.assert_allclose(force, expected, rtol=1e-6)


def test_the_score_is_that_of_rollouts_of_other_trajectories(regressor):
    assert 0.99 < regressor.score(table()) <= 1


def test_cross_validation_leaves_whole_trajectories_out(regressor):
    from sklearn.base import clone
    from sklearn.model_selection import GroupKFold, cross_val_score

    rows = table()
    scores = cross_val_score(
        clone(regressor), rows, groups=rows[:, 0], cv=GroupKFold(2), error_score="raise"
    )
    assert scores.shape == (2,)
    assert (scores > 0.5).all()


CHECKS = (
    "check_estimator_cloneable",
    "check_estimator_repr",
    "check_no_attributes_set_in_init",
    "check_parameters_default_constructible",
    "check_get_params_invariance",
    "check_set_params",
    "check_estimator_tags_renamed",
    "check_valid_tag_types",
    "check_do_not_raise_errors_in_init_or_set_params",
    "check_estimators_unfitted",
)
"""Those of scikit-learn's checks that fit no table of random numbers."""


@pytest.mark.parametrize("check", CHECKS)
def test_it_is_an_estimator_of_scikit_learn(check):
    from sklearn.utils import estimator_checks

    from pinav.regressor import ForceRegressor

    getattr(estimator_checks, check)("ForceRegressor", ForceRegressor())


@pytest.mark.parametrize(
    ("settings", "rows", "message"),
    [
        ({}, np.zeros((5, 3)), "columns trajectory, t, x, y, got an array of shape"),
        ({}, "text", "expected the columns trajectory, t, x, y"),
        ({"model": "nonsense"}, np.zeros((5, 4)), "Invalid enum value 'nonsense'"),
    ],
)
def test_what_cannot_be_fitted_is_refused(settings, rows, message):
    from pinav.regressor import ForceRegressor

    with pytest.raises(InputError, match=message):
        ForceRegressor("barrier-crossings", **settings).fit(rows)


def test_positions_of_another_dimension_are_refused(regressor):
    with pytest.raises(InputError, match="positions of 2 coordinates, one a row"):
        regressor.predict(np.zeros((3, 3)))
