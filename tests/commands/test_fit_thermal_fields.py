"""Options of thermal motion: fields, coordinates, periods, a drifting reference."""

import dataclasses

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from pinav import fitting
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.forces import KernelTensor, ZeroForce
from pinav.learning.learned import Learned
from pinav.learning.plan import plan_fit
from pinav.learning.recipes import Langevin
from pinav.systems import System, parse_system, system_text
from pinav.trajectories import Trajectories

LEARN = Langevin(observation="learn")


def system(dim=3, **parts):
    swimmer = OverdampedSwimmer(ZeroForce(), ZeroForce(), 2.0)
    return System("bead", swimmer, dim, thermal_energy=0.1, **parts)


def walk(dim=3):
    """A random walk of 400 steps in a box."""
    random = np.random.default_rng(0)
    path = np.cumsum(0.05 * random.normal(size=(400, dim)), axis=0)
    return Trajectories.from_arrays(
        np.arange(400) / 50, path[None], channels=("x", "y", "z")[:dim]
    )


def plan(known=None, data=None, model=None, **options):
    recipe = msgspec.structs.replace(LEARN, **options)
    data = walk() if data is None else data
    return plan_fit(known or system(), data, model=model, recipe=recipe)


def test_words_become_values():
    chosen = plan(
        diffusion="tensor", coordinates=("z",), warp=("z",), reference="z"
    ).thermal
    assert isinstance(chosen.diffusion, fitting.KernelDiffusion)
    assert chosen.diffusion.groups == ((0, 1), (2,))
    assert [axis.index for axis in chosen.axes] == [2]
    assert chosen.axes[0].warp is not None
    assert chosen.reference.axis == 2
    assert chosen.einstein
    assert isinstance(chosen.observation, fitting.LearnedObservation)


def test_without_a_thermal_energy_the_drift_is_free():
    cold = dataclasses.replace(system(), thermal_energy=None)
    chosen = plan(cold, diffusion="field", coordinates=("x", "y")).thermal
    assert not chosen.einstein
    assert chosen.diffusion.groups is None
    assert not plan().thermal.einstein  # one number, beside the known mobility


def test_a_period_makes_increments_of_a_constant_diffusion_short():
    chosen = plan(period=("x=2.5",), observation="exact").thermal
    assert isinstance(chosen.diffusion, fitting.ConstantDiffusion)
    assert [axis.period for axis in chosen.axes] == [2.5, None, None]


def test_a_known_camera_is_that_of_the_system():
    from pinav.systems import Observation

    known = system(observation=Observation(noise=0.02, exposure=0.01))
    chosen = plan(known, observation="known").thermal
    assert chosen.observation is known.observation


FILE = """
name = "bead"
dimension = 3
order = 1
mobility = 2.0

[thermal]
energy = 0.1

[unknown]
model = "kernel-force"
diffusion = "tensor"
observation = "learn"
coordinates = ["y", "z"]
period = { y = 6.25 }
warp = ["z"]
reference = "z"
"""


def test_a_system_file_states_the_same_words():
    stated = parse_system(FILE)
    assert parse_system(system_text(stated)).thermal == stated.thermal
    by_file = plan_fit(stated, walk(), recipe=Langevin())
    by_options = plan(
        model="kernel-force",
        diffusion="tensor",
        coordinates=("y", "z"),
        period=("y=6.25",),
        warp=("z",),
        reference="z",
    )
    assert by_file.recipe == by_options.recipe
    other = plan(stated, diffusion="constant")
    assert other.recipe.diffusion == "constant"
    assert other.recipe.coordinates == ("y", "z")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('diffusion = "wavy"', "unknown.diffusion: expected one of constant, field"),
        ('observation = "no"', "unknown.observation: expected one of exact, learn, kn"),
        ("reference = 2", "unknown.reference: expected text in quotes, got 2"),
        ("period = 3.0", "unknown.period: expected numbers by coordinate"),
        ("period = { x = -1 }", "--period: expected a coordinate and a number > 0"),
        ('warp = "z"', r"unknown.warp: expected a list \[...\], got 'z'"),
        ('difusion = "field"', "unknown.difusion: this key is unknown"),
    ],
)
def test_a_wrong_word_in_a_file_is_named(text, message):
    head = FILE.partition("model")[0]
    with pytest.raises(InputError, match=message):
        parse_system(head + text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"diffusion": "field"}, "expected one or two coordinates on which it depends"),
        ({"coordinates": ("q",)}, "--coordinates: expected coordinates of system bead"),
        ({"coordinates": ("z", "z")}, "--coordinates: expected each coordinate once"),
        ({"period": ("x",)}, "--period: expected a coordinate and a number > 0, such"),
        ({"period": ("x=0",)}, "--period: expected a coordinate and a number > 0"),
        ({"period": ("x=1", "x=2")}, "--period: expected one for each coordinate"),
        ({"period": ("x=1",), "coordinates": ("z",)}, "--period x: fields depend on z"),
        ({"warp": ("x",), "coordinates": ("z",)}, "--warp x: fields depend on z alone"),
        ({"warp": ("x",), "period": ("x=1",)}, "--warp x: a coordinate that repeats"),
        ({"reference": "x", "coordinates": ("z",)}, "--reference x: force and diffus"),
        ({"reference": "q"}, "--reference: expected coordinates of system bead, x, y"),
        ({"observation": "known"}, "--observation known: system bead states neither"),
        (
            {"coordinates": ("z",), "model": "kernel-mixture"},
            "--model kernel-mixture: a force that depends on --coordinates",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        plan(**options)


def test_one_coordinate_has_no_tensor_and_inertia_no_thermal_motion():
    text = 'dimension = 2\norder = 2\ndrag = 1.0\n[unknown]\ndiffusion = "field"\n'
    with pytest.raises(InputError, match="unknown.diffusion: thermal motion needs ord"):
        parse_system(text)
    with pytest.raises(InputError, match="tensor: one coordinate has no directions"):
        plan(system(1), walk(1), diffusion="tensor")


@pytest.mark.slow
def test_a_ring_is_fitted_with_its_period_and_known_blur(tmp_path, printed):
    """D = 0.273 um²/s everywhere; the force repeats, in data that are not wrapped."""
    data, run = tmp_path / "data.npz", tmp_path / "run"
    printed("simulate", "ring", "--count", "3", "--out", data)
    learn = ["--observation", "known", "--diffusion", "field", "--period", "x=25.8867"]
    printed("fit", data, "--out", run, *learn)
    fitted = Learned.open(run)
    metrics = fitted.findings
    diffusion = metrics.constants["diffusion"]
    assert abs(diffusion.value - 0.273) < 3 * diffusion.sd < 0.03
    assert metrics.force_error["at the samples"] < 0.15
    assert metrics.thermal.observed[0].exposure.value == pytest.approx(0.6)
    page = (run / "report.html").read_text()
    assert "Diffusion along x through the middle of the data" in page
    force = jax.vmap(lambda x: fitted.model.environment(0.0, x, x))
    places = jnp.linspace(0.0, 25.0, 20)[:, None]
    np.testing.assert_allclose(force(places), force(places + 2 * 25.8867), atol=1e-9)
    assert isinstance(fitted.model.mobility, KernelTensor)
    again = fitted.posterior.force_sd(np.asarray(places))
    np.testing.assert_array_less(0, again)


@pytest.mark.slow
def test_a_wall_is_fitted_with_a_tensor_and_a_reference(tmp_path, printed):
    data, run = tmp_path / "data.npz", tmp_path / "run"
    printed("simulate", "wall", "--count", "1", "--out", data)
    wall = ["--diffusion", "tensor", "--coordinates", "z", "--warp", "z"]
    options = ["--observation", "learn", "--reference", "z", *wall]
    printed("fit", data, "--out", run, *options)
    checks = Learned.open(run).findings.thermal
    along, normal = checks.observed
    assert (along.channels, normal.channels) == (("x", "y"), ("z",))
    assert 0.05 < along.low < along.high < 0.142 * 1.2
    assert normal.high < along.high
    assert checks.einstein
    assert checks.reference.axis == 2
    rising = checks.lines["z"].values[:, 2]
    assert rising[5] < rising[25] < rising[50]
