"""`pinav navigate --learn-online`: refusals, words, and a run from end to end."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav import cli
from pinav.codec import encode
from pinav.commands.navigate.cells import online_task, with_prior
from pinav.commands.navigate.online_sections import online_sections
from pinav.dynamics import paper_black_box
from pinav.errors import InputError
from pinav.evaluation import FieldMap
from pinav.learning.learned import Learned
from pinav.navigation import (
    AbstractNavigation,
    AdaptiveController,
    Course,
    FlightOutcome,
    ForceMaps,
    Interval,
    OnlineNavigation,
    Quantiles,
)
from pinav.navigation.adaptive.flight import ShownFlight
from pinav.navigation.belief.belief import Frame
from pinav.report import sections_text
from pinav.runs import RunFolder
from pinav.systems import Units

REFUSALS = {
    "nothing": ([], "RUN: expected the folder of a fit, or --learn-online"),
    "a run without places": (["somewhere"], "--from, --to: expected the places"),
    "a prior that is no run": (["nowhere", "--learn-online", "vortex"], "nowhere"),
    "half of the places": (
        ["--learn-online", "vortex-current", "--from", "1,1"],
        "--from, --to: expected the places",
    ),
    "a system without places": (
        ["--learn-online", "paper"],
        "task 'paper' is unknown; choose one of: barrier-",
    ),
    "an unknown system": (
        ["--learn-online", "maze", "--from=1,1", "--to=2,2"],
        "maze",
    ),
    "a system in space": (
        ["--learn-online", "wall", "--from=1,1", "--to=2,2"],
        "system: expected a swimmer in the plane, got 'wall'",
    ),
    "a path": (
        ["--learn-online", "follow-line"],
        "expected a place to reach, got FollowPath",
    ),
}


@pytest.mark.parametrize(("words", "message"), REFUSALS.values(), ids=REFUSALS)
def test_what_makes_no_sense_is_refused(words, message, tmp_path, refused):
    refused(["navigate", *words, "--out", tmp_path / "out"], message)


SHARE = Interval(1.0, 0.8, 1.0)
KNOWING = FlightOutcome(
    runs=20,
    success=SHARE,
    in_time=SHARE,
    violation=Interval(0.0, 0.0, 0.2),
    arrival=Quantiles(5.0, 5.5, 6.0),
    regret=None,
    clearance=0.4,
    force_error=None,
    cover=None,
    consistency=1.1,
    changed=0.0,
    frame_time=0.002,
    command_time=0.004,
    replan_time=0.05,
    memory=1e6,
)
LEARNING = dataclasses.replace(
    KNOWING,
    regret=Interval(1.14, 1.1, np.inf),
    force_error=0.05,
    cover=0.95,
    changed=3.0,
)


def found(units):
    field = FieldMap(*np.eye(2), np.zeros((2, 2, 2)), np.zeros((2, 2)))
    maps = ForceMaps(field, field, np.zeros((2, 2, 2)))
    along, over = np.zeros((3, 2)), np.zeros((1, 2, 2, 2))
    return OnlineNavigation(
        task="vortex",
        position_noise=0.02,
        delay=0.0,
        time_limit=30.0,
        own_limit=30.0,
        thrust=1.0,
        step=0.1,
        prior=False,
        units=units,
        course=Course(np.eye(2), np.zeros(2), np.ones(2), 0.3, np.zeros((0, 3))),
        controllers={"oracle": KNOWING, "visit 1": LEARNING},
        paths={"oracle": (along,), "visit 1": (along,)},
        shown=ShownFlight(maps, along, along, along, np.zeros(1), over, over),
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


def test_flights_come_back_from_their_files(tmp_path):
    folder = RunFolder(tmp_path)
    folder.store("metrics", found({"x": "um"}))
    again = folder.load("metrics", AbstractNavigation)
    assert encode(again).document == encode(found({"x": "um"})).document


@pytest.mark.slow
def test_a_task_is_learned_from_no_data_to_a_report(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["navigate", "--learn-online", "vortex", "--seeds", "1"]
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        assert cli.run([*words, "--visits", "1", "--json", "--out", str(out)]) == 0
    rows = json.loads(capsys.readouterr().out)["controllers"]
    assert rows["oracle"]["success"]["value"] == 1.0
    assert rows["visit 1"]["success"]["value"] == 1.0
    assert rows["visit 1"]["regret"]["value"] < 1.4
    assert rows["visit 1"]["force_error"] < 0.15
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "data:image/gif;base64," in page
    for figure in ("belief", "bands", "paths", "regret"):
        assert (out / "figures" / f"learn-online-{figure}.svg").exists()


OWN = """
name = "own"
dimension = 2
order = 1
mobility = 0.5

[propulsion]
kind = "rolling-propulsion"
speed = 0.4

[[forces]]
kind = "constant-force"
force = [0.0, -0.8]

[[truth]]
kind = "gaussian-barrier"
height = 2.0
center = [5.0, 5.0]
width = 1.5

[starts]
kind = "uniform-starts"
lower = [0.0, 0.0]
upper = [9.0, 9.0]
count = 2

[times]
first = 0.0
last = 10.0
samples = 101
"""
"""A roller of mobility 1/2 that sinks, in a barrier of which it does not know."""


@pytest.mark.slow
def test_a_system_of_the_users_own_is_learned_with_what_it_knows(tmp_path, capsys):
    file, out = tmp_path / "own.toml", tmp_path / "out"
    file.write_text(OWN, encoding="utf-8")
    words = ["navigate", "--learn-online", str(file), "--seeds", "1"]
    words += ["--from=1,1", "--to=9,9", "--visits", "1", "--noise", "0.02", "--json"]
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        assert cli.run([*words, "--out", str(out)]) == 0
    rows = json.loads(capsys.readouterr().out)["controllers"]
    assert rows["visit 1"]["success"]["value"] == 1.0
    assert rows["visit 1"]["regret"]["value"] < 1.4
    assert rows["visit 1"]["force_error"] < 0.4
    assert rows["visit 1"]["cover"] > 0.8
    assert rows["visit 1"]["consistency"] < 2.0


def adaptive_of(name):
    return AdaptiveController.of(
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
