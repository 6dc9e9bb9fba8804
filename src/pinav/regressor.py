"""`ForceRegressor`: the fit of `pinav fit` with the interface of scikit-learn."""

from collections.abc import Sequence
from typing import Any, final

import jax
import msgspec
import numpy as np
from jaxtyping import ArrayLike, Float

from pinav.errors import InputError
from pinav.evaluation import estimate_starts, predict, without_first
from pinav.learning.learn import learn
from pinav.learning.recipes import ModelName, Suited
from pinav.trajectories import Trajectories, with_all_channels

try:
    from sklearn.base import BaseEstimator
    from sklearn.utils import Tags
    from sklearn.utils.validation import check_is_fitted
except ImportError as error:
    raise InputError(
        "ForceRegressor needs scikit-learn; install it by pip install 'pinav[exchange]'"
    ) from error

COLUMNS = ("trajectory", "t", "x", "y")
"""What the columns of an array are, unless others are given."""


@final
class ForceRegressor(BaseEstimator):
    r"""The force of an unknown environment, learned from tracks.

    It chooses the recipe as `pinav fit` does. A row of the table that is fitted is one
    observation: which trajectory, when, and where. `predict` takes positions and
    returns the force there; `score` judges rollouts of tracks that were not fitted, so
    that scikit-learn's cross-validation applies with whole trajectories as groups:

        cross_val_score(ForceRegressor("my.toml"), X, groups=X[:, 0], cv=GroupKFold(4))

    Attributes:
        system: what is known of the swimmer: a `System`, a system file, or the name of
            a built-in system.
        model: what stands for the unknown; that of the system unless given.
        structure: "search" for a structure of the force, or "free" kernels alone.
        columns: what the columns of an array are; a table of pandas or polars, or
            `Trajectories`, says it itself.
        run_: the fit, a `pinav.Learned`.
        constants_: learned constants with their standard deviations.
    """

    # scikit-learn may set any value and expects errors from fit alone.
    def __init__(
        self,
        system: Any = None,
        *,
        model: Any = None,
        noise: Any = None,
        structure: Any = "search",
        columns: Any = COLUMNS,
    ) -> None:
        self.system = system
        self.model = model
        self.noise = noise
        self.structure = structure
        self.columns = columns

    def fit(self, X: Any, y: None = None) -> "ForceRegressor":
        """Learn the force from tracks.

        Args:
            X: `Trajectories`, a table of pandas or polars with columns as in CSV
                files, or an array with those of `columns`.

        Raises:
            InputError: the table is none of these, or cannot be fitted.
        """
        given = {"noise": self.noise, "structure": self.structure}
        try:
            model = msgspec.convert(self.model, ModelName | None)
            recipe = msgspec.convert(given | {"recipe": "default"}, Suited)
        except msgspec.ValidationError as error:
            raise InputError(f"ForceRegressor: {error}") from error
        data = self._tracks(X)
        self.run_ = learn(self.system, data, model=model, recipe=recipe)
        self.constants_ = self.run_.constants
        return self

    def predict(
        self, X: ArrayLike, *, return_std: bool = False
    ) -> (
        Float[np.ndarray, "point dim"]
        | tuple[Float[np.ndarray, "point dim"], Float[np.ndarray, "point dim"]]
    ):
        """The force on a swimmer at rest at each position.

        Raises:
            NotFittedError: nothing was fitted.
            InputError: the rows are no positions, or the model has no posterior and
                `return_std` is true.
        """
        check_is_fitted(self)
        places = np.asarray(X, np.float64)
        if places.ndim != 2 or places.shape[1] != self.run_.data.dim:
            raise InputError(
                f"predict: expected positions of {self.run_.data.dim} coordinates, one "
                f"a row, got an array of shape {places.shape}"
            )
        force = self.run_.force(places)
        if not return_std:
            return force
        if self.run_.posterior is None:
            raise InputError(
                f"return_std: the model {self.run_.choice.name} has no posterior; "
                "fit a kernel model"
            )
        return force, self.run_.posterior.force_sd(places)

    def score(self, X: Any, y: None = None) -> float:
        r"""The share of the variance of the positions that rollouts explain.

        $R^2 = 1 - \sum |\hat x - x|^2 / \sum |x - \bar x|^2$ over the samples after the
        first 20 of each trajectory, from which its start is estimated.

        Args:
            X: tracks as `fit` takes them, each longer than 20 samples.

        Returns:
            At most 1; minus infinity where a rollout diverged.

        Raises:
            NotFittedError: nothing was fitted.
            InputError: the table is no such one, or a trajectory is too short.
        """
        check_is_fitted(self)
        model, system = self.run_.model, self.run_.system
        data = with_all_channels(self._tracks(X), system)
        with jax.enable_x64(new_val=True):
            starts = estimate_starts(model, data)
            states, _ = predict(model, data, starts=starts.states)
        later = without_first(data, starts.count)
        positions = later.seen_positions
        errors = states[later.seen][:, : data.dim] - positions
        if not np.isfinite(errors).all():
            return -np.inf
        spread = positions - positions.mean(axis=0)
        return float(1 - np.sum(errors**2) / np.sum(spread**2))

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = False
        tags.non_deterministic = False
        tags.input_tags.allow_nan = True
        tags.input_tags.string = True
        return tags

    def _tracks(self, table: Any) -> Trajectories:
        """The trajectories in a table of any kind that `fit` takes."""
        if isinstance(table, Trajectories):
            return table
        if isinstance(table, np.ndarray | Sequence):
            array = np.asarray(table)
            if array.ndim != 2 or array.shape[1] != len(self.columns):
                raise InputError(
                    f"ForceRegressor: expected the columns {', '.join(self.columns)}, "
                    f"got an array of shape {array.shape}; name its columns by columns="
                )
            table = dict(zip(self.columns, array.T, strict=True))
        return Trajectories.from_table(table)
