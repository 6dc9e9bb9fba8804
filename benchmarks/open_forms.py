"""Open-form search for the law of a profile (extra `symbolic`).

Where no candidate of the library fits, a formula may still be found from nothing: the
force along the coordinate of a structured term, or along the radius of a central force,
is a function of one variable, and genetic programming finds it.
The front of short and exact formulas is ranked again by the covariance of the force.
"""

import importlib
import re
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.analysis.discovery.force_sample import (
    FLOOR,
    Centrality,
    CentralTest,
    ForceSample,
    Sampling,
    central_test,
    project_covariance,
)
from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.fitting import ParametricModel
from pinav.forces import AbstractProfileTerm, ObstaclesTerm, split_structure

SYMBOLS = "add,sub,mul,div,exp,square,sqrt,constant,variable"
"""What a formula may be made of."""

_NUMBER = re.compile(r"\d+\.\d+")


class ProfileSample(eqx.Module):
    """A force along one coordinate, with the joint covariance of its errors.

    Attributes:
        z: values of the coordinate [L].
        force: along it [L T⁻²].
        num_effective: number of independent numbers that the data tell about it.
    """

    z: Float[np.ndarray, " point"]
    force: Float[np.ndarray, " point"]
    covariance: Float[np.ndarray, "point point"]
    num_effective: float

    @property
    def total_covariance(self) -> Float[np.ndarray, "point point"]:
        """The covariance with the error of `FLOOR` at every point."""
        floor = FLOOR * float(np.sqrt(np.mean(self.force**2)))
        floor = max(floor, np.finfo(float).tiny ** 0.25)
        return self.covariance + floor**2 * np.eye(len(self.force))


def sample_profile(sampling: Sampling, index: int) -> ProfileSample:
    """The profile of one term of a structured force, along its coordinate.

    Raises:
        InputError: the term has no such profile.
    """
    term = split_structure(sampling.posterior.model.environment)[0][index]
    several = isinstance(term, ObstaclesTerm)
    if several or not isinstance(term, AbstractProfileTerm):
        raise InputError(
            f"term {index} of the structure ({term.kind}) has no profile of a "
            "single coordinate; choose another one"
        )
    with jax.enable_x64(new_val=True):
        z = jax.vmap(lambda x: term.coordinates(x)[0])(jnp.asarray(sampling.positions))
        z = jnp.sort(z)
        theta = jnp.asarray(sampling.posterior.mean)
        values, rows = _profile_and_jacobian(sampling.posterior.free, theta, z, index)
    rows = np.asarray(rows)
    covariance = rows @ sampling.posterior.covariance @ rows.T
    return ProfileSample(
        np.asarray(z), np.asarray(values), covariance, sampling.num_effective
    )


@eqx.filter_jit
def _profile_and_jacobian(
    free: ParametricModel,
    theta: Float[Array, " parameter"],
    z: Float[Array, " point"],
    index: int,
) -> tuple[Float[Array, " point"], Float[Array, "point parameter"]]:
    def force(theta: Float[Array, " parameter"], z: Scalar) -> Float[Array, ""]:
        return free(theta).environment.terms[index].profile(z)

    values = jax.vmap(force, (None, 0))(theta, z)
    return values, jax.vmap(jax.jacrev(force), (None, 0))(theta, z)


class OpenForm(eqx.Module):
    """A formula of a force along one coordinate.

    Attributes:
        formula: of the force [L T⁻²].
        length: number of its symbols.
        squares: sum of squared, independent residuals of unit variance.
        bic: the squares, plus log of the effective sample size for each number in it.
    """

    formula: str = eqx.field(static=True)
    length: int
    squares: float
    bic: float


def search_radial_law(
    sample: ForceSample, *, seconds: int = 5, max_length: int = 20, seed: int = 0
) -> tuple[CentralTest, tuple[OpenForm, ...]]:
    """Formulas of the radial force of a central field, the best one first.

    Args:
        sample: the force, with the covariance of its errors.
        seconds: how long to search at most.
        max_length: number of symbols of a formula at most.
        seed: of the search.

    Returns:
        The test for a centre, and the formulas in `r`, the distance from it.

    Raises:
        InputError: the force is not central, pyoperon is not installed, or a setting
            is not positive.
    """
    central = central_test(sample)
    if central.verdict is not Centrality.CENTRAL:
        raise InputError(
            f"search_radial_law: the force is {central.verdict.value} as a central "
            "one; only a central force has a radial law"
        )
    offsets = sample.positions - np.array(central.center)
    radius = np.linalg.norm(offsets, axis=1)
    outward = offsets / np.maximum(radius, 1e-12)[:, None]
    profile = ProfileSample(
        radius,
        np.sum(outward * sample.force, axis=1),
        project_covariance(sample.total_covariance, outward),
        sample.num_effective,
    )
    forms = search_profile_law(
        profile, name="r", seconds=seconds, max_length=max_length, seed=seed
    )
    return central, forms


def search_profile_law(
    sample: ProfileSample,
    *,
    name: str = "z",
    seconds: int = 5,
    max_length: int = 20,
    seed: int = 0,
) -> tuple[OpenForm, ...]:
    """Formulas of the force along one coordinate, the best one first.

    Args:
        sample: the force, with the covariance of its errors.
        name: of the coordinate in the formulas.
        seconds: how long to search at most.
        max_length: number of symbols of a formula at most.
        seed: of the search.

    Raises:
        InputError: pyoperon is not installed, or a setting is not positive.

    References:
        Burlacu, Kronberger and Kommenda, Operon C++, GECCO 2020 companion, 1562.
    """
    if seconds < 1 or max_length < 1:
        raise InputError(
            "search_profile_law: expected one or more seconds and symbols, got "
            f"{seconds} and {max_length}"
        )
    column, force = sample.z[:, None], sample.force
    inverse = np.linalg.inv(sample.total_covariance)
    regressor = _regressor(seconds, max_length, seed).fit(column, force)
    forms = {}
    for member in regressor.pareto_front_:
        predicted = regressor.evaluate_model(member["tree"], column)
        text = regressor.get_model_string(member["tree"], 6)
        residual = np.asarray(predicted, float).reshape(-1) - force
        if np.all(np.isfinite(residual)):
            squares = float(residual @ inverse @ residual)
            count = len(_NUMBER.findall(text))
            penalty = count * np.log(max(sample.num_effective, np.e))
            formula = text.replace("X1", name)
            forms[formula] = OpenForm(
                formula, int(member["length"]), squares, squares + float(penalty)
            )
    return tuple(sorted(forms.values(), key=lambda form: form.bic))


def _regressor(seconds: int, max_length: int, seed: int) -> Any:
    try:
        regression = importlib.import_module("pyoperon.sklearn")
    except ImportError as error:
        raise InputError(
            "the search for a formula needs pyoperon: install pinav[symbolic] "
            f"(Linux x86-64 and macOS arm64 only): {error}"
        ) from error
    return regression.SymbolicRegressor(
        allowed_symbols=SYMBOLS,
        objectives=["mse", "length"],
        max_length=max_length,
        optimizer_iterations=10,
        max_time=seconds,
        n_threads=1,
        random_state=seed,
        population_size=500,
        pool_size=500,
    )
