"""A field of position is found beside commands and a wandering velocity."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.identification.conftest import as_recording

from pinav import fitting, identification
from pinav.errors import InputError
from pinav.evaluation import predict
from pinav.forces import KernelForce, NeuralForce, ShearFlow
from pinav.systems import FreeNumber

pytestmark = pytest.mark.slow

GAIN, DRIFT, DELAY = 3.0, np.array([0.3, -0.2]), 0.25
STIFFNESS, SWIRL = 0.25, 0.12


def field(x):
    """A trap with a rotation about the origin [um/s]."""
    turned = np.stack([-x[..., 1], x[..., 0]], axis=-1)
    return (-STIFFNESS * x + SWIRL * turned) * np.exp(-(x**2).sum(-1) / 200)[..., None]


def recording(seed=0, *, duration=300.0, step=0.1, strength=1.0, wandering=0.5):
    """A robot that random headings drive about a trap, and that wanders."""
    random = np.random.default_rng(seed)
    fine = np.arange(0, duration, step / 10)
    times = fine[::10]
    heading = np.cumsum(random.normal(0, 0.35, len(times)))
    frequency = np.ones(len(times))
    index = np.maximum(np.searchsorted(times, fine - DELAY, side="right") - 1, 0)
    direction = np.stack([np.cos(heading[index]), np.sin(heading[index])], axis=1)
    thrust = GAIN * frequency[index, None] * direction + DRIFT
    x, w, path, dt = np.zeros(2), np.zeros(2), [], step / 10
    decay = np.exp(-dt / 1.0)
    for push, kick in zip(thrust, random.normal(size=(len(fine), 2)), strict=True):
        path.append(x)
        x = x + dt * (push + strength * field(x) + w)
        w = decay * w + wandering * np.sqrt(1 - decay**2) * kick
    seen = np.array(path)[::10] + 0.05 * random.normal(size=(len(times), 2))
    return as_recording((times, seen, {"frequency": frequency, "heading": heading}))


GRID = fitting.KernelGrid(across=5, margin=2.0)

CANDIDATE = identification.with_learned(
    identification.gain_matrix(), "delay", "propulsion.delay"
)


def identified(data):
    """The system that identification finds, which knows of no field."""
    fit = identification.fit_track(identification.tracks(data)[0], CANDIDATE)
    return identification.system_of(
        fit, jitter=0.05, name="robot", units=data.units
    ), fit


def with_a_field(system, data):
    kernels = fitting.kernel_environment(KernelForce, data, GRID, dim=2)
    return identification.fit_commanded(system, data, kernels, refine=None)


@pytest.fixture(scope="module")
def trapped():
    data = recording(duration=120.0)
    system, _ = identified(data)
    return data, system, with_a_field(system, data)


@pytest.fixture(scope="module")
def short():
    """Twenty seconds, and what is found in them without a field."""
    data = recording(4, duration=20.0)
    return data, identified(data)[0]


def error_and_deviation(fit, data):
    """Error of the field where the robot was, with drift, and its deviation.

    Neither environment nor drift is known alone as well as their sum.
    """
    places, posterior = data.states[0][::40], fit.posterior

    def velocity(theta, x):
        model = posterior.free(theta)
        return model.environment(0.0, x, jnp.zeros(2)) + model.flow.velocity

    mean, at = jnp.asarray(posterior.mean), jnp.asarray(places)
    learned = jax.vmap(velocity, (None, 0))(mean, at)
    rows = np.asarray(jax.vmap(jax.jacrev(velocity), (None, 0))(mean, at))
    variance = np.sum((rows @ posterior.covariance) * rows, axis=-1)
    return learned - (field(places) + DRIFT), np.sqrt(variance)


def test_a_field_is_found_beside_commands_and_wandering(trapped):
    data, _, fit = trapped
    assert fit.outcome is fitting.Outcome.CONVERGED
    error, sd = error_and_deviation(fit, data)
    truth = field(data.states[0][::40])
    assert np.sqrt(np.mean(error**2)) < 0.35 * np.sqrt(np.mean(truth**2))
    inside = np.mean(np.abs(error) <= 1.96 * sd)
    assert inside >= 0.85
    assert fit.constants["propulsion.gain[0, 0]"].value == pytest.approx(GAIN, rel=0.1)
    assert fit.constants["propulsion.delay"].value == pytest.approx(DELAY, abs=0.12)


def test_the_wandering_velocity_leaves_the_field_its_part(trapped):
    data, system, fit = trapped
    alone = identification.fit_commanded(system, data, None)
    assert evidence(fit) - evidence(alone) > 20
    (with_field, without) = (
        [f.constants[f"wandering.{name}"].value for name in ("still", "driven")]
        for f in (fit, alone)
    )
    assert min(with_field) >= 0
    assert np.hypot(*with_field) < 0.8 * np.hypot(*without)
    assert np.hypot(*with_field) == pytest.approx(0.5, rel=0.35)


def evidence(fit):
    return fitting.model_evidence(fit.linear, fit.hyperparameters).log_evidence


def test_where_there_is_no_field_none_is_found():
    data = recording(1, strength=0.0, duration=120.0)
    system, _ = identified(data)
    alone = identification.fit_commanded(system, data, None)
    assert evidence(with_a_field(system, data)) < evidence(alone) + 2.0


def test_the_evidence_without_a_field_is_that_of_the_candidate():
    data = recording(2, duration=60.0)
    system, track_fit = identified(data)
    alone = identification.fit_commanded(system, data, None)
    # priors stand about the estimates here, about the track's scales there
    assert evidence(alone) == pytest.approx(
        track_fit.hyperparameters.log_evidence, abs=8.0
    )
    assert alone.constants["propulsion.delay"].value == pytest.approx(
        track_fit.constants["propulsion.delay"].value, abs=0.03
    )


def test_the_posterior_of_a_track_is_over_the_numbers_of_its_swimmer():
    data = recording(3, duration=60.0)
    system, fit = identified(data)
    posterior = fit.posterior
    learned = posterior.free.unravel(jnp.sqrt(jnp.diag(posterior.covariance)))
    gain = fit.constants["propulsion.gain[0, 1]"]
    assert float(posterior.model.propulsion.gain[0, 1]) == pytest.approx(gain.value)
    assert float(learned.propulsion.gain[0, 1]) == pytest.approx(gain.sd)
    states, _ = predict(posterior.model, data.select([0]))
    assert np.isfinite(states).all()
    assert system.swimmer.propulsion.gain.shape == (2, 2)


def test_networks_are_refused(short):
    data, system = short
    network = fitting.neural_environment(
        NeuralForce, data, key=jax.random.key(0), width=4, dim=2
    )
    with pytest.raises(InputError, match="choose kernel-force"):
        identification.fit_commanded(system, data, network)


def test_an_open_number_that_is_not_learned_here_is_refused(short):
    """It would be left at its placeholder, and taken for known."""
    data, system = short
    opened = dataclasses.replace(
        system,
        swimmer=dataclasses.replace(system.swimmer, flow=ShearFlow(0.1)),
        learn=(FreeNumber("flow.rate"),),
    )
    with pytest.raises(InputError, match=r"learn: flow\.rate cannot be learned"):
        identification.fit_commanded(opened, data, None)
