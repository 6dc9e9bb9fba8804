"""The result of each command can be stored: its annotations name what files hold."""

import dataclasses
import json
import subprocess
import sys

import pytest
from tests.samples import sample

from pinav import codec
from pinav.commands import COMMANDS
from pinav.commands.command import resolve
from pinav.commands.results import open_fit
from pinav.errors import InputError
from pinav.learning.learned import Learned
from pinav.learning.verdict import Standing, Verdict

STORED = {command.name: command for command in COMMANDS if command.result}
"""Commands whose result is a value of the library."""

RESULTS = {name: command.result for name, command in STORED.items()}
RESULTS |= {
    "quality": "pinav.recordings.quality:Quality",
    "flights of a cell": "pinav.navigation:SwimmerFlights",
}
"""What files hold: results of commands, and values that they keep besides."""


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_comes_back_from_its_files(name):
    """All fields of each class that a result may have, by their annotations."""
    if name in STORED:
        resolve(STORED[name].sections)  # which knows all classes
    family = resolve(RESULTS[name])
    classes = {**codec.members(family), "": family}.values()
    for cls in (one for one in classes if not one.__name__.startswith("Abstract")):
        if cls.__name__ == "LearnedTissue":  # derives its numbers from a fit
            continue
        document, arrays = codec.encode(sample(cls, whole=True))
        written = json.loads(json.dumps(document, allow_nan=False))
        again = codec.encode(codec.decode(cls, written, arrays))
        assert again.document == document
        assert again.arrays.keys() == arrays.keys()


@pytest.mark.parametrize("name", STORED)
def test_a_stored_result_has_a_file_and_is_said(name):
    command = STORED[name]
    assert command.file
    assert callable(resolve(command.sections))


IMPORT_ALL = """
import pkgutil, pinav
from pinav.codec import members
from pinav.commands import COMMANDS
from pinav.commands.command import resolve
said = [c for c in COMMANDS if c.result and resolve(c.sections)]
wanted = {c.name: resolve(c.result) for c in said}
known = {name: members(family) for name, family in wanted.items()}
for module in pkgutil.walk_packages(pinav.thermal.__path__, "pinav.thermal."):
    __import__(module.name)
assert known == {name: members(family) for name, family in wanted.items()}
"""
"""Heat alone has results in several modules; `heat learn` could not be reported."""


def test_who_says_a_result_knows_all_classes_that_it_may_have():
    subprocess.run([sys.executable, "-c", IMPORT_ALL], check=True)


def test_a_fit_is_opened_with_its_verdict_and_not_steered_by_where_that_forbids_it(
    fitted_run, capsys
):
    run = fitted_run("kernel")[0]
    fit = Learned.open(run)
    reason = "the thrust is 0.5 times the stated one (190 nats)"
    for standing, told in ((Standing.CONTRADICTS, True), (Standing.TRUSTED, False)):
        verdict = Verdict(standing, reason)
        fit.folder.store("metrics", dataclasses.replace(fit.findings, verdict=verdict))
        opened = open_fit(run)
        assert opened.verdict == verdict
        assert (reason in capsys.readouterr().err) == told
        if told:
            with pytest.raises(InputError, match=r"do not steer by this fit.*--anyway"):
                open_fit(run, steers=True)
        else:
            assert open_fit(run, steers=True).verdict == verdict
