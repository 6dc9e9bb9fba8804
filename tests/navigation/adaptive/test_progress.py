"""A swimmer that gets nowhere notices and acts; each command must have a way out."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation.steering_worlds import frame_at, vortex

from pinav.dynamics import OverdampedSwimmer
from pinav.forces import GaussianBarrier, ZeroForce
from pinav.navigation import task
from pinav.navigation.adaptive import strategies
from pinav.navigation.adaptive.flight import fly
from pinav.navigation.adaptive.prior import with_truth
from pinav.navigation.adaptive.safety import choose_command
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.belief.given import BeliefPrior, GivenForce
from pinav.navigation.control.controller import Observation

PATIENCE = 6.0


def walk(places, time_to_go=lambda _: 9.0):
    """The progress after each of some places, a tenth apart in time."""
    first = np.array(places[0], float)
    steps = [strategies.Progress(1.0, first[None], 0.0, first, PATIENCE)]
    for k, place in enumerate(places[1:], 1):
        steps.append(steps[-1].after(0.1 * k, np.array(place, float), time_to_go))
    return steps


def test_who_moves_on_or_goes_back_out_of_a_dead_end_is_never_stalled():
    there = [(0.1 * k, 0.0) for k in range(150)]
    on = walk([(0.06 * k, 0.02 * k) for k in range(600)])
    back = walk(there + there[::-1], time_to_go=lambda state: state[0])
    for way in (on, back):
        assert not any(p.stalled or p.boldness for p in way)
    assert len(on[-1].places) < 40


ROUNDS = {
    "hovering": lambda s: (0.3 * np.sin(s), 0.3 * np.cos(s)),
    "to and fro": lambda s: (4 * np.sin(s), 0.0),
    "in a circle": lambda s: (3 * np.sin(s), 3 * np.cos(s)),
}


@pytest.mark.parametrize("move", ROUNDS.values(), ids=ROUNDS)
def test_who_comes_nowhere_new_is_stalled_and_becomes_bolder(move):
    places = [move(k / 10) for k in range(400)]
    way = walk(places)
    first = next(k for k, p in enumerate(way) if p.stalled)
    seen = [k for k in range(1, 400) if len(way[k].places) > len(way[k - 1].places)]
    last = max(seen, default=0)
    assert 0.1 * (first - last) == pytest.approx(PATIENCE)
    assert way[-1].boldness == int((39.9 - 0.1 * last + 1e-6) / PATIENCE)


def test_who_comes_nearer_now_and_then_is_stalled_all_the_same():
    places = [(4 * np.sin(k / 30), 0.0) for k in range(2000)]
    way = walk(places, time_to_go=lambda state: state[0])
    assert way[-1].boldness > 5


def test_a_new_place_ends_a_stall_and_the_boldness_stays():
    *_, held, free = walk([(0.0, 0.0)] * 130 + [(5.0, 0.0)])
    assert (held.stalled, held.boldness) == (True, 2)
    assert (free.stalled, free.boldness) == (False, 2)


@pytest.fixture(scope="module")
def still():
    """The vortex' task in water at rest."""
    swimmer = OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0)
    return AdaptiveController.of(vortex(swimmer), strategies.MEAN_FORCE, points=21)


def walled(adaptive):
    """Who believes in a counter-current of twice the thrust, of which nobody is sure.

    A fit that had data on the near side alone.
    """
    x, y = strategies.axes_of(adaptive.physics.table.grid)
    force = np.zeros((len(x), len(y), 2))
    force[(x > 4.5) & (x < 6.5), :, 0] = -2.0 * adaptive.thrust
    places = np.array([[1.0, 5.0], [2.0, 5.0]])
    prior = BeliefPrior(GivenForce.of((x, y), force), places, 1e-4 * np.eye(4))
    known = prior.lead(adaptive.believe(frame_at(1.0, 5.0)))
    return dataclasses.replace(adaptive, known=known)


def test_the_bold_take_nothing_from_what_is_known(still):
    oracle = with_truth(AdaptiveController.of(task("vortex"), points=13))
    belief = oracle.believe(frame_at(1.0, 5.0))
    certain, bold = (
        strategy.tables(belief, still.physics, still.thrust)
        for strategy in (strategies.MEAN_FORCE, strategies.ExplorationBonus(boldness=3))
    )
    np.testing.assert_allclose(bold.table.values, certain.table.values, atol=1e-12)
    np.testing.assert_allclose(bold.time_cost.spread.values, 0.0, atol=1e-9)


def test_each_stall_makes_a_doubtful_wall_lower_and_its_ground_cheaper(still):
    belief = walled(still).believe(frame_at(1.0, 5.0))
    place, heights, prices = jnp.array([5.5, 5.0]), [], []
    for boldness in (1, 2, 3, 9):
        tables = strategies.ExplorationBonus(boldness=boldness).tables(
            belief, still.physics, still.thrust
        )
        heights.append(-float(tables.table(0.0, place)[0]))
        prices.append(float(tables.time_cost.running_cost(0.0, place)))
    assert np.all(np.diff(heights[:3]) < 0)
    assert heights[-1] == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.diff(prices) < 0)
    assert prices[-1] > 0


@pytest.mark.slow
def test_a_goal_that_cannot_be_reached_ends_with_the_time_and_no_error():
    """On the top of a hill that no thrust climbs, once both ways round are known."""
    hill = GaussianBarrier(6.0, [9.0, 5.0], 1.5)
    truth = OverdampedSwimmer(ZeroForce(), hill, 1.0)
    adaptive = AdaptiveController.of(vortex(truth, time_limit=80.0), points=21)
    flight, _, _ = fly(adaptive, key=jax.random.key(1))
    assert not flight.reached
    assert not flight.violated
    assert flight.stalls > 0
    assert len(flight.path) == 801


@pytest.mark.slow
def test_who_is_held_plans_on_finer_cells_and_never_stops_planning(still):
    """Held at its place behind a wall that, as it believes, lets nobody through."""
    held, idle = walled(still), jnp.zeros((1, 2))
    state = held.task.start
    memory = held.start(Observation(jnp.asarray(0.0), state, idle))
    assert float(memory.plan.at(jnp.array([1.0, 5.0]))) > held.task.time_limit
    for k in range(1, 130):
        now = Observation(jnp.asarray(0.1 * k), state, idle)
        memory = held.learn(memory, now)
    assert memory.progress.stalled
    assert memory.progress.boldness == 2
    assert memory.lattice is held.detailed
    assert held.detailed.cell < 0.65 * held.replanner.cell
    assert np.all(np.isfinite(memory.plan.values))
    command, _ = held(now, memory, key=jax.random.key(0))
    assert np.all(np.isfinite(command))


@pytest.mark.parametrize(
    ("margins", "lead", "chosen"),
    [
        ([-0.1, 0.2, 5.0, 0.0], [9.0, 1.0, 0.5, 2.0], 3),
        ([-3.0, -1.0, -2.0], [9.0, 0.0, 9.0], 1),  # none is clear: lead is no matter
        ([-1.0, -1.0, -1.0], [0.0, 1.0, 2.0], 0),  # of equal ones the first
        ([1.0, 1.0, 1.0], [1.0, 1.0, 1.0], 0),
    ],
)
def test_of_the_clear_commands_the_one_that_leads_on_most_is_given(
    margins, lead, chosen
):
    assert choose_command(np.array(margins), np.array(lead)) == chosen
