"""The commands of the command line: one folder and one entry here for each.

A folder holds the options (`__init__.py`, without numerical libraries), what runs and
says the result (`job.py`, and `sections.py` beside it where it is long).
"""

from typing import Any

from pinav.commands.command import Command


def _command(
    name: str, summary: str, *, run: str = ".job", sections: str = "", **parts: Any
) -> Command:
    """The command of a folder.

    Args:
        run: module of the folder that holds `run`; empty for the folder itself.
        sections: module that holds `sections`; empty where it stores no result.
    """
    folder = f"pinav.commands.{name}"
    if sections:
        parts["sections"] = f"{folder}{sections}:sections"
    options = f"{folder}:{name.capitalize()}Options"
    return Command(name, summary, options, f"{folder}{run}:run", **parts)


REPRODUCE = _command(
    "reproduce",
    "run the paper's experiment: simulate, train, Table 2, report",
    title="The paper's benchmark",
    result="pinav.commands.reproduce.sections:Reproduction",
    sections=".sections",
    resumable=True,
)
SIMULATE = _command("simulate", "write the trajectories of a system to a file")
INSPECT = _command("inspect", "say what a recording holds, before any fit")
IDENTIFY = _command(
    "identify",
    "find which response to commands a recording supports",
    title="The response of a recorded swimmer",
    result="pinav.identification:Identification",
    sections=".job",
    resumable=True,
)
FIT = _command(
    "fit",
    "fit a model of the unknown force to trajectories",
    title="A fitted model",
    result="pinav.learning.findings:Findings",
    sections=".job",
    resumable=True,
)
EVALUATE = _command(
    "evaluate",
    "say where a fitted run can be trusted, on other trajectories",
    result="pinav.evaluation:Evaluation",
    file="evaluation",
    sections=".job",
)
ANALYSE = _command(
    "analyse",
    "map what a fit learned, and what it depends on",
    result="pinav.analysis:Analysis",
    file="analysis",
    sections=".job",
)
COMPARE = _command(
    "compare",
    "compare the evidence of several models of the same data",
    title="A comparison of models",
    result="pinav.commands.compare.job:Comparison",
    sections=".job",
    resumable=True,
)
DISCOVER = _command(
    "discover",
    "find the law behind the learned force of a run",
    result="pinav.analysis:Discovery",
    file="laws",
    sections=".job",
)
STUDY = _command(
    "study",
    "compare models over the amount of data or of noise",
    title="A study of models",
    result="pinav.commands.study.job:Study",
    sections=".job",
    resumable=True,
)
DATA = _command(
    "data", "tell where public recordings come from, and fetch them", run=""
)
HEAT = _command(
    "heat",
    "bioheat: simulate a case, learn perfusion, optimise a protocol",
    title="Bioheat",
    result="pinav.thermal.heated_run:AbstractHeatResult",
    sections=".job",
    compiler_flags=False,  # small to compile, and its gradient runs slower with them
)
NAVIGATE = _command(
    "navigate",
    "plan and steer through the force that a run has learned",
    title="Navigation",
    result="pinav.navigation.comparison:AbstractNavigation",
    sections=".sections",
    resumable=True,
)
DESIGN = _command(
    "design",
    "choose which trajectories to record until a way is known",
    title="Design of experiments",
    result="pinav.navigation.design.campaign:DesignResult",
    sections=".job",
)
LIVE = _command("live", "estimate and steer at a rig that is running", resumable=True)
EXPLORE = _command(
    "explore",
    "write a page in which the model of a run is tried by hand",
    report="pinav.commands.explore.document:explorer_sections",
)
EXPORT = _command(
    "export", "write what a run has learned in the formats of other programs"
)
REPORT = _command("report", "draw the figures and the HTML page of a run again", run="")

COMMANDS = (
    REPRODUCE,
    SIMULATE,
    INSPECT,
    IDENTIFY,
    FIT,
    EVALUATE,
    ANALYSE,
    COMPARE,
    DISCOVER,
    STUDY,
    DATA,
    HEAT,
    NAVIGATE,
    DESIGN,
    LIVE,
    EXPLORE,
    EXPORT,
    REPORT,
)
"""All commands, in the order in which help lists them."""
