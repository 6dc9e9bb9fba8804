"""The calls of the jobs behind the commands.

Heavy imports stand inside the functions, so that `pinav COMMAND --help` is quick.
"""

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from pinav.commands.inspect.command import InspectOptions, inspect
from pinav.commands.navigate.command import NavigateOptions, navigate
from pinav.commands.parsing import (
    AnalyseOptions,
    BenchOptions,
    CompareOptions,
    DiscoverOptions,
    EvaluateOptions,
    FitOptions,
    HeatOptions,
    ReportOptions,
    ReproduceOptions,
    SimulateOptions,
    StudyOptions,
    parse,
)
from pinav.errors import InputError


def reproduce(options: ReproduceOptions) -> None:
    """`pinav reproduce`."""
    settings = options.settings
    settings.check()
    folder = _run_folder(options, settings, job="reproduce")
    _enable_x64()
    from pinav.commands.report.job import write_report
    from pinav.commands.reproduce import job, table2

    rows = job.reproduce(settings, folder)
    report = write_report(folder)
    if options.json:
        _print_json(folder.read_json("metrics.json"))
        return
    print(table2.text(rows))
    for row in table2.summary_lines(rows):
        print(row)
    print(f"report: {report}")


def simulate(options: SimulateOptions) -> None:
    """`pinav simulate`."""
    _enable_x64()
    from pinav.commands.simulate.job import simulate as job

    trajectories = job(
        options.scenario, options.settings, options.out, overwrite=options.overwrite
    )
    count, samples = len(trajectories), int(trajectories.lengths.sum())
    noun = "trajectory" if count == 1 else "trajectories"
    print(f"{options.out}: {count} {noun}, {samples} samples")


def fit(options: FitOptions) -> None:
    """`pinav fit`."""
    from pinav.trajectories import is_trajectories

    own = is_trajectories(options.data)
    if options.ladder or not own:
        _fit_recording(options, own=own)
        return
    settings = options.settings
    settings.check()
    _enable_x64()
    from pinav.commands.fit import job
    from pinav.trajectories import load

    data = job.prepared(settings, load(options.data))
    folder = _run_folder(options, settings, job="fit", data=job.fingerprint(data))
    metrics = job.fit(settings, data, folder)
    _show(folder, metrics, job.text, as_json=options.json)


def _fit_recording(options: FitOptions, *, own: bool) -> None:
    """`pinav fit RECORDING`, also of a file of pinav that holds one."""
    options.rungs.check()
    _enable_x64()
    from pinav.commands.fit.job import fingerprint
    from pinav.commands.identify import job
    from pinav.trajectories import load

    data = load(options.data) if own else options.recording.read(options.data)
    identity = {"data": fingerprint(data), "ladder": str(options.ladder).lower()}
    groups = [options.rungs] if own else [options.rungs, options.recording]
    folder = _run_folder(options, *groups, job="recording", **identity)
    metrics = job.fit_recording(
        options.rungs, data, folder, whole_ladder=options.ladder
    )
    _show(folder, metrics, job.text, as_json=options.json)


def compare(options: CompareOptions) -> None:
    """`pinav compare`."""
    settings = options.settings
    settings.check()
    _enable_x64()
    from pinav.commands.compare import job
    from pinav.commands.fit.job import fingerprint
    from pinav.trajectories import load

    data = load(options.data)
    job.checked(settings, data)
    folder = _run_folder(options, settings, job="compare", data=fingerprint(data))
    metrics = job.compare(settings, data, folder)
    _show(folder, metrics, job.text, as_json=options.json)


def evaluate(options: EvaluateOptions) -> None:
    """`pinav evaluate`."""
    _enable_x64()
    from pinav.commands.evaluate import job
    from pinav.evaluation import Regions
    from pinav.runs import RunFolder

    regions = None if options.regions is None else Regions(*options.regions)
    metrics = job.evaluate(
        options.run, options.data, calibration=options.calibrate, regions=regions
    )
    _show(RunFolder.open(options.run), metrics, job.text, as_json=options.json)


def study(options: StudyOptions) -> None:
    """`pinav study`."""
    settings = options.settings
    settings.check()
    _enable_x64()
    from pinav.commands.study import job
    from pinav.commands.study.paper_weakness import weakness
    from pinav.commands.study.report import text

    job.check(options.name, options.scenario, settings)
    identity = {"study": options.name, "scenario": options.scenario}
    folder = _run_folder(options, settings, job="study", **identity)
    if options.name == "paper-weakness":
        weakness(settings, folder)
    else:
        job.study(options.name, options.scenario, settings, folder)
    metrics = folder.read_json("metrics.json")
    _show(folder, metrics, text, as_json=options.json)


def discover(options: DiscoverOptions) -> None:
    """`pinav discover`."""
    if options.refits < 1:
        raise InputError(f"--refits: expected 1 or more, got {options.refits}")
    _enable_x64()
    from pinav.commands.discover import job
    from pinav.runs import RunFolder

    metrics = job.discover(options.run, options.refits)
    _show(RunFolder.open(options.run), metrics, job.text, as_json=options.json)


def analyse(options: AnalyseOptions) -> None:
    """`pinav analyse`."""
    options.settings.check()
    _enable_x64()
    from pinav.commands.analyse import job
    from pinav.runs import RunFolder

    found = job.analyse(options.settings, options.run)
    _show(RunFolder.open(options.run), found, job.text, as_json=options.json)


def heat(options: HeatOptions) -> None:
    """`pinav heat`."""
    if options.task == "validate":
        _heat_validate(as_json=options.json)
        return
    if options.case is None:
        raise InputError(
            f"heat {options.task}: expected the TOML file of a case, got none; "
            "examples/heat has some"
        )
    _enable_x64()
    from pinav.commands.heat.build import built
    from pinav.commands.heat.case import read_case
    from pinav.commands.heat.job import optimise_protocol, simulate
    from pinav.commands.heat.learn import learn_perfusion
    from pinav.commands.heat.tables import text
    from pinav.runs import RunFolder

    case, content = read_case(options.case)
    built(case)  # refuses a bad case before the folder is made
    config = {"job": "heat", "task": options.task, "case": content}
    folder = RunFolder.create(options.out, config, overwrite=options.overwrite)
    if options.task == "simulate":
        metrics = simulate(case, folder)
    elif options.task == "learn":
        metrics = learn_perfusion(case, folder, options.case)
    else:
        metrics = optimise_protocol(case, folder)
    _show(folder, metrics, text, as_json=options.json)


def _heat_validate(*, as_json: bool) -> None:
    _enable_x64()
    from pinav.commands.heat.tables import validation_rows, validation_table
    from pinav.errors import FitError
    from pinav.report.text import as_text
    from pinav.thermal.verification import validate

    checks = validate()
    if as_json:
        _print_json(validation_rows(checks))
    else:
        print(as_text(validation_table(checks)))
    missed = [check.case for check in checks if not check.passed]
    if missed:
        raise FitError(f"outside their tolerance: {', '.join(missed)}")


def report(options: ReportOptions) -> None:
    """`pinav report`."""
    from pinav.commands.report.job import write_report
    from pinav.runs import RunFolder

    print(f"report: {write_report(RunFolder.open(options.run))}")


def bench(argv: Sequence[str]) -> None:
    """`pinav bench`: the first word names the benchmark, which parses the others."""
    options = parse(BenchOptions, argv[:1], prog="pinav bench")
    if options is None:
        return
    import importlib

    root = Path(__file__).parents[3]
    entries = root.glob("benchmarks/[a-z]*")
    names = sorted(path.stem for path in entries if _is_module(path))
    if options.name not in names:
        known = (
            ", ".join(names) or "none here: benchmarks are part of a source checkout"
        )
        raise InputError(
            f"benchmark {options.name!r} is unknown; choose one of: {known}"
        )
    sys.path.insert(0, str(root))
    importlib.import_module(f"benchmarks.{options.name}").main(argv[1:])


def _is_module(path: Path) -> bool:
    return path.suffix == ".py" or (path / "__init__.py").exists()


HANDLERS: dict[str, tuple[type[msgspec.Struct], Callable[[Any], None]]] = {
    "reproduce": (ReproduceOptions, reproduce),
    "simulate": (SimulateOptions, simulate),
    "inspect": (InspectOptions, inspect),
    "fit": (FitOptions, fit),
    "compare": (CompareOptions, compare),
    "evaluate": (EvaluateOptions, evaluate),
    "discover": (DiscoverOptions, discover),
    "study": (StudyOptions, study),
    "analyse": (AnalyseOptions, analyse),
    "heat": (HeatOptions, heat),
    "navigate": (NavigateOptions, navigate),
    "report": (ReportOptions, report),
}


def dispatch(command: str, argv: Sequence[str]) -> None:
    """Parse the words after a command and run it.

    Raises:
        InputError: an option is unknown, misses its value or has a wrong one.
    """
    if command == "bench":
        bench(argv)
        return
    options, handler = HANDLERS[command]
    parsed = parse(options, argv, prog=f"pinav {command}")
    if parsed is not None:
        handler(parsed)


def _run_folder(options, *settings: msgspec.Struct, **identity: str):
    """The run folder, new or resumed."""
    if options.resume and options.overwrite:
        raise InputError("--resume and --overwrite: choose one of them")
    from pinav.runs import RunFolder

    content = [item for s in settings for item in msgspec.to_builtins(s).items()]
    config = identity | {k: v for k, v in content if v is not None}
    config = {k: list(v) if isinstance(v, tuple) else v for k, v in config.items()}
    if options.resume:
        return RunFolder.resume(options.out, config)
    return RunFolder.create(options.out, config, overwrite=options.overwrite)


def _show(folder, metrics: Any, text: Callable[[Any], str], *, as_json: bool) -> None:
    """Write the run's report; print its metrics, as JSON alone or for people."""
    from pinav.commands.report.job import write_report

    page = write_report(folder)
    if as_json:
        _print_json(metrics)
        return
    print(text(metrics))
    print(f"report: {page}")


def _enable_x64() -> None:
    import jax

    jax.config.update("jax_enable_x64", val=True)


def _print_json(content: Any) -> None:
    json.dump(content, sys.stdout, indent=2)
    print()
