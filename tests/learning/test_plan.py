"""The plan of a fit: which recipe suits the data, and what does not go together."""

import jax
import pytest

from pinav.errors import InputError
from pinav.learning.plan import plan_fit, suitable_recipe
from pinav.learning.recipes import Bayes, Curriculum, Langevin, Paper, Suited
from pinav.scenarios import scenario
from pinav.trajectories import simulate


@pytest.fixture(scope="module")
def paper():
    truth = scenario("paper")
    return truth, simulate(truth)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"train": ("drag", "damping")}, "takes the place of damping"),
        ({"recipe": Paper(), "train": ("drag",)}, "only the recipe bayes does"),
        ({"recipe": Langevin(), "train": ("gain",)}, "no constant but diffusion"),
        ({"recipe": Langevin(), "model": "ude"}, "expected a kernel model"),
        ({"recipe": Langevin()}, "expected a system without inertia"),
        ({"recipe": Bayes(), "model": "ude"}, "the model ude has no evidence"),
        ({"model": "nn-only", "train": ("gain",)}, "no physical constants"),
        ({"model": "physics-only"}, "there is nothing to fit; add --train damping"),
        ({"recipe": Bayes(noise=-1.0)}, "--noise: expected > 0, got -1.0"),
        ({"recipe": Bayes(budget=0.0)}, "--budget: expected > 0, got 0"),
        ({"recipe": Curriculum(0)}, "--max-steps: expected 1 to 1e.06, got 0"),
    ],
)
def test_what_does_not_go_together_is_refused(paper, options, message):
    with pytest.raises(InputError, match=message):
        plan_fit(*paper, **options)


LACKED = {
    "langevin": {"noise": 0.1, "structure": "free", "max_steps": 3, "budget": 9.0},
    "curriculum": {"noise": 0.1, "structure": "free", "budget": 9.0},
}


@pytest.mark.parametrize(
    ("recipe", "option"), [(name, option) for name in LACKED for option in LACKED[name]]
)
def test_an_option_that_the_suited_recipe_lacks_is_refused(recipe, option):
    asked, thermal = Suited(**{option: LACKED[recipe][option]}), recipe == "langevin"
    message = f"--{option.replace('_', '-')}: the recipe {recipe}, .* no such option"
    with pytest.raises(InputError, match=message):
        suitable_recipe(asked, "ude", scenario("brownian"), thermal=thermal)


def test_the_recipe_suits_model_and_data(paper):
    assert plan_fit(*paper).recipe == Bayes()
    assert plan_fit(*paper).is_open
    assert plan_fit(*paper, recipe=Suited(budget=9.0)).recipe == Bayes(budget=9.0)
    asked = Suited(max_steps=3)
    matched = plan_fit(*paper, model="ude", recipe=asked)
    assert matched.recipe == Curriculum(3)
    assert not matched.is_open
    bead = scenario("brownian", count=1)
    thermal = plan_fit(bead, simulate(bead, key=jax.random.key(0)))
    assert thermal.recipe == Langevin(observation="exact", diffusion="constant")
