"""The bars of navigation, by the benchmark of that name: 5 fits, 20 seeds, a task."""

import json

import jax
import pytest
from validation.conftest import program
from validation.zermelo import quickest_of_task

from pinav.navigation.task.catalogue import task


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results of a task, by its name; one folder, so that fits are shared."""
    out, known = tmp_path_factory.mktemp("navigate") / "bench", {}

    def made(name):
        if name not in known:
            done = program("benchmarks", "navigate", "--tasks", name, "--out", str(out))
            assert done.returncode == 0, done.stderr
            print(done.stdout)
            known[name] = json.loads((out / f"task-{name}.json").read_text())
        return known[name]

    return made


def success(result, controller):
    return result["controllers"][controller]["success"]["value"]


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("barrier-weak", 0.95, 1.10), ("many-barriers", 0.9, 1.15)],
)
def test_the_learned_model_arrives_nearly_as_soon_as_the_truth(
    name, least, most, results
):
    found = results(name)
    assert found["controllers"]["learned"]["runs"] == 100
    assert success(found, "learned") >= least
    assert found["regret"]["learned"]["value"] <= most


def test_physics_alone_arrives_less_often_at_the_barrier(results):
    found = results("barrier-weak")
    assert success(found, "physics only") < success(found, "learned")


@pytest.mark.parametrize("name", ["shear", "vortex"])
def test_currents_are_crossed_nearly_as_soon_as_can_be(name, results):
    with jax.enable_x64(new_val=True):
        best = float(quickest_of_task(task(name)).time)
    arrival = results(name)["controllers"]["learned"]["arrival"]["median"]
    print(name, "median arrival", arrival, "optimal control", best)
    assert arrival <= 1.05 * best


@pytest.mark.parametrize("name", ["follow-line", "follow-circle", "follow-eight"])
def test_what_was_learned_cuts_the_tracking_error_to_a_third(name, results):
    found = results(name)["controllers"]
    assert found["learned"]["tracking"] <= found["physics only"]["tracking"] / 3


def test_nobody_who_knows_the_truth_enters_a_zone(results):
    found = results("keep-out")["controllers"]
    assert found["oracle"]["runs"] == 100
    assert found["oracle"]["violation"]["value"] == 0
    print("violations with the learned model:", found["learned"]["violation"])


def test_a_control_step_is_quick(results):
    step = results("barrier-weak")["step"]
    assert step["median"] <= 0.025
    assert step["first"] <= 6.0
