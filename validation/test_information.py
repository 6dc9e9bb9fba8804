"""Suggested trajectories against random ones: the force along a route they teach.

Two random trajectories are known; three more are recorded, either as `suggest` says or
at random, and everything is fitted again after each. Both have the same number, length,
noise, region of release and limits, and their candidates come from the same
distribution; random ones, too, are drawn until the model expects them to stay inside
the arena. The route is the straight way across `many-barriers` and the same for both.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.actuation import LinearProgramme, LinearResponse
from pinav.dynamics import FixedStep
from pinav.fitting import fit_bayes, kernel_environment
from pinav.forces import KernelPotential
from pinav.navigation.design.candidates import (
    CandidateTrajectories,
    CommandedThrust,
    Experiment,
    best_candidate,
)
from pinav.navigation.design.information import (
    PosteriorInformation,
    PriorField,
    prior_uncertainty,
)
from pinav.navigation.task.steering import CommandLimits, RollingActuator
from pinav.navigation.task.task import Rectangle
from pinav.scenarios import many_barriers
from pinav.systems import Observation, System
from pinav.trajectories import concatenate, simulate

ARENA = Rectangle([0.0, 0.0], [20.0, 20.0])
ROUTE = np.linspace([2.0, 2.0], [18.0, 18.0], 41)
THRUST, NOISE, SEEDS = 1.5, 0.02, 10
KNOWN, ADDED = 2, 3
"""Trajectories at first, and how many follow."""


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    with jax.enable_x64(new_val=True):
        yield


class Laboratory:
    """A true environment, and what was recorded of it."""

    def __init__(self, seed: int):
        self.truth = many_barriers().true_swimmer
        self.experiment = Experiment(
            RollingActuator(THRUST * jnp.eye(2), LinearResponse()),
            CommandLimits(1.0),
            Rectangle([1.0, 1.0], [3.0, 3.0]),
            np.full(4, NOISE),
            8.0,
        )
        first, self.noises, self.choices = jax.random.split(jax.random.key(seed), 3)
        self.candidates: list[CandidateTrajectories] = []
        self.data = []
        empty = self.truth.without_environment()
        for _ in range(KNOWN):
            first, key = jax.random.split(first)
            self.record(self.random(empty, key))

    def random(self, model, key) -> CandidateTrajectories:
        """A random candidate that the model expects to stay inside."""
        pool = self.experiment.draw(40, key=key)
        some = (pool[k] for k in range(40))
        return next(one for one in some if inside(model, self.experiment, one))

    def suggested(self, key) -> CandidateTrajectories:
        """The candidate that should tell most of the route."""
        fit = self.fit
        assert fit.states is not None
        uncertainty = prior_uncertainty(
            fit.model,
            concatenate(self.data),
            fit.states,
            noise=fit.hyperparameters.noise,
            prior=PriorField(ARENA, THRUST / 2),
        )
        information = PosteriorInformation.of(
            uncertainty, ROUTE, self.experiment, ARENA
        )
        _, first, later = jax.random.split(key, 3)
        drawn = self.experiment.draw(64, key=first)
        best, _ = best_candidate(
            information, self.experiment, drawn, variations=63, keys=[later]
        )
        return best

    def record(self, candidate: CandidateTrajectories) -> None:
        """Observe a candidate, with its own span of the clock."""
        index = len(self.candidates)
        begin = float(begins(self.experiment, index + 1)[index])
        programme = LinearProgramme(
            self.experiment.knots + begin, candidate.frequency, candidate.heading
        )
        thrust = CommandedThrust(programme, self.experiment.actuator)
        driven = dataclasses.replace(self.truth, propulsion=thrust)
        made = System(
            name="many-barriers",
            swimmer=driven.without_environment(),
            dim=2,
            environment=driven.environment,
            observation=Observation(NOISE),
            starts=candidate.starts[None],
            times=self.experiment.times + begin,
        )
        self.candidates.append(candidate)
        self.data.append(simulate(made, key=jax.random.fold_in(self.noises, index)))

    def learn(self) -> float:
        """Fit everything; the relative error of the force along the route."""
        data = concatenate(self.data)
        candidates = jax.tree.map(lambda *leaves: jnp.stack(leaves), *self.candidates)
        model = eqx.tree_at(
            lambda s: (s.propulsion, s.environment),
            self.truth,
            (
                in_sequence(self.experiment, candidates),
                kernel_environment(KernelPotential, data),
            ),
        )
        self.fit = fit_bayes(model, data, throw=False)
        learned, true = (forces(m.environment) for m in (self.fit.model, self.truth))
        return float(np.linalg.norm(learned - true) / np.linalg.norm(true))


@eqx.filter_jit
def inside(model, experiment: Experiment, candidate: CandidateTrajectories):
    """True where a candidate stays inside the arena, as far as a model knows."""
    driven = eqx.tree_at(lambda m: m.propulsion, model, experiment.thrust(candidate))
    states, _ = FixedStep().solve(driven, candidate.starts, experiment.times)
    return jnp.all(jax.vmap(ARENA.distance)(states[:, :2]) <= 0)


def in_sequence(
    experiment: Experiment, candidates: CandidateTrajectories
) -> CommandedThrust:
    """One propulsion for all candidates, each at its own time: see `begins`.

    A fit knows a single propulsion for all trajectories, so that each has its own span
    of the operator's clock.
    """
    count = candidates.starts.shape[0]
    knots = experiment.knots[None] + jnp.asarray(begins(experiment, count))[:, None]
    flat = (a.reshape(-1) for a in (knots, candidates.frequency, candidates.heading))
    return CommandedThrust(LinearProgramme(*flat), experiment.actuator)


def begins(experiment: Experiment, count: int) -> np.ndarray:
    """When each of several candidates begins on the operator's clock."""
    return np.arange(count) * (experiment.duration + experiment.knot)


def forces(environment):
    at = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))
    return np.asarray(at(jnp.asarray(ROUTE)))


def errors(seed: int, *, suggested: bool) -> list[float]:
    """Force error along the route after each fit."""
    laboratory = Laboratory(seed)
    found = [laboratory.learn()]
    for key in jax.random.split(laboratory.choices, ADDED):
        chosen = (
            laboratory.suggested(key)
            if suggested
            else laboratory.random(laboratory.fit.model, jax.random.fold_in(key, 1))
        )
        laboratory.record(chosen)
        found.append(laboratory.learn())
    return found


def test_suggested_trajectories_teach_more_than_random_ones():
    rows = {
        name: np.array([errors(seed, suggested=chosen) for seed in range(SEEDS)])
        for name, chosen in (("suggested", True), ("random", False))
    }
    for name, values in rows.items():
        print(name, np.round(values, 3).tolist(), np.median(values, axis=0))
    suggested, random = (np.median(rows[name][:, -1]) for name in rows)
    assert suggested <= 0.7 * random
