"""Structured terms as a file keeps them, and the force that is built from that."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import msgspec

from pinav.errors import InputError
from pinav.forces import (
    AbstractForce,
    AbstractProfileTerm,
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
from pinav.forces.fitted_laws import FITTED, FittedLaw

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
        law: name of the law that its profile follows, in `FITTED`, if any.
    """

    kind: str
    shapes: dict[str, tuple[int, ...]]
    rotational: bool = False
    law: str | None = None


def summarise_terms(force: AbstractForce) -> tuple[TermSummary, ...]:
    """The terms of a force; none where it has no structure."""
    return tuple(map(_summarise, split_structure(force)[0]))


def _summarise(term: AbstractTerm) -> TermSummary:
    law = term.law if isinstance(term, AbstractProfileTerm) else None
    shapes = {
        field.name: tuple(jnp.shape(getattr(term, field.name)))
        for field in dataclasses.fields(term)
        if field.name not in ("rotational", "law")
    }
    name = law and law.name
    return TermSummary(type(term).__name__, shapes, term.rotational, name)


def with_terms(model: Any, terms: tuple[TermSummary, ...]) -> Any:
    """A model whose kernels have terms beside them; their numbers are still zero.

    Raises:
        InputError: there is no such term, or no such law.
    """
    if not terms:
        return model
    force = StructuredForce(tuple(map(_blank, terms)), model.environment)
    return eqx.tree_at(lambda m: m.environment, model, force)


def _blank(term: TermSummary) -> AbstractTerm:
    """A term whose numbers are zero."""
    if term.kind not in TERMS:
        raise InputError(
            f"term {term.kind!r} is unknown; choose one of: {', '.join(TERMS)}"
        )
    arrays = {name: jnp.zeros(shape) for name, shape in term.shapes.items()}
    make = functools.partial(TERMS[term.kind], **arrays, rotational=term.rotational)
    if term.law is None:
        return make()
    if term.law not in FITTED:
        raise InputError(
            f"law {term.law!r} is unknown; choose one of: {', '.join(FITTED)}"
        )
    numbers = (jnp.zeros(()),) * len(FITTED[term.law].numbers)
    return make(law=FittedLaw(term.law, numbers))
