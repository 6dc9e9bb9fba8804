"""The structure that a fit found, in words and numbers, and its profiles."""

from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.fitted_run import FittedRun
from pinav.fitting import Posterior, derive, is_worth_a_search
from pinav.fitting.environments.choice import MIXTURE
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.structure.survey import LEAST_SAMPLES, LEAST_TRAJECTORIES
from pinav.forces import (
    AbstractProfileTerm,
    AbstractTerm,
    HillsTerm,
    split_structure,
)
from pinav.report import number

POINTS = 121
"""Of a drawn profile."""


class LawRow(msgspec.Struct, frozen=True):
    """A law that the potential of a profile follows.

    Attributes:
        kind: the word for it.
        formula: of the potential, in LaTeX, for unit height.
        names: of its constants, the height [L² T⁻²] first.
        values: of them.
        sd: their standard deviations.
    """

    kind: str
    formula: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    sd: tuple[float, ...]

    def text(self) -> str:
        """The law in words and numbers."""
        constants = [
            f"{name} {number(value, 4)} ± {number(sd, 2)}"
            for name, value, sd in zip(self.names, self.values, self.sd, strict=True)
        ]
        return f"potential: {self.kind} of {', '.join(constants)}"


class TermRow(msgspec.Struct, frozen=True):
    """A term of the force.

    Attributes:
        kind: the word for it.
        formula: in LaTeX.
        geometry: its numbers, such as a centre [L] or an angle [rad].
        sd: their standard deviations.
        law: that its profile follows, if any.
    """

    kind: str
    formula: str
    geometry: tuple[float, ...]
    sd: tuple[float, ...]
    law: LawRow | None = None

    def text(self) -> str:
        """The term in words and numbers."""
        place = self._place()
        return place if self.law is None else f"{place} ({self.law.text()})"

    def _place(self) -> str:
        if not self.geometry:
            return self.kind
        spread = f" ± {number(max(self.sd), 2)}"
        values = ", ".join(number(value, 4) for value in self.geometry)
        if self.kind in ("wall", "shear layer"):
            degrees = np.degrees(self.geometry[0]) % 360
            spread = f" ± {number(float(np.degrees(self.sd[0])), 2)}"
            return (
                f"{self.kind} with its normal at {number(degrees, 5)}{spread} degrees"
            )
        if self.kind == HillsTerm.KIND:
            count = HillsTerm.count(len(self.geometry))
            centers = np.reshape(self.geometry[: 2 * count], (count, 2))
            places = ", ".join(f"({number(x, 4)}, {number(y, 4)})" for x, y in centers)
            spread = f" ± {number(max(self.sd[: 2 * count]), 2)}"
            return f"{count} {self.kind} at {places}{spread}"
        word = "about" if self.kind.startswith("central") else "with"
        return f"{self.kind} {word} ({values}){spread}"


class StructureRow(msgspec.Struct, frozen=True):
    """What a search for a structure came to.

    Attributes:
        terms: with structure; none where free kernels alone are preferred.
        gain: log evidence over free kernels [nats]; None where no structure explained
            the data well enough to be fitted, or free kernels alone diverge.
        rotation: log evidence of a rotational part beside a potential [nats]; None
            where none was weighed.
        turns: whether the force has a rotational part.
        sought: whether there were data enough for a search.
        of_teacher: whether it is the structure of the kernels that taught a network.
    """

    terms: tuple[TermRow, ...]
    gain: float | None
    rotation: float | None = None
    turns: bool = False
    sought: bool = True
    of_teacher: bool = False

    def text(self) -> str:
        """One line for a terminal, and one on the rotation where it was weighed."""
        whose = "the network's teacher: " if self.of_teacher else ""
        lines = [self._structure(), *self._rotation()]
        return "\n".join(f"{whose}{line}" for line in lines)

    def _rotation(self) -> list[str]:
        if self.rotation is None:
            return []
        nats = f"{number(self.rotation, 3)} nats"
        if self.turns:
            return [
                "force: a gradient and a rotational part (kernel-mixture), which the "
                f"log evidence prefers to a potential alone by {nats}"
            ]
        return [
            "force: a potential (kernel-potential); the log evidence of a rotational "
            f"part beside it differs by {nats}"
        ]

    def _structure(self) -> str:
        if self.terms:
            names = ", and ".join(term.text() for term in self.terms)
            if self.gain is None:
                return f"structure: {names}; a fit of free kernels alone diverges"
            nats = f"{number(self.gain, 3)} nats"
            if self.gain > DECISIVE:
                return f"structure: {names}; {nats} over free kernels"
            return (
                f"structure: {names}; it is simpler than free kernels, which the log "
                f"evidence cannot tell from it ({nats} over them)"
            )
        if not self.sought:
            return (
                "structure: free kernels; none was sought, which takes "
                f"{LEAST_TRAJECTORIES} trajectories and {LEAST_SAMPLES} numbers"
            )
        if self.gain is None:
            return "structure: free kernels; no structure tried explains the data"
        return (
            "structure: free kernels; the log evidence of the best structure tried "
            f"differs by {number(self.gain, 3)} nats"
        )


def structure_row(run: FittedRun) -> StructureRow | None:
    """What the search of a run came to; None where there was none.

    A network has no structure; its teacher may have one.
    """
    if run.teacher is not None:
        row = structure_row(run.teacher)
        return row and msgspec.structs.replace(row, of_teacher=True)
    evidence = run.evidence
    if evidence is None or evidence.structure is None:
        return None
    model: Any = run.model
    force = model.environment
    gain = evidence.structure.gain
    rows: list[TermRow] = []
    for index, term in enumerate(getattr(force, "terms", ())):
        numbers = derive(evidence.posterior, lambda m, i=index: _numbers(m, i))
        rows.append(
            TermRow(
                term.kind,
                term.latex,
                tuple(one.value for one in numbers),
                tuple(one.sd for one in numbers),
                _law_row(term, evidence.posterior, index),
            )
        )
    rotation = evidence.structure.rotation
    return StructureRow(
        tuple(rows),
        gain if np.isfinite(gain) else None,
        rotation if np.isfinite(rotation) else None,
        turns=run.choice.name == MIXTURE,
        sought=is_worth_a_search(model, run.data),
    )


def _numbers(model: Any, index: int) -> Float[Array, " number"]:
    term = model.environment.terms[index]
    leaves = term.placement if isinstance(term, AbstractProfileTerm) else term.geometry
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(leaf) for leaf in leaves)])


def _law_row(term: AbstractTerm, posterior: Posterior, index: int) -> LawRow | None:
    law = term.law if isinstance(term, AbstractProfileTerm) else None
    if law is None:
        return None

    def constants(model: Any) -> Float[Array, " constant"]:
        one = model.environment.terms[index]
        values = one.law.constants(one.offset).values()
        return jnp.stack([one.weights[0], *values])

    estimates = derive(posterior, constants)
    return LawRow(
        law.kind,
        law.latex,
        ("height", *law.constants()),
        tuple(one.value for one in estimates),
        tuple(one.sd for one in estimates),
    )


def profile_arrays(run: FittedRun) -> dict[str, np.ndarray]:
    """Profile of each term that has one, with its standard deviation, by place."""
    run = run if run.teacher is None else run.teacher
    model: Any = run.model
    force = getattr(model, "environment", None)
    terms = () if force is None else split_structure(force)[0]
    if not terms or run.posterior is None:
        return {}
    arrays: dict[str, np.ndarray] = {}
    samples = jnp.asarray(run.data.positions[run.data.observed[..., :2].all(-1)])
    for index, term in enumerate(terms):
        if not isinstance(term, AbstractProfileTerm):
            continue
        is_observed = np.asarray(jax.vmap(term.coordinates)(samples))
        places = np.linspace(
            0.0 if term.is_odd else is_observed.min(), is_observed.max(), POINTS
        )

        def profile(model: Any, i: int = index, z: Any = places) -> Array:
            return jax.vmap(model.environment.terms[i].profile)(jnp.asarray(z))

        values = derive(run.posterior, profile)
        arrays[f"structure/{index}"] = np.stack(
            [
                places + float(term.offset),
                [v.value for v in values],
                [v.sd for v in values],
            ]
        )
    return arrays
