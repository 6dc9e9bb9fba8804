"""What each command takes: options as strict structs, parsed by tyro.

Heavy imports stand elsewhere, so that `pinav COMMAND --help` is quick.
"""

import contextlib
import io
import itertools
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import tyro

from pinav.commands.analyse.settings import AnalyseSettings
from pinav.commands.compare.settings import CompareSettings
from pinav.commands.fit.settings import FitSettings
from pinav.commands.identify.settings import LadderSettings
from pinav.commands.inspect.settings import RecordingSettings
from pinav.commands.reproduce.settings import ReproduceSettings
from pinav.commands.simulate.settings import SimulateSettings
from pinav.commands.study.settings import StudyName, StudySettings
from pinav.errors import InputError

Options = TypeVar("Options", bound=msgspec.Struct)

ConfigFile = Annotated[
    Path | None,
    tyro.conf.arg(help="TOML file with settings; options on the command line win."),
]
OutFolder = Annotated[Path, tyro.conf.arg(help="Folder of the run.")]
Resume = Annotated[
    bool, tyro.conf.arg(help="Go on with the run in --out where it was interrupted.")
]
Overwrite = Annotated[
    bool, tyro.conf.arg(help="Replace the results that --out already holds.")
]
AsJson = Annotated[
    bool,
    tyro.conf.arg(help="Print the metrics as JSON, for scripts, and nothing else."),
]


class ReproduceOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Run the paper's experiment, from nothing to its table and figures.

    Simulates the Gaussian-barrier benchmark, trains the UDE and the network-only
    baseline, scores them in float64, prints Table 2 beside the paper's values and
    writes report.html. A killed run goes on with --resume.
    """

    settings: ReproduceSettings = ReproduceSettings()
    out: OutFolder = Path("runs/reproduce")
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False


class SimulateOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Write the trajectories of a named scenario to a .npz or .csv file."""

    scenario: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(
            help="Name of the scenario, such as barrier-crossings; docs/scenarios.md "
            "lists them."
        ),
    ]
    out: Annotated[Path, tyro.conf.arg(help="File to write, .npz or .csv.")]
    settings: SimulateSettings = SimulateSettings()
    overwrite: Annotated[
        bool, tyro.conf.arg(help="Replace the file if it is there.")
    ] = False


class FitOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Fit a model of the unknown force to trajectories, or a ladder to a recording.

    Trajectories: an .npz or .csv file of pinav. A CSV file has the columns t, x, y, vx,
    vy and, for several trajectories, trajectory; an empty cell is a missing
    observation. The recipe bayes needs positions alone: vx, vy may be missing.

    A recording: the file of a tracker (pinav inspect says what it holds). First-order
    models from drift to a delayed, slipping propulsion are fitted to the first part of
    each track and rolled out on the rest; the evidence chooses. With --ladder also
    position-dependent residuals and baselines.
    """

    data: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(help="Trajectories, .npz or .csv, or a recording of a tracker."),
    ]
    out: OutFolder
    ladder: Annotated[
        bool,
        tyro.conf.arg(help="Recording: residuals by position and baselines too."),
    ] = False
    settings: FitSettings = FitSettings()
    recording: RecordingSettings = RecordingSettings()
    rungs: LadderSettings = LadderSettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False


class CompareOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Fit several models to the same trajectories and weigh their evidence.

    Prints the log evidence of each, what its hyperparameters cost, and a verdict with
    its number on each question that two of the models answer.
    """

    data: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Trajectories, .npz or .csv.")
    ]
    out: OutFolder
    settings: CompareSettings = CompareSettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False


class EvaluateOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Say where the models of a run can be trusted, on trajectories kept apart.

    Rollouts over time, also from clean starts beyond the training horizon; the force on
    visited, near and unvisited ground; coverage of the bands; whiteness of the
    residuals; learned constants. Where the data are noisy or incomplete, each start is
    estimated from the first 20 samples and the others are scored. Writes
    evaluation.json and evaluation.csv into the run, and figures into its report.
    """

    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Folder of a fitted run.")
    ]
    data: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Trajectories, .npz or .csv.")
    ]
    calibrate: Annotated[
        Path | None,
        tyro.conf.arg(
            help="Further trajectories, from which bands that hold 95 % of new "
            "trajectories are calibrated (split-conformal)."
        ),
    ] = None
    regions: Annotated[
        tuple[float, float] | None,
        tyro.conf.arg(
            help="Distances from the data up to which ground is visited, and near; "
            "0.35 and 1 for dimensionless data, else 1/40 and 1/14 of their extent."
        ),
    ] = None
    json: AsJson = False


class DiscoverOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Find the law behind the learned force of a run of pinav fit.

    Fits about a dozen potentials and rotational terms to the learned force, refits
    the best of them to the trajectories, and prints them with 95 % intervals, or
    that the data do not identify one. Writes laws.json and report.html into the run.
    """

    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Folder of pinav fit.")
    ]
    refits: Annotated[
        int, tyro.conf.arg(help="Number of laws refitted to the trajectories.")
    ] = 5
    json: AsJson = False


class AnalyseOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Map what a fit learned, and what it depends on; adds to its report.

    Writes analysis.json, analysis-*.csv, figures and sections of report.html: gradient
    and rotational part of the force, potential, signal to noise, influence of each
    trajectory and constant, dependence of rollouts on start and parameters. What needs
    a posterior is left out where the run has none.
    """

    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Folder of a run of pinav fit.")
    ]
    settings: AnalyseSettings = AnalyseSettings()
    json: AsJson = False


class ReportOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Draw the figures and the HTML page of a finished run again."""

    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="Folder of a finished run.")
    ]


class StudyOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Compare models over the amount of data or of noise, one figure for each study.

    data-efficiency: force and rollout error over the number of trajectories; noise:
    the same over the noise of the observations; paper-weakness: the paper's network on
    its single trajectory beside a kernel potential on several. All data are synthetic.
    A killed study goes on with --resume.
    """

    name: Annotated[StudyName, tyro.conf.Positional, tyro.conf.arg(help="Which study.")]
    out: OutFolder
    scenario: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(
            help="Name of the scenario (docs/scenarios.md); paper-weakness has its own."
        ),
    ] = "barrier-crossings"
    settings: StudySettings = StudySettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False


class HeatOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Bioheat with magnetic heating: synthetic cases of a research code.

    validate: errors of the solver against exact solutions, here and now; simulate:
    temperature and dose of a case; learn: its perfusion from probes, with a band;
    optimise: the protocol of most dose in the tumour under the limits of the case. A
    case is a TOML file (docs/thermal.md, examples/heat). Perfusion takes a unit: 1/s,
    kg/m3/s, ml/min/kg or ml/min/100g. Never a plan for anybody's treatment.
    """

    task: Annotated[
        Literal["validate", "simulate", "learn", "optimise"],
        tyro.conf.Positional,
        tyro.conf.arg(help="What to do."),
    ]
    case: Annotated[
        Path | None,
        tyro.conf.Positional,
        tyro.conf.arg(help="TOML file of the case; validate needs none."),
    ] = None
    out: OutFolder = Path("runs/heat")
    overwrite: Overwrite = False
    json: AsJson = False


class BenchOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Run a benchmark of a source checkout and print its table."""

    name: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(
            help="Name of the benchmark: fit, gradient, growth, heat, navigate or "
            "recordings. What follows it are options of its own: pinav bench fit "
            "--help."
        ),
    ]


def parse(options: type[Options], argv: Sequence[str], prog: str) -> Options | None:
    """Options from words; None where help was asked for and printed.

    Raises:
        InputError: tyro refuses the words; its boxed message becomes one line.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                options,
                args=list(argv),
                prog=prog,
                **_defaults(options, argv),
                config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
            )
    except SystemExit as stop:
        if not stop.code:
            return None
        raise InputError(
            f"{_one_line(complaint.getvalue())}; see {prog} --help"
        ) from stop


def _one_line(box: str) -> str:
    """The first paragraph of a boxed message, without its box."""
    words = []
    for line in box.splitlines()[1:]:
        inner = line.strip("│╭╮╰╯ ")
        if not inner.strip("─"):
            break
        words.append(inner)
    return " ".join(words).rstrip(".")


def _defaults(options: type[Options], argv: Sequence[str]) -> dict[str, Any]:
    """Keyword `default` of tyro: the settings of `--config`, where it is given.

    Raises:
        InputError: the file is missing, not TOML, or holds an unknown setting.
    """
    path = _config_path(argv)
    fields = {field.name: field for field in msgspec.structs.fields(options)}
    if path is None or "config" not in fields:
        return {}
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        content = {k: v for k, v in content.items() if k not in IDENTITY}
        from_file = _grouped(content, fields)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"--config {path}: cannot be read: {error}") from error
    except msgspec.ValidationError as error:
        raise InputError(f"--config {path}: {error}") from error
    required = {n: tyro.MISSING for n, field in fields.items() if field.required}
    return {"default": options(**required, **from_file)}


def _grouped(content: dict[str, Any], fields: dict[str, Any]) -> dict[str, Any]:
    """Each group of settings from those entries of a file that are its own.

    Raises:
        msgspec.ValidationError: an entry has the wrong type, or no group knows it.
    """
    groups = {
        name: field.type
        for name, field in fields.items()
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct)
    }
    own = {name: set(kind.__struct_fields__) for name, kind in groups.items()}
    known = set.union(*own.values())
    return {
        name: msgspec.convert(
            {
                key: value
                for key, value in content.items()
                if key in own[name] or (name == "settings" and key not in known)
            },
            kind,
        )
        for name, kind in groups.items()
    }


def _config_path(argv: Sequence[str]) -> Path | None:
    for word, following in itertools.pairwise([*argv, ""]):
        if word == "--config" and following:
            return Path(following)
        if word.startswith("--config="):
            return Path(word.removeprefix("--config="))
    return None


IDENTITY = ("job", "data", "study", "scenario", "ladder")
"""Entries of a run's config.toml beside its settings; such a file is welcome too."""
