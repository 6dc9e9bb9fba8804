"""The structure that a fit found: its terms, their laws and profiles."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.fitting import Posterior, derive, is_worth_a_search
from pinav.fitting.environments.summary import MIXTURE
from pinav.forces import AbstractProfileTerm, AbstractTerm, split_structure
from pinav.learning.findings import FoundLaw, FoundStructure, FoundTerm, Profile
from pinav.learning.learned import Learned
from pinav.trajectories import Trajectories

POINTS = 121
"""Points of a profile."""


def found_structure(run: Learned) -> FoundStructure | None:
    """What the search of a fit came to; None where there was none.

    A network has no structure; its teacher may have one.
    """
    kernels = run if run.teacher is None else run.teacher
    evidence, posterior = kernels.evidence, kernels.posterior
    if evidence is None or posterior is None or evidence.structure is None:
        return None
    model: Any = kernels.model
    force = model.environment
    terms = split_structure(force)[0] if hasattr(force, "terms") else ()
    gain, rotation = evidence.structure.gain, evidence.structure.rotation
    return FoundStructure(
        tuple(
            _found_term(term, index, posterior, kernels.data)
            for index, term in enumerate(terms)
        ),
        gain if np.isfinite(gain) else None,
        rotation if np.isfinite(rotation) else None,
        turns=kernels.choice.name == MIXTURE,
        sought=is_worth_a_search(model, kernels.data),
        of_teacher=run.teacher is not None,
    )


def _found_term(
    term: AbstractTerm, index: int, posterior: Posterior, data: Trajectories
) -> FoundTerm:
    has_profile = isinstance(term, AbstractProfileTerm)
    return FoundTerm(
        term.kind,
        term.latex,
        tuple(derive(posterior, lambda model: _numbers(model, index))),
        _found_law(term, posterior, index) if has_profile else None,
        _profile(term, posterior, index, data) if has_profile else None,
    )


def _numbers(model: Any, index: int) -> Float[Array, " number"]:
    term = model.environment.terms[index]
    leaves = term.placement if isinstance(term, AbstractProfileTerm) else term.geometry
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(leaf) for leaf in leaves)])


def _found_law(
    term: AbstractProfileTerm, posterior: Posterior, index: int
) -> FoundLaw | None:
    law = term.law
    if law is None:
        return None

    def constants(model: Any) -> Float[Array, " constant"]:
        one = model.environment.terms[index]
        values = one.law.constants(one.offset).values()
        return jnp.stack([one.weights[0], *values])

    names = ("height", *law.constants())
    estimates = derive(posterior, constants)
    return FoundLaw(law.name, law.latex, dict(zip(names, estimates, strict=True)))


def _profile(
    term: AbstractProfileTerm, posterior: Posterior, index: int, data: Trajectories
) -> Profile:
    """The profile over the coordinates that were observed, with its deviation."""
    samples = jnp.asarray(data.positions[data.observed[..., :2].all(-1)])
    coordinates = np.asarray(jax.vmap(term.coordinates)(samples))
    places = np.linspace(
        0.0 if term.is_odd else coordinates.min(), coordinates.max(), POINTS
    )

    def profile(model: Any) -> Array:
        return jax.vmap(model.environment.terms[index].profile)(jnp.asarray(places))

    values = derive(posterior, profile)
    return Profile(
        places + float(term.offset),
        np.array([one.value for one in values]),
        np.array([one.sd for one in values]),
    )
