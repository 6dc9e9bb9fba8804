"""The page's modules in Node, without a page: their numbers are those of a browser."""

import json
import shutil
import subprocess

import pytest

from pinav.commands.explore.document import bundle

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no Node is there")


def answer(script: str, programs: str = "const PROGRAMS = [];"):
    """What a script of the page's functions says, from a line of JSON."""
    modules = bundle(programs).rsplit("\nbegin();", 1)[0]
    done = subprocess.run(
        ["node", "-"],
        input=f"{modules}\nconsole.log(JSON.stringify((() => {{ {script} }})()));",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)
