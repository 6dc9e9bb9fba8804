"""Bad system files: one line each that names the file, the key and a remedy."""

import re

import pytest

from pinav.errors import InputError
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


BAD = {
    "not TOML": ("dimension = ", "not TOML: Invalid value"),
    "key twice": (
        swap("order = 2", "order = 2\norder = 2"),
        "not TOML: Cannot overwrite",
    ),
    "no dimension": (swap("dimension = 2\n", ""), "dimension: this key is missing"),
    "no order": (swap("order = 2\n", ""), "order: this key is missing"),
    "dimension 4": (
        swap("dimension = 2", "dimension = 4"),
        "dimension: expected 1 or 2 or 3, got 4",
    ),
    "dimension text": (
        swap("dimension = 2", 'dimension = "2"'),
        "dimension: expected a whole number, got '2'",
    ),
    "dimension half": (
        swap("dimension = 2", "dimension = 2.5"),
        "dimension: expected a whole number, got 2.5",
    ),
    "order 3": (swap("order = 2", "order = 3"), "order: expected 1 or 2, got 3"),
    "order true": (
        swap("order = 2", "order = true"),
        "order: expected a whole number, got True",
    ),
    "unknown key": (
        swap("drag =", "drga ="),
        "drga: this key is unknown; .* did you mean 'drag'",
    ),
    "unknown table": (
        GOOD + "[flows]\n",
        "flows: this key is unknown; .* did you mean 'flow'",
    ),
    "no drag": (swap("drag = 0.36\n", ""), "drag: this key is missing; state the drag"),
    "negative drag": (swap("0.36", "-0.36"), "drag: expected 0 or more, got -0.36"),
    "drag nan": (swap("0.36", "nan"), "drag: expected a finite number, got nan"),
    "drag text": (swap("0.36", '"0.36"'), "drag: expected a number, got '0.36'"),
    "mobility of order 2": (
        swap("drag =", "mobility ="),
        "mobility: a system of order 2 has drag",
    ),
    "drag of order 1": (
        swap("order = 2", "order = 1"),
        "drag: a system of order 1 has mobility",
    ),
    "bad length": (
        swap('"um"', '"parsec"'),
        "units: units.length: expected one of 1, nm, um",
    ),
    "bad time": (
        swap('"s"', '"Hz"'),
        "units: units.time: expected one of 1, us, ms, s",
    ),
    "units no table": (
        swap('[units]\nlength = "um"\ntime = "s"', 'units = "um"'),
        "units: expected a table",
    ),
    "unknown unit": (
        swap("length =", "lenght ="),
        "units.lenght: this key is unknown; .* 'length'",
    ),
    "unknown kind": (
        swap('"gaussian-barrier"', '"gausian-barrier"'),
        "truth.kind: .* did you mean 'gaussian-barrier'",
    ),
    "no kind": (
        swap('kind = "gaussian-barrier"\n', ""),
        "truth.kind: expected one of .* got nothing",
    ),
    "kind is a flow": (
        swap('"gaussian-barrier"', '"shear-flow"'),
        "truth.kind: expected one of",
    ),
    "field missing": (swap("width = 2.9\n", ""), "truth.width: this key is missing"),
    "field unknown": (
        swap("width = 2.9", "width = 2.9\nsigma = 1"),
        "truth.sigma: this key is unknown",
    ),
    "width negative": (
        swap("width = 2.9", "width = -2.9"),
        "truth: GaussianBarrier.width: expected > 0, got -2.9",
    ),
    "center too long": (
        swap("center = [5.0, 5.0]", "center = [5.0, 5.0, 5.0]"),
        "truth.center: expected 2 numbers",
    ),
    "center too short": (
        swap("center = [5.0, 5.0]", "center = [5.0]"),
        "truth.center: expected 2 numbers",
    ),
    "center text": (
        swap("center = [5.0, 5.0]", 'center = ["a", "b"]'),
        "truth.center: expected finite numbers",
    ),
    "center ragged": (
        swap("center = [5.0, 5.0]", "center = [[5.0], 5.0]"),
        "truth.center: expected rows of equal",
    ),
    "force of the plane in space": (
        swap("dimension = 2", "dimension = 3")
        .replace("[0.1, 0.0]", "[0.1, 0, 0]")
        .replace("gaussian-barrier", "gaussian-swirl")
        .replace("height", "strength")
        .replace("[5.0, 5.0]", "[5.0, 5.0, 5.0]"),
        "truth.center: expected 2 numbers",
    ),
    "flow of the plane in space": (
        warm("dimension = 2", "dimension = 3")
        + '[flow]\nkind = "shear-flow"\nrate = 1.0\n',
        "flow: expected 3 components, as dimension = 3 says",
    ),
    "noise negative": (
        swap("noise = 0.02", "noise = -1.0"),
        "observation: Observation.noise: expected 0 or more, got -1.0",
    ),
    "noise infinite": (
        swap("noise = 0.02", "noise = inf"),
        "observation.noise: expected a finite number",
    ),
    "learn nothing": (
        swap('"drag.damping"', '"drag.dumping"'),
        "learn: 'drag.dumping' is not in the swimmer",
    ),
    "learn beyond the forces": (
        swap('"drag.damping"', '"known_force.terms[7].stiffness"'),
        r"learn: 'known_force.terms\[7\].stiffness' is not in the swimmer",
    ),
    "learn unknown prior": (
        swap('kind = "normal"', 'kind = "beta"'),
        "learn.'drag.damping'.kind: expected one of flat",
    ),
    "learn bad prior": (
        swap("deviation = 0.1", "deviation = 0.0"),
        "learn.'drag.damping': Normal.deviation: expected > 0",
    ),
    "starts too short": (
        swap("1.0, 1.0]]", "1.0]]"),
        "system.starts: expected 4 numbers a start",
    ),
    "starts ragged": (
        swap("1.0, 1.0]]", "1.0], [1]]"),
        "starts.states: expected rows of equal length",
    ),
    "starts without": (
        swap("states = [[0.0, 0.0, 1.0, 1.0]]", "count = 3"),
        "starts: expected a table with states",
    ),
    "rule unknown": (
        swap("states = [[0.0, 0.0, 1.0, 1.0]]", 'kind = "rings"'),
        "starts.kind: .* did you mean",
    ),
    "box upside down": (
        swap(
            "states = [[0.0, 0.0, 1.0, 1.0]]",
            'kind = "uniform-starts"\nlower = [1.0, 1.0]\nupper = [0.0, 2.0]',
        ),
        "starts: .*expected upper beyond lower",
    ),
    "times backwards": (
        swap("last = 1.0", "last = -1.0"),
        "times: expected two or more increasing times",
    ),
    "times both": (
        swap("samples = 11", "samples = 11\nstep = 0.1"),
        "times: expected either samples or step",
    ),
    "times too many": (
        swap("samples = 11", "step = 1e-9"),
        "times: expected 2 to 10000000 samples",
    ),
    "times no list": (
        swap("last = 1.0\nsamples = 11", "values = 3"),
        "times.values: expected a list",
    ),
    "model unknown": (
        GOOD + '[unknown]\nmodel = "kernels"\n',
        "unknown.model: expected one of .* got 'kernels'",
    ),
    "unknown table's key": (
        GOOD + "[unknown]\nwidth = 3\n",
        "unknown.width: this key is unknown",
    ),
    "forces no list": (
        GOOD + "[[forces]]\nforce = [0.0, 1.0]\n",
        r"forces\[0\].kind: expected one of",
    ),
    "thermal of order 2": (
        GOOD + "[thermal]\ntemperature = 300.0\n",
        "thermal: thermal noise needs order = 1",
    ),
    "thermal negative": (
        warm("0.004", "-0.004"),
        "thermal.energy: expected 0 or more, got -0.004",
    ),
    "thermal twice": (
        THERMAL + "diffusion = 1.0\n",
        "thermal.diffusion: energy says it already",
    ),
    "temperature in mm": (
        warm('"um"', '"mm"').replace("energy", "temperature"),
        "thermal.temperature: expected the units um, s and pN",
    ),
    "radius alone": (
        warm("mobility = 2.0\n", "") + "radius = 1.0\n",
        "thermal.viscosity: expected > 0",
    ),
    "mobility twice": (
        THERMAL + "radius = 1.0\nviscosity = 0.89\n",
        "mobility: thermal.radius and thermal.viscosity",
    ),
    "mobility zero": (
        warm("mobility = 2.0", "mobility = 0"),
        "mobility: expected > 0, got 0",
    ),
    "tensor negative": (
        warm("mobility = 2.0", 'mobility = {kind = "isotropic-tensor", value = -1.0}'),
        "mobility: IsotropicTensor.value: expected > 0, got -1.0",
    ),
    "wandering without memory": (
        THERMAL + "[wandering]\nstill = 0.1\ndriven = 1.0\n",
        "wandering.memory: this key is missing",
    ),
    "wandering of order 2": (
        GOOD + "[wandering]\nstill = 0.1\ndriven = 1.0\nmemory = 1.0\n",
        "system.wandering: expected a swimmer without inertia",
    ),
    "own class gone": (
        swap('"gaussian-barrier"', '"gone.py:Hill"'),
        "gone.py: there is no such file",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_told_in_one_line(case, tmp_path):
    text, message = BAD[case]
    path = tmp_path / "my.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_system(path)
    said = str(caught.value)
    assert said.startswith(str(path))
    assert "\n" not in said
    assert len(said.removeprefix(str(path))) < 900


@pytest.mark.parametrize("text", [GOOD, THERMAL], ids=["order 2", "order 1"])
def test_the_files_that_are_damaged_above_are_good(text, tmp_path):
    (tmp_path / "my.toml").write_text(text)
    assert read_system(tmp_path / "my.toml").name == "my"


PYTHON = {
    "raises": ("1 / 0", "line 1: ZeroDivisionError: division by zero; correct it"),
    "syntax": ("x = (", "line 1: SyntaxError"),
    "exits": ("import sys\nsys.exit(3)", "line 2: SystemExit: 3"),
    "no name": ("other = 1", "defines no 'system'; choose one of other"),
    "no system": ("system = 3", "expected a System, or a function .* got a int"),
    "function raises": (
        "def system():\n    raise KeyError('k')",
        "KeyError: 'k'; the function",
    ),
    "function needs": (
        "def system(n):\n    return n",
        "TypeError: .* missing 1 required",
    ),
    "function gives": (
        "def system():\n    return None",
        "expected a System, .* got a NoneType",
    ),
}


@pytest.mark.parametrize("case", PYTHON)
def test_a_bad_python_file_is_told_in_one_line(case, tmp_path):
    text, message = PYTHON[case]
    (tmp_path / "own.py").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        find_system(f"{tmp_path / 'own.py'}:system")
    assert "own.py" in str(caught.value)
    assert "\n" not in str(caught.value)


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
    with pytest.raises(InputError, match=re.escape(message)):
        find_system(name)
