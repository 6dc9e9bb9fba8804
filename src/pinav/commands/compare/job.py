"""`pinav compare`: several models of the same data, and their evidence."""

from collections.abc import Callable
from typing import Any

from pinav.commands.command import CommandResult
from pinav.commands.compare import COMPARE
from pinav.commands.compare.result import ComparedModel, Comparison, ComparisonVerdict
from pinav.commands.compare.settings import CompareOptions, CompareSettings
from pinav.commands.progress import Reporter
from pinav.commands.results import fingerprint, keep, start_run
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import FitError, InputError
from pinav.fitting import EvidenceFit, Outcome, fit_bayes, fit_langevin, model_evidence
from pinav.fitting.environments.catalogue import (
    build,
    mean_drag,
    with_linear_drag,
    with_tensor_drag,
)
from pinav.fitting.environments.summary import (
    TIMED,
    DataSummary,
    ModelChoice,
    summarise_for,
)
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.learning.evidence import rotational_part
from pinav.learning.plan import choose_system
from pinav.runs import RunFolder
from pinav.systems import System
from pinav.trajectories import Trajectories, load, with_missing_channels

QUESTIONS = (
    ("physics-only", "kernel-potential", "no environment", "an environment"),
    ("kernel-potential", "kernel-force", "a potential", "a free force"),
    ("kernel-potential", "kernel-mixture", "a potential", "a rotational part too"),
    ("kernel-potential", TIMED, "a static potential", "one that changes with time"),
    ("first-order", "kernel-potential", "first-order dynamics", "inertia"),
    ("isotropic-drag", "anisotropic-drag", "isotropic drag", "anisotropic drag"),
)
"""Pairs of models that answer a question, and what each of them stands for."""

NETWORKS = ("neural-potential", "neural-force")
"""Candidates distilled from a fit of kernels, whose process is their prior."""

KERNEL_POTENTIAL = ("first-order", "isotropic-drag", "anisotropic-drag")
"""Candidates whose environment is a kernel potential."""

LEARNED: dict[str, Callable[[Any], Any] | None] = {
    "physics-only": None,
    "isotropic-drag": lambda model: model.drag.damping,
    "anisotropic-drag": lambda model: model.drag.tensor,
}
"""What a candidate learns beside its environment; None where nothing is unknown."""


def check_settings(settings: CompareSettings, data: Trajectories) -> System:
    """The physics that all candidates share.

    Raises:
        InputError: a candidate cannot be had with these data or these physics.
    """
    known = choose_system(settings.system, data)
    inert = isinstance(known.swimmer, Swimmer)
    if "first-order" in settings.models and (
        not inert or data.observed[..., len(_positions(data)) :].any()
    ):
        raise InputError(
            "--models first-order: expected physics with inertia and positions alone, "
            f"got {', '.join(data.channels)}; drop it or the velocities"
        )
    stochastic = known.thermal_energy is not None
    for name in {*NETWORKS, "physics-only"} & set(settings.models):
        if stochastic:
            raise InputError(
                f"--models {name}: paths with thermal noise are fitted by kernels "
                "alone; drop it"
            )
    for name in {"isotropic-drag", "anisotropic-drag"} & set(settings.models):
        if not inert:
            raise InputError(f"--models {name}: expected physics with inertia; drop it")
        mean_drag(known.swimmer)
    return known


def compare(
    settings: CompareSettings, data: Trajectories, folder: RunFolder
) -> Comparison:
    """Fit each model and weigh their evidence; a finished fit is not done again."""
    known = check_settings(settings, data)
    rows: dict[str, ComparedModel] = {}
    for name in dict.fromkeys(settings.models):
        stored = f"evidence-{name}"
        if not folder.has(f"{stored}.json"):
            folder.store(stored, _candidate(name, settings, known, data, folder))
        rows[name] = folder.load(stored, ComparedModel)
    return Comparison(rows, tuple(verdicts(rows)))


def _candidate(
    name: str,
    settings: CompareSettings,
    known: System,
    data: Trajectories,
    folder: RunFolder,
) -> ComparedModel:
    """The evidence of one candidate."""
    try:
        result = fit_model(name, settings, known, data, folder)
    except FitError as error:
        return ComparedModel("failed", reason=str(error))
    return ComparedModel(
        outcome=str(result.outcome),
        evidence=model_evidence(result.linear, result.hyperparameters),
        noise=float(result.hyperparameters.noise),
        weights=len(result.posterior.mean),
        rotational_fraction=rotational_part(result, data).get("rotational fraction"),
    )


def fit_model(
    name: str,
    settings: CompareSettings,
    known: System,
    data: Trajectories,
    folder: RunFolder,
) -> EvidenceFit:
    """The fit of one candidate, whether or not it converged.

    Raises:
        FitError: it led nowhere from the first step on.
    """
    kernels = "kernel-potential" if name in KERNEL_POTENTIAL else name
    choice = ModelChoice(kernels)
    summary = summarise_for(choice, data)
    swimmer, inputs = known.swimmer, data
    if name == "first-order" and isinstance(swimmer, Swimmer):
        swimmer, inputs = _without_inertia(swimmer, summary), positions_alone(data)
    elif isinstance(swimmer, Swimmer) and len(_positions(data)) == len(data.channels):
        unseen = known.channels[len(data.channels) :]
        inputs = with_missing_channels(data, {n: known.units[n] for n in unseen})
    if name == "isotropic-drag":
        swimmer = with_linear_drag(swimmer, summary)
    if name == "anisotropic-drag":
        swimmer = with_tensor_drag(swimmer, summary)
    model = build(choice, swimmer, summary)
    if known.thermal_energy is not None:
        return fit_langevin(model, data)
    with Reporter(folder, name) as report:
        return fit_bayes(
            model,
            inputs,
            learn=LEARNED.get(name, lambda _: ()),
            noise=settings.noise,
            max_iterations=settings.max_steps,
            on_step=report,
            throw=False,
        )


def _without_inertia(swimmer: Swimmer, summary: DataSummary) -> OverdampedSwimmer:
    """The limit of strong drag: the mobility is one over the drag."""
    mobility = 1 / mean_drag(swimmer, summary)
    return OverdampedSwimmer(swimmer.propulsion, swimmer.environment, mobility)


def positions_alone(data: Trajectories) -> Trajectories:
    """The data without the channels that are no positions."""
    names = _positions(data)
    return Trajectories.from_arrays(
        [piece.times for piece in data],
        [piece.states[:, : len(names)] for piece in data],
        observed=[piece.observed[:, : len(names)] for piece in data],
        channels=names,
        units={name: data.units[name] for name in (*names, "t")},
        provenance=data.provenance,
    )


def _positions(data: Trajectories) -> list[str]:
    return list(data.channels[: data.dim])


def verdicts(rows: dict[str, ComparedModel]) -> list[ComparisonVerdict]:
    """The answer of the evidence to each question that two of the models answer.

    A difference of less than `DECISIVE` nats is called not decisive.

    Args:
        rows: the candidates by name.
    """
    return [
        _verdict((simple, rich), meanings, rows)
        for simple, rich, *meanings in QUESTIONS
        if simple in rows and rich in rows
    ]


def _verdict(
    names: tuple[str, str], meanings: list[str], rows: dict[str, ComparedModel]
) -> ComparisonVerdict:
    simple, rich = (rows[name].log_evidence for name in names)
    caveats = _caveats(rows, names)
    if simple is None or rich is None:
        text = f"No verdict on {meanings[0]} or {meanings[1]}: {caveats}."
        return ComparisonVerdict(names, None, text)
    difference = rich - simple
    preferred, other = meanings if difference < 0 else meanings[::-1]
    strength = "decisive" if abs(difference) >= DECISIVE else "not decisive"
    text = (
        f"The evidence prefers {preferred} to {other} by {abs(difference):.1f} nats: "
        f"{strength}."
    )
    if caveats:
        text += f" Caution: {caveats}."
    return ComparisonVerdict(names, difference, text)


def _caveats(rows: dict[str, ComparedModel], names: tuple[str, str]) -> str:
    bad = [name for name in names if rows[name].outcome != CONVERGED]
    return " and ".join(f"the fit of {name} {rows[name].outcome}" for name in bad)


CONVERGED = str(Outcome.CONVERGED)


def run(options: CompareOptions) -> CommandResult:
    """Compare as the command line does."""
    settings, data = options.settings, load(options.data)
    check_settings(settings, data)
    folder = start_run(COMPARE, options, settings, data=fingerprint(data))
    return keep(COMPARE, folder, compare(settings, data, folder))
