"""What a reproduction has to say: Table 2, Figure 1, the learned force."""

from pinav.commands.reproduce.result import Reproduction, label_of
from pinav.commands.reproduce.table2 import table2_blocks
from pinav.evaluation import Decomposition
from pinav.figures import Picture, acceleration_figure, figure1, force_comparison
from pinav.report import AbstractBlock, Paragraph, Section, Table

BARRIER = ([5.0, 5.0], 2.9)
"""Centre and width of the benchmark's barrier, drawn as context."""

KERNEL = "ude-kernel"
"""The row of the model with kernels in place of the network."""


def sections(result: Reproduction) -> list[Section]:
    """The table, the figure of each model, and what the models learned."""
    seed = result.settings.seeds[0]
    kernel = []
    if KERNEL in result.losses:
        text = (
            "The same physics with a static kernel potential in place of the network: "
            "linear in its weights, and nothing random in it."
        )
        blocks = [Paragraph(text), _figure1(result, None, KERNEL)]
        kernel = [Section("Figure 1 for the kernel residual", blocks)]
    left_out = Paragraph("The paper left this figure out.")
    alone = [left_out, _figure1(result, seed, "nn-only")]
    return [
        Section("Table 2", table2_blocks(result)),
        Section("Figure 1: the UDE", [_figure1(result, seed, "ude")]),
        Section("Figure 1 for the network alone", alone),
        *kernel,
        Section("The learned force", _forces(result, seed)),
        Section("What makes up the acceleration", [_parts(result, seed)]),
    ]


def _figure1(result: Reproduction, seed: int | None, model: str) -> Picture:
    label, losses = label_of(model, seed), result.losses[model]
    return Picture(
        f"figure1-{model}",
        lambda: figure1(
            result.times,
            result.truth,
            result.rollout(label_of(f"{model}-untrained", seed)).states,
            result.rollout(label).states,
            losses.values,
            losses.phases,
            model=model,
            barrier=BARRIER,
        ),
        f"{label}: (a, b) trajectory, (c) training loss with the change of phase "
        "marked, (d, e) velocity; before and after training, against the truth. "
        "Dimensionless, synthetic data.",
        alt=f"Trajectory, velocity and training loss of the model {model}",
    )


def _forces(result: Reproduction, seed: int) -> list[AbstractBlock]:
    drawn = [name for name in (f"ude-{seed}", KERNEL) if name in result.forces]
    rows = [
        (label, *(100 * error for error in errors.values()))
        for label, errors in result.force_error.items()
    ]
    return [
        *(_force(result, label) for label in drawn),
        Table(
            ("model", "visited (%)", "near (%)", "everywhere (%)"),
            rows,
            "Relative L2 error of the force on grid points within 0.35 of a sample, "
            "within 1.0, and on the whole grid.",
        ),
        Paragraph(
            "One trajectory does not determine the field: away from the path the "
            "learned force is an extrapolation, whatever the trajectory error says. "
            "The network also sees time; each point shows the time of the nearest "
            "sample, the reading most favourable to it."
        ),
    ]


def _force(result: Reproduction, label: str) -> Picture:
    return Picture(
        f"force-{label}",
        lambda: force_comparison(
            result.learned_field(label),
            true=result.true_field,
            path=result.truth[:, :2],
        ),
        f"The true force, that of {label}, and the difference.",
        alt="True force, learned force and their difference on a grid",
    )


def _parts(result: Reproduction, seed: int) -> Picture:
    learned = result.parts[f"ude-{seed}"]
    truth = Decomposition(
        result.times, learned.terms | {"environment": result.true_force}
    )
    return Picture(
        "acceleration",
        lambda: acceleration_figure(learned, true=truth),
        "a(t) = propulsion + environment + drag along the true trajectory, UDE of "
        f"seed {seed}.",
        alt="Propulsion, learned environment and drag along the trajectory",
    )
