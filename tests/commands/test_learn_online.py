"""`pinav navigate --learn-online`: its words, and a run from end to end."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitted_runs import trap_system
from tests.samples import sample

from pinav import forces, navigation
from pinav.commands.navigate.job import online_task, with_prior
from pinav.commands.navigate.sections import online_sections
from pinav.dynamics import OverdampedSwimmer, paper_black_box
from pinav.errors import InputError
from pinav.learning.learned import Learned
from pinav.navigation.belief.belief import Frame
from pinav.report import sections_text
from pinav.systems import UniformStarts, Units, write_system


def found(units):
    learning = sample(
        navigation.FlightOutcome,
        regret=navigation.Interval(1.14, 1.1, np.inf),
        changed=3.0,
        memory=1e6,
    )
    return sample(
        navigation.OnlineNavigation,
        position_noise=0.02,
        time_limit=30.0,
        own_limit=30.0,
        units=units,
        controllers={"oracle": sample(navigation.FlightOutcome), "visit 1": learning},
        paths=dict.fromkeys(("oracle", "visit 1"), (np.zeros((3, 2)),)),
    )


def test_the_words_name_what_was_known_and_what_it_took():
    words = sections_text(online_sections(found({})))
    assert "1.140 (1.100–∞)" in words
    assert "nothing is known of the force beforehand" in words
    assert "The safety filter changed 3 commands in a flight." in words
    assert "takes 1 MB" in words
    assert "after 30.0; the task's own limit is 30.0." in words
    stated = {"x": "um", "y": "um", "t": "s", "order": "1"}
    words = sections_text(online_sections(found(stated)))
    assert "arrival [s]" in words
    assert "least clearance [µm]" in words
    assert "an error of 0.0200 um" in words
    assert "after 30.0 s; the task's own limit is 30.0 s." in words


@pytest.mark.slow
def test_a_task_is_learned_from_no_data_to_a_report(tmp_path, printed):
    out = tmp_path / "out"
    words = ["navigate", "--learn-online", "vortex", "--seeds", "1", "--visits", "1"]
    rows = json.loads(printed(*words, "--json", "--out", out))["controllers"]
    assert rows["oracle"]["success"]["value"] == 1.0
    assert rows["visit 1"]["success"]["value"] == 1.0
    assert rows["visit 1"]["regret"]["value"] < 1.4
    assert rows["visit 1"]["force_error"] < 0.15
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "data:image/gif;base64," in page
    for figure in ("belief", "bands", "paths", "regret"):
        assert (out / "figures" / f"learn-online-{figure}.svg").exists()


@pytest.mark.slow
def test_a_system_of_the_users_own_is_learned_with_what_it_knows(tmp_path, printed):
    """A roller that sinks, in a barrier of which it does not know."""
    own = trap_system(
        swimmer=OverdampedSwimmer(
            forces.RollingPropulsion.of(0.4),
            forces.ZeroForce(),
            0.5,
            known_force=forces.SumForce((forces.ConstantForce([0.0, -0.8]),)),
        ),
        environment=forces.GaussianBarrier(2.0, [5.0, 5.0], 1.5),
        rule=UniformStarts((0.0, 0.0), (9.0, 9.0), count=2),
        times=np.linspace(0.0, 10.0, 101),
    )
    file, out = tmp_path / "own.toml", tmp_path / "out"
    write_system(own, file)
    words = ["navigate", "--learn-online", str(file), "--seeds", "1"]
    words += ["--from=1,1", "--to=9,9", "--visits", "1", "--noise", "0.02", "--json"]
    rows = json.loads(printed(*words, "--out", out))["controllers"]
    assert rows["visit 1"]["success"]["value"] == 1.0
    assert rows["visit 1"]["regret"]["value"] < 1.4
    assert rows["visit 1"]["force_error"] < 0.4
    assert rows["visit 1"]["cover"] > 0.8
    assert rows["visit 1"]["consistency"] < 2.0


def adaptive_of(name):
    return navigation.AdaptiveController.of(
        online_task(name, position_noise=0.02, delay=0.0), points=13
    )


def test_a_fit_is_taken_over_with_its_posterior(fitted_run):
    run = Learned.open(fitted_run("kernel")[0])
    adaptive = with_prior(adaptive_of("barrier-weak"), run, Units())
    places = np.array([[2.0, 2.0], [4.0, 4.5]])
    first = Frame(0.0, places[0], 0.02, np.zeros(2))
    mean, sd = adaptive.believe(first).force(places)
    environment = run.model.environment
    for x, force in zip(places, mean, strict=True):
        exact = environment(0.0, jnp.asarray(x), jnp.zeros(2))
        np.testing.assert_allclose(force, exact, atol=5e-3)
    _, unknown = adaptive_of("barrier-weak").believe(first).force(places)
    assert np.all(sd < unknown / 2)


def test_a_fit_that_cannot_be_a_prior_is_refused(fitted_run):
    inertial = Learned.open(fitted_run("kernel")[0])
    with pytest.raises(InputError, match="swimmer without inertia in 2 dimensions"):
        with_prior(adaptive_of("vortex"), inertial, Units())
    network = Learned.open(fitted_run("network")[0])
    with pytest.raises(InputError, match="expected a fit with a posterior, got"):
        with_prior(adaptive_of("barrier-weak"), network, Units())
    other = dataclasses.replace(
        inertial, models={"model": paper_black_box(jax.random.key(0))}
    )
    with pytest.raises(InputError, match="expected a fitted swimmer, got the model"):
        with_prior(adaptive_of("barrier-weak"), other, Units())
    with pytest.raises(InputError, match="expected a fit in um, s and pN, got one in"):
        with_prior(adaptive_of("vortex"), inertial, Units("um", "s", "pN"))
