"""Bad system files: one line each that names the file, the key and a remedy."""

import re

import pytest
from tests.defects import defects, told

from pinav.scenarios import find_system
from pinav.systems import read_system

GOOD = """
dimension = 2
order = 2
drag = 0.36
[units]
length = "um"
time = "s"
[propulsion]
kind = "constant-force"
force = [0.1, 0.0]
[observation]
noise = 0.02
[learn]
"drag.damping" = { kind = "normal", mean = 0.3, deviation = 0.1 }
[truth]
kind = "gaussian-barrier"
height = 5.25
center = [5.0, 5.0]
width = 2.9
[starts]
states = [[0.0, 0.0, 1.0, 1.0]]
[times]
last = 1.0
samples = 11
"""
THERMAL = """
dimension = 2
order = 1
mobility = 2.0
[units]
length = "um"
time = "s"
force = "pN"
[thermal]
energy = 0.004
"""


def swap(old, new):
    assert old in GOOD
    return GOOD.replace(old, new)


def warm(old, new):
    assert old in THERMAL
    return THERMAL.replace(old, new)


EDITS = {
    "order = 2": {
        "order = 2\norder = 2": "not TOML: Cannot overwrite",
        "order = 3": "order: expected 1 or 2, got 3",
        "order = true": "order: expected a whole number, got True",
        "order = 1": "drag: a system of order 1 has mobility",
    },
    "dimension = 2\n": {"": "dimension: this key is missing"},
    "order = 2\n": {"": "order: this key is missing"},
    "dimension = 2": {
        "dimension = 4": "dimension: expected 1 or 2 or 3, got 4",
        'dimension = "2"': "dimension: expected a whole number, got '2'",
        "dimension = 2.5": "dimension: expected a whole number, got 2.5",
    },
    "drag =": {
        "drga =": "drga: this key is unknown; .* did you mean 'drag'",
        "mobility =": "mobility: a system of order 2 has drag",
    },
    "drag = 0.36\n": {"": "drag: this key is missing; state the drag"},
    "0.36": {
        "-0.36": "drag: expected 0 or more, got -0.36",
        "nan": "drag: expected a finite number, got nan",
        '"0.36"': "drag: expected a number, got '0.36'",
    },
    '"um"': {'"parsec"': "units: units.length: expected one of 1, nm, um"},
    '"s"': {'"Hz"': "units: units.time: expected one of 1, us, ms, s"},
    '[units]\nlength = "um"\ntime = "s"': {'units = "um"': "units: expected a table"},
    "length =": {"lenght =": "units.lenght: this key is unknown; .* 'length'"},
    '"gaussian-barrier"': {
        '"gausian-barrier"': "truth.kind: .* did you mean 'gaussian-barrier'",
        '"shear-flow"': "truth.kind: expected one of",
        '"gone.py:Hill"': "gone.py: there is no such file",
    },
    'kind = "gaussian-barrier"\n': {"": "truth.kind: expected one of .* got nothing"},
    "width = 2.9\n": {"": "truth.width: this key is missing"},
    "width = 2.9": {
        "width = 2.9\nsigma = 1": "truth.sigma: this key is unknown",
        "width = -2.9": "truth: GaussianBarrier.width: expected > 0, got -2.9",
    },
    "center = [5.0, 5.0]": {
        "center = [5.0, 5.0, 5.0]": "truth.center: expected 2 numbers",
        "center = [5.0]": "truth.center: expected 2 numbers",
        'center = ["a", "b"]': "truth.center: expected finite numbers",
        "center = [[5.0], 5.0]": "truth.center: expected rows of equal",
    },
    "noise = 0.02": {
        "noise = -1.0": "observation: Observation.noise: expected 0 or more, got -1.0",
        "noise = inf": "observation.noise: expected a finite number",
    },
    '"drag.damping"': {
        '"drag.dumping"': "learn: 'drag.dumping' is not in the swimmer",
        '"known_force.terms[7].stiffness"': (
            r"learn: 'known_force.terms\[7\].stiffness' is not in the swimmer"
        ),
    },
    'kind = "normal"': {
        'kind = "beta"': "learn.'drag.damping'.kind: expected one of flat"
    },
    "deviation = 0.1": {
        "deviation = 0.0": "learn.'drag.damping': Normal.deviation: expected > 0"
    },
    "1.0, 1.0]]": {
        "1.0]]": "system.starts: expected 4 numbers a start",
        "1.0], [1]]": "starts.states: expected rows of equal length",
    },
    "states = [[0.0, 0.0, 1.0, 1.0]]": {
        "count = 3": "starts: expected a table with states",
        'kind = "rings"': "starts.kind: .* did you mean",
        'kind = "uniform-starts"\nlower = [1, 1]\nupper = [0, 2]': (
            "starts: .*expected upper beyond lower"
        ),
    },
    "last = 1.0": {"last = -1.0": "times: expected two or more increasing times"},
    "samples = 11": {
        "samples = 11\nstep = 0.1": "times: expected either samples or step",
        "step = 1e-9": "times: expected 2 to 10000000 samples",
    },
    "last = 1.0\nsamples = 11": {"values = 3": "times.values: expected a list"},
}
"""What of a good file becomes what, and what is said then."""
BAD = [
    *(
        (swap(old, new), message)
        for old, changes in EDITS.items()
        for new, message in changes.items()
    ),
    ("dimension = ", "not TOML: Invalid value"),
    (GOOD + "[flows]\n", "flows: this key is unknown; .* did you mean 'flow'"),
    (
        swap("dimension = 2", "dimension = 3")
        .replace("[0.1, 0.0]", "[0.1, 0, 0]")
        .replace("gaussian-barrier", "gaussian-swirl")
        .replace("height", "strength")
        .replace("[5.0, 5.0]", "[5.0, 5.0, 5.0]"),
        "truth.center: expected 2 numbers",
    ),
    (
        warm("dimension = 2", "dimension = 3")
        + '[flow]\nkind = "shear-flow"\nrate = 1.0\n',
        "flow: expected 3 components, as dimension = 3 says",
    ),
    (
        GOOD + '[unknown]\nmodel = "kernels"\n',
        "unknown.model: expected one of .* got 'kernels'",
    ),
    (GOOD + "[unknown]\ndecays = 3\n", "unknown.decays: expected"),
    (GOOD + "[unknown]\nwidth = 3\n", "unknown.width: this key is unknown"),
    (GOOD + "[[forces]]\nforce = [0.0, 1.0]\n", r"forces\[0\].kind: expected one of"),
    (
        GOOD + "[thermal]\ntemperature = 300.0\n",
        "thermal: thermal noise needs order = 1",
    ),
    (warm("0.004", "-0.004"), "thermal.energy: expected 0 or more, got -0.004"),
    (THERMAL + "diffusion = 1.0\n", "thermal.diffusion: energy says it already"),
    (
        warm('"um"', '"mm"').replace("energy", "temperature"),
        "thermal.temperature: expected the units um, s and pN",
    ),
    (
        warm('"pN"', '"nN"').replace("energy", "temperature"),
        "thermal.temperature: expected the units um, s and pN, got um, s and nN",
    ),
    (
        warm("mobility = 2.0\n", "") + "radius = 1.0\n",
        "thermal.viscosity: expected > 0",
    ),
    (
        THERMAL + "radius = 1.0\nviscosity = 0.89\n",
        "mobility: thermal.radius and thermal.viscosity",
    ),
    (warm("mobility = 2.0", "mobility = 0"), "mobility: expected > 0, got 0"),
    (
        warm("mobility = 2.0", 'mobility = {kind = "isotropic-tensor", value = -1.0}'),
        "mobility: IsotropicTensor.value: expected > 0, got -1.0",
    ),
    (
        THERMAL + "[wandering]\nstill = 0.1\ndriven = 1.0\n",
        "wandering.memory: this key is missing",
    ),
    (
        GOOD + "[wandering]\nstill = 0.1\ndriven = 1.0\nmemory = 1.0\n",
        "system.wandering: expected a swimmer without inertia",
    ),
]


@defects("text, message", BAD)
def test_a_bad_file_is_told_in_one_line(text, message, tmp_path):
    path = tmp_path / "my.toml"
    path.write_text(text)
    with told(message) as caught:
        read_system(path)
    said = str(caught.value)
    assert said.startswith(str(path))
    assert len(said.removeprefix(str(path))) < 900


@pytest.mark.parametrize("text", [GOOD, THERMAL], ids=["order 2", "order 1"])
def test_the_files_that_are_damaged_above_are_good(text, tmp_path):
    (tmp_path / "my.toml").write_text(text)
    assert read_system(tmp_path / "my.toml").name == "my"


PYTHON = [
    ("1 / 0", "line 1: ZeroDivisionError: division by zero; correct it"),
    ("x = (", "line 1: SyntaxError"),
    ("import sys\nsys.exit(3)", "line 2: SystemExit: 3"),
    ("other = 1", "defines no 'system'; choose one of other"),
    ("system = 3", "expected a System, or a function .* got a int"),
    ("def system():\n    raise KeyError('k')", "KeyError: 'k'; the function"),
    ("def system(n):\n    return n", "TypeError: .* missing 1 required"),
    ("def system():\n    return None", "expected a System, .* got a NoneType"),
]


@defects("text, message", PYTHON)
def test_a_bad_python_file_is_told_in_one_line(text, message, tmp_path):
    (tmp_path / "own.py").write_text(text)
    with told(message) as caught:
        find_system(f"{tmp_path / 'own.py'}:system")
    assert "own.py" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gone.toml", "gone.toml: cannot read: No such file or directory"),
        ("gone.py:system", "gone.py: there is no such file"),
        ("nobody", "system 'nobody' is unknown; name a file such as my.toml"),
        ("folder.toml", "folder.toml: cannot read: Is a directory"),
        ("bytes.toml", "bytes.toml: expected UTF-8 text; save it as such"),
        ("large.toml", "large.toml: expected at most 4 MiB"),
    ],
)
def test_a_name_that_gives_no_system(name, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "bytes.toml").write_bytes(b"name = '\xff'")
    (tmp_path / "large.toml").write_bytes(b"#" * (2**22 + 1))
    with told(re.escape(message)):
        find_system(name)
