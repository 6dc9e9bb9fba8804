"""Sentences and tables tell the numbers of a result, in the units that they name."""

import dataclasses
import math

import numpy as np
import pytest
from tests.samples import sample, stand_in

from pinav.analysis.discovery.force_sample import CentralTest
from pinav.commands.compare import job as compare
from pinav.commands.design import job as design
from pinav.commands.discover import job as discover
from pinav.commands.fit import job as fit
from pinav.commands.navigate import sections as navigate
from pinav.fitting.evidence.model_evidence import DECISIVE, ModelEvidence
from pinav.navigation.adaptive.flight import FlightOutcome
from pinav.navigation.comparison import (
    ComputingTimes,
    Navigation,
    OnlineNavigation,
    PlannedWay,
)
from pinav.navigation.design.campaign import CampaignSummary, Decision, DesignResult
from pinav.navigation.design.candidates import Suggestion
from pinav.navigation.trials.metrics import Interval, Quantiles, Summary

UNITS = {"x": "um", "t": "s"}


def column(table, name):
    return [row[list(table.header).index(name)] for row in table.rows]


def test_intervals_are_told_from_below_to_above():
    interval = Interval(0.5, 0.25, 0.75)
    assert navigate.percent_interval(interval) == "50 % (25–75)"
    assert navigate.ratio_interval(interval) == "0.500 (0.250–0.750)"
    endless = Interval(1.0, 0.5, math.inf)
    assert navigate.ratio_interval(endless) == "1.000 (0.500–∞)"


SUMMARY = Summary(
    runs=8,
    success=Interval(0.5, 0.2, 0.8),
    violation=Interval(0.1, 0.0, 0.3),
    arrival=Quantiles(1.0, 2.0, 3.0),
    efficiency=0.9,
    tracking=0.1,
    tracking_rms=0.2,
    clearance=0.4,
    effort=1.0,
    turning=0.1,
)


def test_a_navigation_tells_its_plan_and_its_runs():
    plan = stand_in(PlannedWay, time=7.5, unreachable=0.25)
    suggestion = stand_in(Suggestion, sd=0.4, sd_after=0.1, sd_after_random=0.3)
    result = stand_in(
        Navigation,
        plan=plan,
        computing=ComputingTimes(1.5, 0.002),
        units=UNITS | {"order": "1"},
        truth=None,
        delay=0.3,
        refused={"straight": "no way"},
        suggestion=suggestion,
    )
    text = " ".join(navigate.sentences(result))
    for words in (
        "The plan takes 7.50 s",
        "from 25 % of the arena",
        "takes 2 ms, the first one 1.5 s",
        "Commands act after 0.300 s",
        "straight: no way",
        "drawn from the posterior",
        "from 0.40 um s⁻¹ to 0.10 um s⁻¹, a random one to 0.30 um s⁻¹",
    ):
        assert words in text, words
    whole = stand_in(PlannedWay, time=7.5, unreachable=0.0)
    known = dataclasses.replace(
        sample(Navigation), plan=whole, truth="barrier-crossings"
    )
    text = " ".join(navigate.sentences(known))
    assert "from everywhere in the arena the goal can be reached in time." in text
    assert "the true environment of barrier-crossings (synthetic)" in text
    table = navigate.controller_table(
        {"learned": SUMMARY}, {"learned": Interval(1.1, 1.0, math.inf)}
    )
    (row,) = table.rows
    assert list(row) == [
        "learned",
        "50 % (20–80)",
        "10 % (0–30)",
        2.0,
        "1.100 (1.000–∞)",
        0.9,
        0.4,
    ]


def test_flights_are_told_in_milliseconds_and_megabytes():
    flight = stand_in(
        FlightOutcome,
        runs=4,
        success=Interval(0.5, 0.2, 0.8),
        in_time=Interval(0.25, 0.1, 0.6),
        violation=Interval(0.0, 0.0, 0.4),
        arrival=Quantiles(1.0, 2.0, 3.0),
        regret=None,
        clearance=0.4,
        force_error=0.1,
        cover=0.9,
        consistency=1.1,
        changed=2.0,
        frame_time=0.003,
        command_time=0.004,
        replan_time=math.nan,
        memory=5e6,
    )
    result = stand_in(
        OnlineNavigation,
        controllers={"oracle": flight, "visit 1": flight},
        units=UNITS,
        prior=False,
        task="fibres",
        position_noise=0.02,
        delay=0.1,
        time_limit=30.0,
        own_limit=20.0,
    )
    text = " ".join(navigate.online_sentences(result))
    for words in (
        "at most 3 ms (99 %), a command 4 ms, a plan 0 ms",
        "5 MB",
        "changed 2 commands",
        "nothing is known",
        "an error of 0.0200 um",
        "after 0.100 s",
        "up after 30.0 s",
        "own limit is 20.0 s",
    ):
        assert words in text, words
    table = navigate.online_table({"visit 1": flight}, UNITS)
    (row,) = table.rows
    assert list(row)[1:8] == [
        "50 % (20–80)",
        "25 % (10–60)",
        "0 % (0–40)",
        2.0,
        1.0,
        3.0,
        None,
    ]


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (DECISIVE + 0.1, "supported, by"),
        (DECISIVE - 0.1, "+4.90 nats, which is not decisive"),
        (-DECISIVE + 0.1, "−4.90 nats, which is not decisive"),
        (-DECISIVE - 0.1, "−5.10 nats, against it"),
    ],
)
def test_support_is_told_by_nats_on_both_sides(gain, words):
    assert words in fit.support_sentence(gain)


def test_models_are_compared_by_nats():
    def model(evidence, outcome="converged"):
        return compare.ComparedModel(outcome, ModelEvidence(evidence + 1.5, 1.5))

    models = {
        "physics-only": model(10.0),
        "kernel-potential": model(10.0 + DECISIVE),
        "kernel-force": model(9.0 + DECISIVE, "stalled"),
    }
    first, second = compare.verdicts(models)
    assert first.difference == DECISIVE
    assert (
        "prefers an environment to no environment by 5.0 nats: decisive" in first.text
    )
    assert (
        "prefers a potential to a free force by 1.0 nats: not decisive" in second.text
    )
    assert "Caution: the fit of kernel-force stalled" in second.text
    table = compare.table(compare.Comparison(models, (first, second)))
    assert column(table, "model") == [
        "kernel-potential",
        "kernel-force",
        "physics-only",
    ]
    assert column(table, "Δ log evidence [nats]") == ["0.0", "1.0", "5.0"]


def test_a_force_is_central_up_to_each_limit_alone():
    test = CentralTest((1.0, 2.0), (0.1, 0.2), 0.05, 0.04, 0.5, 3.0)
    assert "centre (1 ± 0.1, 2 ± 0.2)" in discover.central_sentence(test)
    for change, verdict in (
        ({"p_value": 0.0099}, "not central"),
        ({"p_value": 0.0101}, "central"),
        ({"noise_ratio": 0.31}, "not identifiable"),
        ({"center_sd": (0.1, 3.1)}, "not identifiable"),
    ):
        assert dataclasses.replace(test, **change).verdict.value == verdict


def test_a_design_tells_what_was_saved_and_what_comes_next():
    def campaign(trajectories):
        return CampaignSummary(4, 3, trajectories, 2, 9, 5.0, 2, 0.08)

    designs = {
        "informed": campaign(6.0),
        "random": campaign(12.0),
        "grid": campaign(math.inf),
    }
    result = stand_in(
        DesignResult, paths={}, system="fibres", accuracy=0.1, designs=designs
    )
    lines = design.sentences(result)
    assert "known to 10 % with a probability" in lines[0]
    assert "took 50 % of the trajectories of the random one" in lines[1]
    assert lines[2] == "Most grid campaigns were given up."
    table = design.design_table(result)
    assert column(table, "trajectories") == [6.0, 12.0, None]
    assert tuple(table.rows[0]) == ("informed", 4, 3, 6.0, 2, 9, 5.0, 2, 0.08)
    way = np.zeros((2, 2))
    advice = stand_in(Suggestion, start=(1.0, 2.0), sd=0.5, sd_after=0.2)
    for error, arrives, words in (
        (0.1, True, "known to 10 % with a probability of 95 %; nothing further"),
        (0.11, True, "known to 11 %"),
        (0.05, False, "no plan reaches the goal"),
    ):
        known = stand_in(
            DesignResult,
            paths={"recorded": (way, way)},
            next=advice,
            accuracy=0.1,
            decision=Decision(way, arrives, error),
        )
        (line,) = design.sentences(known)
        assert words in line
        assert "After 2 trajectories" in line
        assert ("nothing further" in line) == (error == 0.1)
        if error != 0.1:
            assert "(1, 2)" in line
            assert "now 0.5, should then be 0.2" in line
            none = stand_in(DesignResult, **vars(known) | {"next": None})
            assert "no candidate trajectory" in design.sentences(none)[0]
