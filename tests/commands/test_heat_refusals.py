"""`pinav heat`: bad cases, readings and options are refused before anything is done."""

import re

import pytest
from tests.heat_cases import GONE, PLANE, ball, change, refuse, write

from pinav.errors import FitError
from pinav.thermal.case import read_case
from pinav.thermal.setup import Setup
from pinav.thermal.tissue_fit import TissueFit

NAN, INF = float("nan"), float("inf")
SPACE = {
    "grid": {"kind": "box", "cells": [24] * 3, "size": 2e-3},
    "probes.points": [[0.02] * 3],
}
PARTICLES = {"heating": {"kind": "particles", "concentration": 5.0, "diameter": 14.0}}
MEASURED = {
    "heating": {
        "kind": "measured",
        "concentration": 5.0,
        "amplitudes": [1e4],
        "frequencies": [1e5],
        "slp": [[100.0]],
    }
}
BURSTS = {"field.on": 50.0, "field.off": 100.0}
FLOW = "tissue.perfusion"
LEARN = {"learn.noise": 0.1}
BEST = {"optimise.largest": 2e4}


def bad_numbers(key, *values, base=None, words=""):
    """One refusal for each value under a key, whose name the line holds."""
    name = key.split(".", 1)[-1] if "[" in key else key
    return [((base or {}) | {key: v}, words or re.escape(name)) for v in values]


CASES = [
    *bad_numbers("title", 3, GONE),
    *bad_numbers("colour", "red", words="unknown field `colour`"),
    # grid
    *bad_numbers("grid.kind", "torus", GONE, words="grid"),
    *bad_numbers(
        "grid.radius", 0.0, -0.05, NAN, INF, 10.01, "5 cm", GONE, words="radius"
    ),
    *bad_numbers("grid.cells", 2, 0, -5, 100_001, 24.5, words="grid.cells"),
    ({"grid": {"kind": "box", "cells": [24], "size": 1e-3}}, "two or three numbers"),
    ({"grid": {"kind": "box", "cells": [24] * 4, "size": 1e-3}}, "two or three"),
    ({"grid": {"kind": "box", "cells": [4000] * 3, "size": 1e-5}}, "memory of this"),
    *bad_numbers("grid.size", 0.0, -1e-3, NAN, 1e3, base=PLANE),
    # tissue
    *bad_numbers("tissue.conductivity", -1.0, 0.0, NAN, INF, 1001.0),
    *bad_numbers(
        "tissue.conductivity", GONE, words="expected a preset or conductivity"
    ),
    *bad_numbers("tissue.density", 49.9, NAN, 30_001.0, GONE, words="density"),
    *bad_numbers("tissue.specific_heat", 9.9, 50_001.0, NAN, GONE, words="specific_h"),
    *bad_numbers("tissue.metabolic", -0.1, NAN, 1.01e7),
    *bad_numbers("tissue.preset", "bone", words="tissue preset 'bone' is unknown"),
    *bad_numbers("tissue.colour", 1, words="tissue: .*unknown field `colour`"),
    *bad_numbers(FLOW, {}, {"value": 0.5}, {"unit": "1/s"}, words="expected a law, or"),
    *bad_numbers(FLOW, {"law": "fat", "unit": "1/s"}, words="expected a law, or"),
    *bad_numbers(FLOW, {"law": "bone"}, words="no perfusion law for 'bone'"),
    *bad_numbers(FLOW, {"value": 0.5, "unit": "1/s"}, words="check the unit"),
    *bad_numbers(FLOW, {"value": 1.0, "unit": "l/s"}, words="unit 'l/s' is unknown"),
    *bad_numbers(FLOW, {"value": -1.0, "unit": "kg/m3/s"}, words="perfusion.value"),
    *bad_numbers(FLOW, {"value": NAN, "unit": "kg/m3/s"}, words="perfusion.value"),
    *bad_numbers(
        FLOW,
        {"temperatures": [37, 42, 42.01], "values": [1, 2, 3], "unit": "kg/m3/s"},
        {"temperatures": [42, 37], "values": [1, 2], "unit": "kg/m3/s"},
        words="a law that jumps has no derivative",
    ),
    *bad_numbers(
        FLOW,
        {"temperatures": [37, 42], "values": [1], "unit": "kg/m3/s"},
        {"temperatures": [37], "values": [1], "unit": "kg/m3/s"},
        words="expected one for each of two temperatures",
    ),
    *bad_numbers(FLOW, {"temperatures": [37], "values": [1]}, words="expected a law"),
    *bad_numbers(
        FLOW,
        {"temperatures": [310, 315], "values": [1, 2], "unit": "kg/m3/s"},
        words="temperatures",
    ),
    *bad_numbers(
        FLOW,
        {"temperatures": [37, 42], "values": [1, 2], "unit": "1/s"},
        words="check the unit",
    ),
    *bad_numbers(
        "damage",
        {},
        {"law": "skin", "energy": 6e5},
        words="damage: expected the keys log_factor and energy; .* law, one of skin",
    ),
    *bad_numbers("damage", {"law": "bone"}, {"log_factor": 1.0}, words="damage"),
    *bad_numbers("damage.energy", 9.9e3, 2.1e6, NAN, base={"damage.log_factor": 100.0}),
    # tumour
    *bad_numbers("tumour.radius", 0.0, -0.01, NAN, 0.06, 1e-4, GONE, words="radius"),
    *bad_numbers("tumour.center", [0.01], words="expected none on a sphere"),
    *bad_numbers("tumour.center", [0.02], [0.1, 0.02], [NAN, 0.02], base=PLANE),
    *bad_numbers("tumour.radius", 0.03, base=PLANE),
    *bad_numbers("tumour.center", [0.004, 0.02], base=PLANE, words="within the grid"),
    *bad_numbers("tumour.center", [0.02, 0.02], base=SPACE),
    *bad_numbers("tumour.tissue", GONE, words="tissue"),
    # heating
    *bad_numbers("heating.kind", "laser", words="heating"),
    *bad_numbers("heating.density", -1.0, NAN, INF, 1.1e10),
    *bad_numbers("heating.reference", 0.0, -1e4, NAN, 1.1e6),
    *bad_numbers("heating.width", 0.0, NAN, 10.1),
    ({"heating.width": 0.01, "heating.edge_weighted": True}, "width or edge_weighted"),
    *bad_numbers("heating.diameter", 1.4e-8, 0.9, NAN, 1001.0, base=PARTICLES),
    *bad_numbers("heating.concentration", -0.1, NAN, 5181.0, base=PARTICLES),
    *bad_numbers("heating.spread", 0.0, -0.2, 1.01, base=PARTICLES),
    *bad_numbers("heating.scale", -0.1, 100.1, NAN, base=PARTICLES),
    # field
    *bad_numbers("field.frequency", 0.0, 999.0, NAN, 1.1e9),
    *bad_numbers("field.times", [0.0], [], [10.0, 20.0], [0.0, -5.0]),
    *bad_numbers("field.times", [0.0, 9.0, 9.0], [0.0, NAN], [0.0, INF]),
    *bad_numbers("field.times", [0.0, 1e-9, 1800.0], [0.0, 1e9], [0, "1 h"]),
    *bad_numbers("field.amplitudes", [NAN], [-0.1], [1.1e6], [1e4] * 3, []),
    *bad_numbers("field.on", 5.0, words="expected on and off together"),
    *bad_numbers("field.off", 0.0, NAN, base=BURSTS),
    *bad_numbers(
        "field.on", 1e-4, base=BURSTS | {"field.off": 1e-4}, words="intervals"
    ),
    # sides, blood, eddy currents, limit, step
    *bad_numbers("blood.arterial", NAN, 45.1, 9.9, -37.0),
    *bad_numbers("wall.temperature", NAN, 100.1, -50.1),
    (
        {"wall": {"temperature": 20.0, "exchange": 5.0, "ambient": 20.0}},
        "got temperature, ex",
    ),
    *bad_numbers(
        "wall",
        {"exchange": 5.0},
        {"ambient": 20.0},
        words="wall: expected the keys temperature, or exchange and ambient",
    ),
    *bad_numbers("wall.exchange", 1.1e6, 0.0, NAN, base={"wall": {"ambient": 20.0}}),
    *bad_numbers("wall.ambient", 293.15, NAN, base={"wall": {"exchange": 20.0}}),
    *bad_numbers("blood.density", 1.05, NAN),
    *bad_numbers("arterial", 37.0, words="unknown field `arterial`"),
    *bad_numbers("wall", "cold", {"temperature": 20.0, "colour": 1}, words="wall"),
    *bad_numbers("sides.x", "periodic", words="sides.x: expected no sides but"),
    *bad_numbers("sides.z", {"low": "insulated"}, base=PLANE),
    *bad_numbers("sides.w", {}, words="sides"),
    *bad_numbers("sides.x", {"low": "periodic"}, "closed", base=PLANE),
    *bad_numbers("sides.x.low.temperature", 300.0, NAN, base=PLANE),
    ({"start": "hot"}, "start"),
    *bad_numbers("start.file", "no.npz", ".", words="cannot be read"),
    ({"start": "steady", "field.ramp": [0, 1e4]}, "ramp: expected no amplitudes"),
    *bad_numbers("field.ramp", [1e4], [0, NAN], base={"field.amplitudes": GONE}),
    ({"heating.center": [0.0]}, "heating.center: expected a width with it"),
    *bad_numbers("heating.anisotropy", 0.09, 1001.0, NAN, base=PARTICLES),
    *bad_numbers("heating.magnetisation", 2001.0, 0.9, base=PARTICLES),
    *bad_numbers("heating.viscosity", 1e-3, 0.0, base=PARTICLES),
    *bad_numbers("heating.coating", -0.1, 1001.0, base=PARTICLES),
    *bad_numbers("heating.attempt_time", 1.1e-7, 9e-14, base=PARTICLES),
    *bad_numbers("heating.slp", [[1.0], [2.0]], [1.0], [[-1.0]], base=MEASURED),
    *bad_numbers("heating.amplitudes", [0.0], [NAN], [], base=MEASURED),
    *bad_numbers("heating.frequencies", [2e5, 1e5], base=MEASURED),
    ({"eddy": {"conductivity": 0.4}}, "expected a cylinder or a box"),
    (
        {"eddy": {"conductivity": 0.4, "radius": 0.1, "axis": [0, 0]}},
        "eddy: expected a radius or an axis, got both",
    ),
    *bad_numbers("eddy.radius", 0.0, NAN, base={"eddy": {"conductivity": 0.4}}),
    *bad_numbers("eddy.conductivity", 0.0, 100.1, base={"eddy": {"radius": 0.1}}),
    *bad_numbers("limit", "ieee", words="limit.*ieee"),
    *bad_numbers("limit", "atkinson-brezovich", words="exceeds the Atkinson-Brezovich"),
    *bad_numbers("step", 0.0, -5.0, NAN),
    *bad_numbers("step", 1e-4, words="at most 1,000,000 time steps"),
    # probes
    *bad_numbers("probes.points", [[0.2]], [[-0.01]], [[NAN]], [[0.01, 0.02]], ["a"]),
    *bad_numbers(
        "probes.points", [[0.01], [0.01]], words="points: .* different places"
    ),
    *bad_numbers("probes.every", 0.0, NAN, 3600.0),
    *bad_numbers("probes.every", 1e-4, words="at most 1,000,000 time steps"),
]
TASKS = [
    *(("learn", *row) for row in bad_numbers("learn.noise", -0.1, NAN, 100.1)),
    *(("learn", *row) for row in bad_numbers("learn.seed", -1, 2**32, 1.5)),
    *(("learn", *row) for row in bad_numbers("learn.kind", "forest")),
    *(("learn", *row) for row in bad_numbers("learn.held_out", [0.0], [NAN], [-1.0])),
    ("learn", {"learn.laws": []}, "expected something to learn"),
    ("learn", {"learn.laws": ["bone"]}, "learn.laws"),
    ("learn", {"learn.laws": ["tissue"] * 2}, "laws: expected each once"),
    ("learn", LEARN | {"probes": GONE}, "learn: expected data, a CSV file, or probes"),
    (
        "learn",
        LEARN | {"field.amplitudes": [0.0]},
        "field.amplitudes: expected one > 0",
    ),
    (
        "learn",
        LEARN | {FLOW: {"value": 0.0, "unit": "1/s"}},
        "perfusion of the tissue: expected > 0",
    ),
    ("learn", {"learn.data": "no.csv"}, "no.csv: cannot read"),
    ("learn", {"learn.data": "."}, "expected a table"),
    (
        "learn",
        {"learn.data": "a.csv", "learn.held_out": [1.3]},
        "held_out: expected no",
    ),
    ("optimise", {}, r"expected a table \[optimise\]"),
    *(("optimise", *r) for r in bad_numbers("optimise.largest", NAN, 0.0, 1.1e6)),
    *(
        ("optimise", BEST | c, m)
        for c, m in bad_numbers("optimise.start", 0.0, 1.01, NAN)
    ),
    ("optimise", BEST | {"optimise.max_temperature": 36.0}, "above the arterial"),
    (
        "optimise",
        BEST | {"optimise.max_temperature": 320.15},
        "optimise.max_temperature",
    ),
    ("optimise", BEST | {"optimise.healthy_dose": 0.0}, "optimise.healthy_dose"),
    ("optimise", BEST | {"optimise.margin": -1.0}, "optimise.margin"),
    ("optimise", BEST | {"optimise.placement": 1}, "optimise.placement"),
]
READINGS = [
    ("\ufefft;r;T\n10;0;37\n20;0;37.2\n", "more readings than the 2 numbers"),
    ("t [min],r,T\n10,0,37.5\n", r"expected the columns .*, got t \[min\]"),
    ("t,r,T\n10,0,37,5\n", "line 2: expected 3 cells, .*, got 4"),
    ("\ufefft,r,T\n10,0,37\n20,0,37.2\n", "more readings than the 2 numbers"),
    ("", "the file is empty"),
    ("t,r,T\n", "the header is all there is"),
    ("time,r,T\n1,0,37\n", "expected the columns"),
    ("t,x,y,T\n1,0,0,37\n2,0,0,37.5\n", "1 coordinates .*t, r, T"),
    ("t,r,T\n1,0\n", "line 2: expected 3 cells, .*, got 2"),
    ("t,r,T\n1,0,warm\n", "line 2, column 'T': expected a finite number, got 'warm'"),
    ("t,r,T\n1,0,310.15\n", "temperatures in °C, which are kelvins less"),
    ("t,r,T\n1,0,37\n1,0,38\n", "one reading for each time and place"),
    ("t,r,T\n0,0,37\n1,0,37\n", "row 2: expected times > 0 s"),
    ("t,r,T\n-5,0,37\n", "row 2: expected times > 0 s"),
    ("t,r,T\nnan,0,37\n", "line 2, column 't': expected a finite"),
    ("t,r,T\n1,inf,37\n", "line 2, column 'r': expected a finite"),
    ("t,r,T\n1,0,inf\n", "line 2, column 'T': expected a finite"),
    ("t,r,T\n1,0,\n", "expected a reading, got empty cells"),
    ("t,r,T\n1,0.2,37\n", "probe at 0.2 m: expected between"),
    ("t,r,T\n1,-0.1,37\n", "probe at -0.1 m: expected between"),
    ("t,r,T\n5000,0,37\n", "saved time 5000 s: expected after"),
]
FILES = [
    (b"", "title"),
    (b"\xff\xfe\x00", "cannot be read"),
    (b"title = ", "cannot be read"),
    (b"title = 1979-05-27", "title"),
    (b"grid = []", "grid"),
    (b"[field]\n[field]", "cannot be read"),
]


def name_of(value):
    return str(value)[:50] if isinstance(value, dict) else None


@pytest.mark.parametrize(
    ("task", "changes", "message"),
    [*(("simulate", *row) for row in CASES), *TASKS],
    ids=name_of,
)
def test_bad_cases(tmp_path, capsys, task, changes, message):
    refuse(capsys, task, write(tmp_path, change(ball(), changes)), message)


@pytest.mark.parametrize(("text", "message"), READINGS)
def test_bad_readings(tmp_path, capsys, text, message):
    content = change(ball(), {"learn.data": "readings.csv"})
    files = {"readings.csv": text.encode()}
    refuse(capsys, "learn", write(tmp_path, content, files), message)


@pytest.mark.parametrize(("content", "message"), FILES)
def test_bad_files(tmp_path, capsys, content, message):
    path = tmp_path / "case.toml"
    path.write_bytes(content)
    refuse(capsys, "simulate", path, message)


def test_a_fit_that_stalls_says_what_can_be_changed_in_the_case(tmp_path, monkeypatch):
    def stall(*_, **__):
        raise FitError("raise max_iterations, or pass throw=False", "stalled")

    monkeypatch.setattr("pinav.thermal.tissue_fit.learn", stall)
    path = write(tmp_path, change(ball(), {"learn.kind": "constant"}))
    case, _ = read_case(path)
    setup = Setup.of(case, tmp_path)
    task = TissueFit.of(case, setup, tmp_path)
    with pytest.raises(FitError, match=r"learn fewer numbers .* under \[learn\]"):
        task.learn(setup.readings())
