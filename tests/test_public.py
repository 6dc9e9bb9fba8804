"""The names that `import pinav` offers, and what importing it costs."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import pinav

SOURCE = Path(pinav.__file__)


@pytest.mark.parametrize("name", [n for n in dir(pinav) if not n.startswith("__")])
def test_every_public_name_is_there(name):
    value = getattr(pinav, name)
    assert value.__name__ == name
    assert value.__doc__


def test_the_checker_sees_the_names_that_are_loaded():
    listed = {
        alias.asname
        for node in ast.walk(ast.parse(SOURCE.read_text()))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert {*dir(pinav), None} - {"__version__"} == {*listed, None} - {"Any"}
    assert 25 <= len(dir(pinav)) <= 50


def test_other_names_are_refused():
    with pytest.raises(AttributeError, match="module 'pinav' has no attribute 'nope'"):
        _ = pinav.nope


def test_importing_pinav_takes_less_than_a_tenth_of_a_second_and_no_jax():
    code = (
        "import time; start = time.perf_counter(); import pinav, sys; dir(pinav);"
        "print(time.perf_counter() - start); sys.exit('jax' in sys.modules)"
    )
    # The quickest of several: the machine may be busy.
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
        for _ in range(5)
    ]
    assert min(float(run.stdout) for run in runs) < 0.1


def test_the_package_says_that_it_is_typed():
    assert (SOURCE.parent / "py.typed").exists()
