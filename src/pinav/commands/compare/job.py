"""`pinav compare`: several models of the same data, and their evidence."""

from collections.abc import Callable
from typing import Any

from pinav.commands.command import CommandResult
from pinav.commands.compare.command import COMPARE
from pinav.commands.compare.settings import CompareOptions, CompareSettings
from pinav.commands.fitted_run import rotational_part
from pinav.commands.progress import BayesReporter
from pinav.commands.start import fingerprint, start_run
from pinav.commands.system_choice import choose_system
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import FitError, InputError
from pinav.fitting import EvidenceFit, fit_bayes, fit_langevin, model_evidence
from pinav.fitting.environments.catalogue import (
    TIMED,
    DataSummary,
    ModelChoice,
    build,
    mean_drag,
    summarise_for,
    with_linear_drag,
    with_tensor_drag,
)
from pinav.runs import RunFolder
from pinav.systems import System
from pinav.trajectories import Trajectories, load, with_unobserved

DECISIVE = 5.0
"""Nats from which a verdict is called decisive: odds of 150 to 1.

Reference: Kass and Raftery, J. Am. Stat. Assoc. 90, 773 (1995)."""

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
"""Candidates whose prior is the process of the kernels that taught them."""

KERNEL_POTENTIAL = ("first-order", "isotropic-drag", "anisotropic-drag")
"""Candidates whose environment is a kernel potential."""

LEARNED: dict[str, Callable[[Any], Any] | None] = {
    "physics-only": None,
    "isotropic-drag": lambda model: model.drag.damping,
    "anisotropic-drag": lambda model: model.drag.tensor,
}
"""What a candidate learns beside its environment; None where nothing is unknown."""


def checked(settings: CompareSettings, data: Trajectories) -> System:
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
) -> dict[str, Any]:
    """Fit each model and weigh their evidence; a finished fit is not done again.

    Returns:
        The content of `metrics.json`: a row for each model, and the verdicts.
    """
    known = checked(settings, data)
    rows = {}
    for name in dict.fromkeys(settings.models):
        stored = f"evidence-{name}.json"
        if not folder.has(stored):
            folder.write_json(stored, _row(name, settings, known, data, folder))
        rows[name] = folder.read_json(stored)
    metrics = {"models": rows, "verdicts": verdicts(rows)}
    folder.write_json("metrics.json", metrics)
    return metrics


def _row(name, settings, known: System, data, folder) -> dict[str, Any]:
    """The evidence of one candidate."""
    try:
        found = fitted(name, settings, known, data, folder)
    except FitError as error:
        return {"outcome": "failed", "reason": str(error), "log_evidence": None}
    evidence = model_evidence(found.linear, found.hyperparameters)
    estimates = rotational_part(found, data)
    return {
        "outcome": str(found.outcome),
        "noise": found.hyperparameters.noise,
        "weights": int(len(found.posterior.mean)),
        "best": evidence.best,
        "occam": evidence.correction,
        "log_evidence": evidence.log_evidence,
        **{k: {"value": e.value, "sd": e.sd} for k, e in estimates.items()},
    }


def fitted(
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
    swimmer, seen = known.swimmer, data
    if name == "first-order" and isinstance(swimmer, Swimmer):
        swimmer, seen = _without_inertia(swimmer, summary), positions_alone(data)
    elif isinstance(swimmer, Swimmer) and len(_positions(data)) == len(data.channels):
        unseen = known.channels[len(data.channels) :]
        seen = with_unobserved(data, {n: known.units[n] for n in unseen})
    if name == "isotropic-drag":
        swimmer = with_linear_drag(swimmer, summary)
    if name == "anisotropic-drag":
        swimmer = with_tensor_drag(swimmer, summary)
    model = build(choice, swimmer, summary)
    if known.thermal_energy is not None:
        return fit_langevin(model, data)
    with BayesReporter(folder, name) as report:
        return fit_bayes(
            model,
            seen,
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


def verdicts(rows: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """What the evidence says on each question that two of the models answer.

    A difference of less than `DECISIVE` nats is called indecisive.

    Args:
        rows: by the name of the model, with `log_evidence` and `outcome`.
    """
    found = []
    for simple, rich, without, with_it in QUESTIONS:
        if simple in rows and rich in rows:
            values = [rows[name]["log_evidence"] for name in (simple, rich)]
            caveats = _caveats(rows, (simple, rich))
            found.append(_verdict((simple, rich), (without, with_it), values, caveats))
    return found


def _verdict(names, meanings, values, caveats) -> dict[str, Any]:
    if None in values:
        text = f"No verdict on {meanings[0]} or {meanings[1]}: {caveats}."
        return {"models": names, "difference": None, "text": text}
    difference = float(values[1] - values[0])
    preferred, other = meanings if difference < 0 else meanings[::-1]
    strength = "decisive" if abs(difference) >= DECISIVE else "not decisive"
    text = (
        f"The evidence prefers {preferred} to {other} by {abs(difference):.1f} nats: "
        f"{strength}."
    )
    if caveats:
        text += f" Caution: {caveats}."
    return {"models": names, "difference": difference, "text": text}


def _caveats(rows, names) -> str:
    bad = [n for n in names if rows[n]["outcome"] != "converged"]
    return " and ".join(f"the fit of {n} {rows[n]['outcome']}" for n in bad)


def text(metrics: dict[str, Any]) -> str:
    """The table and the verdicts for a terminal."""
    lines = [f"{'':<25}{'log evidence':>14}{'occam':>8}{'below best':>12}  outcome"]
    for name, cells in table(metrics["models"]):
        lines.append(f"{name:<25}" + "".join(cells))
    fractions = [
        f"rotational fraction of {name} on visited ground: {part['value']:.3f} ± "
        f"{part['sd']:.2g} (sd)"
        for name, row in metrics["models"].items()
        if (part := row.get("rotational fraction"))
    ]
    return "\n".join([*lines, *fractions, *(v["text"] for v in metrics["verdicts"])])


def table(rows: dict[str, dict[str, Any]]) -> list[tuple[str, list[str]]]:
    """Cells of each model, the best one first."""
    values = {name: row["log_evidence"] for name, row in rows.items()}
    known = {name: value for name, value in values.items() if value is not None}
    best = max(known.values(), default=0.0)
    cells = []
    for name in sorted(known, key=lambda n: -known[n]):
        row = rows[name]
        numbers = (f"{known[name]:>14.1f}", f"{row['occam']:>8.1f}")
        below = f"{best - known[name]:>12.1f}  "
        cells.append((name, [*numbers, below, row["outcome"]]))
    failed = [name for name in values if name not in known]
    return cells + [
        (name, [f"{'–':>14}", f"{'–':>8}", f"{'–':>12}  ", rows[name]["reason"]])
        for name in failed
    ]


def run(options: CompareOptions) -> CommandResult:
    """Compare as the command line does."""
    settings, data = options.settings, load(options.data)
    checked(settings, data)
    folder = start_run(COMPARE, options, settings, data=fingerprint(data))
    metrics = compare(settings, data, folder)
    return CommandResult(metrics, text(metrics), folder)
