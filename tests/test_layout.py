"""A module imports only what stands above it, and importing pinav is cheap."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import pinav

ORDER = [
    "errors",
    "files",
    "arguments",
    "actuation",
    "forces",
    "dynamics",
    "systems",
    "scenarios",
    "trajectories",
    "recordings",
    "fitting",
    "evaluation",
    "identification",
    "analysis",
    "navigation",
    "thermal",
    "figures",
    "report",
    "runs",
    "commands",
    "cli",
]
ROOT = Path(pinav.__file__).parent
SOURCES = sorted(p for p in ROOT.rglob("*.py") if p != ROOT / "__init__.py")


def component(parts):
    """The first name below pinav; a package counts as one."""
    return parts[0].removesuffix(".py")


def imported_components(source):
    """First components of the pinav modules that a source imports, at any depth."""
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "write imports in full, from pinav"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            package, _, rest = name.partition(".")
            if package == "pinav" and rest and not rest.startswith("__"):
                yield rest.partition(".")[0]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_imports_only_what_stands_above_it(path):
    own = component(path.relative_to(ROOT).parts)
    names = [own, *imported_components(path.read_text())]
    for name in names:
        assert name in ORDER, f"place {name!r} in ORDER and in the layout of the docs"
    for name in names:
        assert ORDER.index(name) <= ORDER.index(own), f"{own} must not import {name}"


def test_import_reader_sees_every_form():
    source = (
        "import pinav.cli\nfrom pinav import runs, __version__\nimport numpy\n"
        "def f():\n    from pinav.fitting.matching.phases import Adam\n"
    )
    assert sorted(imported_components(source)) == ["cli", "fitting", "runs"]


def test_importing_pinav_does_not_import_jax():
    code = "import sys, pinav; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
