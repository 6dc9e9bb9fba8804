"""`pinav design`: its words, and runs from end to end."""

import csv
import dataclasses
import json

import numpy as np
import pytest
from tests.samples import sample

from pinav.commands.design.job import sections
from pinav.navigation import Suggestion
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.motion import OverdampedMotion
from pinav.navigation.design.campaign import (
    Campaign,
    CampaignSummary,
    Decision,
    DesignResult,
)
from pinav.report import sections_text


def campaign(bounds, errors, accuracy=0.1):
    """A campaign of which only the decisions are known."""
    decisions = tuple(
        Decision(np.zeros((2, 2)), arrives=True, error=bound, true_error=error)
        for bound, error in zip(bounds, errors, strict=True)
    )
    paths = (np.zeros((2, 2)),) * (len(bounds) - 1)
    first = Frame(0.0, np.zeros(2), 0.1, np.zeros(2))
    motion, corner = OverdampedMotion(0.1), np.ones(2)
    belief = Belief.start(
        first, lower=-corner, upper=corner, motion=motion, thrust=1.0, scales=(2.0,)
    )
    return Campaign(accuracy, paths, decisions, belief)


def test_a_summary_counts_trajectories_and_what_was_right():
    right = campaign([1.0, 0.3, 0.09], [1.0, 0.08, 0.05])
    wrong = campaign([1.0, 0.5, 0.2, 0.09], [1.0, 0.4, 0.3, 0.2])
    given_up = campaign([1.0, 0.9, 0.8, 0.7, 0.6], [1.0, 0.9, 0.8, 0.7, 0.6])
    row = CampaignSummary.of([right, wrong, given_up])
    assert (row.campaigns, row.finished, row.right) == (3, 2, 1)
    assert (row.fewest, row.trajectories, row.largest) == (2, 3, 4)
    assert row.reached == np.inf
    assert row.error == pytest.approx(0.2)
    assert CampaignSummary.of([right]).reached == 1


NOTHING = Decision(np.zeros((3, 2)), arrives=True, error=0.3)


def words(decision=NOTHING, paths=None, **parts):
    parts |= {"decision": decision, "paths": paths or {}, "accuracy": 0.1}
    return sections_text(sections(sample(DesignResult, **parts)))


def test_the_words_compare_designs():
    done = CampaignSummary(4, 4, 6.0, 5, 8, 5.0, 4, 0.08)
    slow = CampaignSummary(4, 4, 15.0, 12, 18, 14.0, 4, 0.09)
    lost = CampaignSummary(4, 1, np.inf, 20, 24, np.inf, 1, 0.4)
    found = words(designs={"informed": done, "grid": slow, "random": lost})
    assert "took 40 % of the trajectories of the grid one" in found
    assert "Most random campaigns were given up." in found


def test_the_words_say_what_to_record_next():
    recorded = {"recorded": (np.zeros((2, 2)),) * 8}
    advice = sample(Suggestion, sd=0.1, sd_after=0.06, start=(1.0, 2.0))
    found = words(paths=recorded, next=advice)
    assert "After 8 trajectories the force" in found
    assert "known to 30 % with a probability of 95 %. Record next" in found
    assert "released at (1, 2)" in found
    assert "now 0.1, should then be 0.06" in found
    done = dataclasses.replace(NOTHING, error=0.08)
    assert "nothing further need be" in words(done, recorded, next=advice)
    lost = words(dataclasses.replace(NOTHING, arrives=False), recorded)
    assert "no plan reaches the goal" in lost
    assert "no candidate trajectory" in lost


@pytest.mark.slow
def test_designs_are_compared_and_recordings_are_continued(tmp_path, printed):
    ends = ("--from=1,5", "--to=9,5", "--tolerance", "0.5", "--thrust", "1.5")
    words = ("design", "shear", *ends, "--arena=0,0,10,10")
    few = ("--seeds", "1", "--most", "2", "--duration", "2", "--designs", "informed")
    found = json.loads(printed(*words, *few, "--json", "--out", tmp_path / "campaigns"))
    assert found["designs"]["informed"]["campaigns"] == 1
    assert (tmp_path / "campaigns" / "report.html").exists()

    data, out = tmp_path / "data.csv", tmp_path / "next"
    printed("simulate", "shear", "--out", data, "--noise", "0.02")
    said = printed(*words, "--data", data, "--out", out)
    assert "trajectories the force" in said
    with (out / "next.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["t", "frequency", "heading"]
    assert float(rows[-1]["t"]) == pytest.approx(5.0)
