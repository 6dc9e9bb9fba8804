"""`pinav compare`: several models of the same data, and their evidence."""

import dataclasses
from collections.abc import Callable
from typing import Any

from pinav.commands import COMPARE
from pinav.commands.command import CommandResult
from pinav.commands.compare import CompareOptions, CompareSettings
from pinav.commands.progress import Reporter
from pinav.commands.results import fingerprint, keep, start_run
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import FitError, InputError
from pinav.figures import Picture
from pinav.figures.analysis import evidence_bars
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    ModelEvidence,
    Outcome,
    fit_bayes,
    fit_langevin,
    model_evidence,
)
from pinav.fitting.environments.catalogue import (
    build,
    mean_drag,
    with_linear_drag,
    with_tensor_drag,
)
from pinav.fitting.environments.summary import TIMED, ModelChoice, summarise_for
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.learning.evidence import rotational_part
from pinav.learning.plan import choose_system
from pinav.report import Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.systems import System
from pinav.trajectories import Trajectories, load, with_all_channels


@dataclasses.dataclass(frozen=True)
class ComparedModel:
    """The evidence of one model.

    Attributes:
        outcome: word for how its fit ended, or `failed`.
        evidence: of the model; none for a failed fit.
        rotational_fraction: of a mixture, where there are data.
    """

    outcome: str
    evidence: ModelEvidence | None = None
    noise: float | None = None
    weights: int = 0
    rotational_fraction: Estimate | None = None
    reason: str = ""

    @property
    def log_evidence(self) -> float | None:
        """Log evidence [nats], hyperparameters integrated out; none without a fit."""
        return None if self.evidence is None else self.evidence.log_evidence


@dataclasses.dataclass(frozen=True)
class ComparisonVerdict:
    """The answer of the evidence to a question.

    Attributes:
        difference: of their log evidence [nats]; none where one has none.
    """

    models: tuple[str, str]
    difference: float | None
    text: str


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Several models of the same data.

    Attributes:
        models: each candidate by its name.
        verdicts: answers to the questions that two of the candidates decide.
    """

    models: dict[str, ComparedModel]
    verdicts: tuple[ComparisonVerdict, ...]


HEADER = (
    "model",
    "log evidence [nats]",
    "hyperparameter correction [nats]",
    "Δ log evidence [nats]",
    "outcome",
)
NOTE = (
    "Log evidence with the hyperparameters integrated out; starts and learned "
    "constants have priors of unit information."
)


def sections(comparison: Comparison) -> list[Section]:
    """The verdicts, the table of the candidates, and their evidence as bars."""
    picture = Picture(
        "evidence",
        lambda: evidence_bars(
            {name: one.log_evidence for name, one in comparison.models.items()}
        ),
        "Nats below the best model; the scale is logarithmic above one.",
        alt="Bars: by how much the log evidence of each model is below the best",
    )
    sentences = [verdict.text for verdict in comparison.verdicts]
    sentences += [
        f"Rotational fraction of {name} where there are data: {part.value:.3f} ± "
        f"{part.sd:.2g} (sd)."
        for name, one in comparison.models.items()
        if (part := one.rotational_fraction)
    ]
    blocks = [*map(Paragraph, sentences), table(comparison), picture]
    return [Section("The evidence", blocks)]


def table(comparison: Comparison) -> Table:
    """The candidates, the best one first."""
    known = {
        name: one.evidence
        for name, one in comparison.models.items()
        if one.evidence is not None
    }
    best = max((one.log_evidence for one in known.values()), default=0.0)
    rows = [
        (
            name,
            f"{one.log_evidence:.1f}",
            f"{one.correction:.1f}",
            f"{best - one.log_evidence:.1f}",
            comparison.models[name].outcome,
        )
        for name, one in sorted(known.items(), key=lambda pair: -pair[1].log_evidence)
    ]
    failed = [name for name in comparison.models if name not in known]
    rows += [(n, "–", "–", "–", comparison.models[n].reason) for n in failed]
    return Table(HEADER, rows, NOTE)


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
    """The physics that all candidates share."""
    known = choose_system(settings.system, data)
    inert = isinstance(known.swimmer, Swimmer)
    if "first-order" in settings.models and (
        not inert or data.observed[..., data.dim :].any()
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
            try:
                one = _judge(fit_model(name, settings, known, data, folder), data)
            except FitError as error:
                one = ComparedModel("failed", reason=str(error))
            folder.store(stored, one)
        rows[name] = folder.load(stored, ComparedModel)
    return Comparison(rows, tuple(verdicts(rows)))


def _judge(result: EvidenceFit, data: Trajectories) -> ComparedModel:
    """The evidence of a fit."""
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
    """The fit of one candidate, whether or not it converged."""
    kernels = "kernel-potential" if name in KERNEL_POTENTIAL else name
    choice = ModelChoice(kernels)
    summary = summarise_for(choice, data)
    swimmer, inputs = known.swimmer, with_all_channels(data, known)
    if name == "first-order" and isinstance(swimmer, Swimmer):
        # the limit of strong drag: the mobility is one over the drag
        mobility = 1 / mean_drag(swimmer, summary)
        swimmer = OverdampedSwimmer(swimmer.propulsion, swimmer.environment, mobility)
        inputs = data.only(known.position_channels)
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


def verdicts(rows: dict[str, ComparedModel]) -> list[ComparisonVerdict]:
    """The answer of the evidence to each question that two of the models answer.

    A difference of less than `DECISIVE` nats is called not decisive.
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
    bad = [name for name in names if rows[name].outcome != str(Outcome.CONVERGED)]
    caveats = " and ".join(f"the fit of {name} {rows[name].outcome}" for name in bad)
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


def run(options: CompareOptions) -> CommandResult:
    """Compare as the command line does."""
    settings, data = options.settings, load(options.data)
    check_settings(settings, data)
    folder = start_run(COMPARE, options, settings, data=fingerprint(data))
    return keep(COMPARE, folder, compare(settings, data, folder))
