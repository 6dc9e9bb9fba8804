"""Structured terms as a file keeps them, and the force that is built from that."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import msgspec

from pinav.errors import InputError
from pinav.forces import (
    AbstractForce,
    AbstractTerm,
    CentralTerm,
    EllipticTerm,
    HillsTerm,
    LatticeTerm,
    LinearTerm,
    ObstaclesTerm,
    SegmentTerm,
    StructuredForce,
    WallTerm,
    split_structure,
)

TERMS: dict[str, type[AbstractTerm]] = {
    kind.__name__: kind
    for kind in (
        CentralTerm,
        EllipticTerm,
        HillsTerm,
        LatticeTerm,
        LinearTerm,
        ObstaclesTerm,
        SegmentTerm,
        WallTerm,
    )
}
"""Terms by the names of their classes."""


class TermSummary(msgspec.Struct, frozen=True):
    """A structured term, but for its numbers.

    Attributes:
        kind: name of its class, in `TERMS`.
        shapes: of its arrays, by name.
        rotational: whether it is turned.
    """

    kind: str
    shapes: dict[str, tuple[int, ...]]
    rotational: bool = False


def summarise_terms(force: AbstractForce) -> tuple[TermSummary, ...]:
    """The terms of a force; none where it has no structure."""
    return tuple(
        TermSummary(
            type(term).__name__,
            {
                field.name: tuple(jnp.shape(getattr(term, field.name)))
                for field in dataclasses.fields(term)
                if field.name != "rotational"
            },
            term.rotational,
        )
        for term in split_structure(force)[0]
    )


def with_terms(model: Any, terms: tuple[TermSummary, ...]) -> Any:
    """A model whose kernels have terms beside them; their numbers are still zero.

    Raises:
        InputError: there is no such term.
    """
    if not terms:
        return model
    made = []
    for term in terms:
        if term.kind not in TERMS:
            raise InputError(
                f"term {term.kind!r} is unknown; choose one of: {', '.join(TERMS)}"
            )
        arrays = {name: jnp.zeros(shape) for name, shape in term.shapes.items()}
        made.append(TERMS[term.kind](**arrays, rotational=term.rotational))
    force = StructuredForce(tuple(made), model.environment)
    return eqx.tree_at(lambda m: m.environment, model, force)
