"""The commands of the command line: one folder and one entry here for each.

A folder holds the options (`__init__.py`, without numerical libraries), what runs and
says the result (`job.py`, and `sections.py` beside it where it is long).
"""

from pinav.commands.command import Command

REPRODUCE = Command(
    name="reproduce",
    summary="run the paper's experiment: simulate, train, Table 2, report",
    options="pinav.commands.reproduce:ReproduceOptions",
    run="pinav.commands.reproduce.job:run",
    title="The paper's benchmark",
    result="pinav.commands.reproduce.sections:Reproduction",
    file="metrics",
    sections="pinav.commands.reproduce.sections:sections",
    resumable=True,
)

SIMULATE = Command(
    name="simulate",
    summary="write the trajectories of a system to a file",
    options="pinav.commands.simulate:SimulateOptions",
    run="pinav.commands.simulate.job:run",
)

INSPECT = Command(
    name="inspect",
    summary="say what a recording holds, before any fit",
    options="pinav.commands.inspect:InspectOptions",
    run="pinav.commands.inspect.job:run",
)

IDENTIFY = Command(
    name="identify",
    summary="find which response to commands a recording supports",
    options="pinav.commands.identify:IdentifyOptions",
    run="pinav.commands.identify.job:run",
    title="The response of a recorded swimmer",
    result="pinav.identification:Identification",
    file="metrics",
    sections="pinav.commands.identify.sections:sections",
    resumable=True,
)

FIT = Command(
    name="fit",
    summary="fit a model of the unknown force to trajectories",
    options="pinav.commands.fit:FitOptions",
    run="pinav.commands.fit.job:run",
    title="A fitted model",
    result="pinav.learning.findings:Findings",
    file="metrics",
    sections="pinav.commands.fit.job:sections",
    resumable=True,
)

EVALUATE = Command(
    name="evaluate",
    summary="say where a fitted run can be trusted, on other trajectories",
    options="pinav.commands.evaluate:EvaluateOptions",
    run="pinav.commands.evaluate.job:run",
    result="pinav.evaluation:Evaluation",
    file="evaluation",
    sections="pinav.commands.evaluate.job:sections",
)

ANALYSE = Command(
    name="analyse",
    summary="map what a fit learned, and what it depends on",
    options="pinav.commands.analyse:AnalyseOptions",
    run="pinav.commands.analyse.job:run",
    result="pinav.analysis:Analysis",
    file="analysis",
    sections="pinav.commands.analyse.job:sections",
)

COMPARE = Command(
    name="compare",
    summary="compare the evidence of several models of the same data",
    options="pinav.commands.compare:CompareOptions",
    run="pinav.commands.compare.job:run",
    title="A comparison of models",
    result="pinav.commands.compare.job:Comparison",
    file="metrics",
    sections="pinav.commands.compare.job:sections",
    resumable=True,
)

DISCOVER = Command(
    name="discover",
    summary="find the law behind the learned force of a run",
    options="pinav.commands.discover:DiscoverOptions",
    run="pinav.commands.discover.job:run",
    result="pinav.analysis:Discovery",
    file="laws",
    sections="pinav.commands.discover.sections:sections",
)

STUDY = Command(
    name="study",
    summary="compare models over the amount of data or of noise",
    options="pinav.commands.study:StudyOptions",
    run="pinav.commands.study.job:run",
    title="A study of models",
    result="pinav.commands.study.job:Study",
    file="metrics",
    sections="pinav.commands.study.job:sections",
    resumable=True,
)

DATA = Command(
    name="data",
    summary="tell where public recordings come from, and fetch them",
    options="pinav.commands.data:DataOptions",
    run="pinav.commands.data:run",
)

HEAT = Command(
    name="heat",
    summary="bioheat: simulate a case, learn perfusion, optimise a protocol",
    options="pinav.commands.heat:HeatOptions",
    run="pinav.commands.heat.job:run",
    title="Bioheat",
    result="pinav.thermal.heated_run:AbstractHeatResult",
    file="metrics",
    sections="pinav.commands.heat.sections:sections",
    compiler_flags=False,  # small to compile, and its gradient runs slower with them
)

NAVIGATE = Command(
    name="navigate",
    summary="plan and steer through the force that a run has learned",
    options="pinav.commands.navigate:NavigateOptions",
    run="pinav.commands.navigate.job:run",
    title="Navigation",
    result="pinav.navigation.comparison:AbstractNavigation",
    file="metrics",
    sections="pinav.commands.navigate.sections:sections",
    resumable=True,
)

DESIGN = Command(
    name="design",
    summary="choose which trajectories to record until a way is known",
    options="pinav.commands.design:DesignOptions",
    run="pinav.commands.design.job:run",
    title="Design of experiments",
    result="pinav.navigation.design.result:DesignResult",
    file="metrics",
    sections="pinav.commands.design.job:sections",
)

LIVE = Command(
    name="live",
    summary="estimate and steer at a rig that is running",
    options="pinav.commands.live:LiveOptions",
    run="pinav.commands.live.job:run",
    resumable=True,
)

EXPLORE = Command(
    name="explore",
    summary="write a page in which the model of a run is tried by hand",
    options="pinav.commands.explore:ExploreOptions",
    run="pinav.commands.explore.job:run",
    report="pinav.commands.explore.document:explorer_sections",
)

EXPORT = Command(
    name="export",
    summary="write what a run has learned in the formats of other programs",
    options="pinav.commands.export:ExportOptions",
    run="pinav.commands.export.job:run",
)

REPORT = Command(
    name="report",
    summary="draw the figures and the HTML page of a run again",
    options="pinav.commands.report:ReportOptions",
    run="pinav.commands.report:run",
)

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
