"""A module imports only what stands above it, and the tests lie as the source does."""

import ast
import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import pinav
import pinav.commands
import pinav.forces

ORDER = [
    *("errors", "files", "numerics", "threads", "units", "settings", "reading"),
    *("sweeps", "arguments", "codec", "actuation", "forces", "dynamics", "systems"),
    *("scenarios", "trajectories", "recordings", "fitting", "checkpoints"),
    *("manifest", "runs", "evaluation", "identification", "learning", "analysis"),
    *("navigation", "thermal", "live", "report", "figures", "commands", "regressor"),
    *("cli", "__main__"),
]
ROOT = Path(pinav.__file__).parent
SOURCES = sorted(p for p in ROOT.rglob("*.py") if p != ROOT / "__init__.py")
PACKAGES = sorted(p.parent for p in SOURCES if p.name == "__init__.py")
COMMANDS = ROOT / "commands"
TESTS = Path(__file__).parent


def imported_modules(source: str) -> Iterator[str]:
    """Dotted paths below pinav that a source imports, at any depth of the code.

    The last name may be that of a function or class of a module.
    """
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
                yield rest


def imported_siblings(path: Path, package: Path) -> set[str]:
    """First names below a package that one of its modules imports, less its own."""
    prefix = ".".join(package.relative_to(ROOT).parts) + "."
    own = component(path.relative_to(package).parts)
    names = {
        name.removeprefix(prefix).partition(".")[0]
        for name in imported_modules(path.read_text(encoding="utf-8"))
        if name.startswith(prefix)
    }
    modules = {component((p.name,)) for p in package.iterdir()}
    return (names & modules) - {own}


def component(parts: tuple[str, ...]) -> str:
    """The first name below a package; a folder counts as one."""
    return parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_imports_only_what_stands_above_it(path):
    own = component(path.relative_to(ROOT).parts)
    names = [own, *(n.partition(".")[0] for n in imported_modules(path.read_text()))]
    for name in names:
        assert name in ORDER, f"place {name!r} in ORDER and in the layout of the docs"
    for name in names:
        assert ORDER.index(name) <= ORDER.index(own), f"{own} must not import {name}"


@pytest.mark.parametrize(
    "package",
    [package for package in PACKAGES if package != COMMANDS],
    ids=lambda p: str(p.relative_to(ROOT)),
)
def test_the_modules_of_a_package_can_be_put_in_an_order(package):
    """No circle among modules and subpackages: each imports only what comes before."""
    imports = {}
    for path in package.rglob("*.py"):
        if path != package / "__init__.py":
            own = component(path.relative_to(package).parts)
            imports.setdefault(own, set()).update(imported_siblings(path, package))
    try:
        graphlib.TopologicalSorter(imports).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_a_command_does_not_import_another_command():
    """What two commands share stands beside the folders, and imports none of them."""
    tangles = set()
    folders = {path.name for path in COMMANDS.iterdir() if path.is_dir()}
    for path in COMMANDS.rglob("*.py"):
        if path != COMMANDS / "__init__.py":
            own = path.relative_to(COMMANDS).parts[0]
            imports = imported_siblings(path, COMMANDS) & folders
            tangles |= {f"{own} -> {name}" for name in imports}
    assert not tangles


KEYS_TOO = {"data", "fit"}
"""Commands whose names are keys of files as well, which other modules must spell."""


def test_the_folder_of_a_command_holds_its_options_and_what_runs_it():
    """No module for the options alone, nor one that a single other one could hold."""
    for command in pinav.commands.COMMANDS:
        folder = COMMANDS / command.name
        options, _, _ = command.options.partition(":")
        assert options == f"pinav.commands.{command.name}"
        modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
        assert "job" in modules or not modules


def test_the_name_of_a_command_is_spelled_in_its_folder_alone():
    """Elsewhere a command is a value; the public names of functions are others."""
    names = {path.name for path in COMMANDS.iterdir() if path.is_dir()} - KEYS_TOO
    own_words = COMMANDS / "heat"  # whose tasks have names of their own
    for path in SOURCES:
        if own_words not in path.parents and path != COMMANDS / "__init__.py":
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and node.value in names:
                    folder = COMMANDS / str(node.value)
                    place = f"{path.relative_to(ROOT)}:{node.lineno}"
                    assert folder in path.parents, f"{node.value!r} in {place}"


MOST = {"dict[str, Any]": 30, "# type: ignore": 0, "# noqa": 0}
"""How often each may occur in the source; lower these as they are removed."""


@pytest.mark.parametrize("words", MOST)
def test_what_should_vanish_becomes_no_more(words):
    count = sum(path.read_text(encoding="utf-8").count(words) for path in SOURCES)
    assert count <= MOST[words]


def test_environments_are_asked_by_their_methods_not_for_their_classes():
    """A new kind of kernels or networks is one file; see `AbstractLearnedForce`."""
    base = pinav.forces.AbstractLearnedForce
    public = vars(pinav.forces).items()
    classes = {name: kind for name, kind in public if isinstance(kind, type)}
    learned = {name for name, kind in classes.items() if issubclass(kind, base)}
    checks = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance":
                asked = set(re.findall(r"\w+", ast.unparse(node.args[1])))
                if learned & asked:
                    checks.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert len(checks) <= 5, checks


def test_import_reader_sees_every_form():
    source = (
        "import pinav.cli\nfrom pinav import runs, __version__\nimport numpy\n"
        "def f():\n    from pinav.fitting.matching.phases import Adam\n"
    )
    assert sorted(imported_modules(source)) == [
        "cli",
        "fitting.matching.phases.Adam",
        "runs",
    ]


def test_tests_lie_in_folders_named_as_those_of_the_source():
    folders = {path.parent.relative_to(TESTS) for path in TESTS.rglob("test_*.py")}
    others = {Path("benchmarks"), Path("validation")}  # beside the package
    for folder in folders - others:
        assert (ROOT / folder).is_dir(), f"no {folder} in the source"
