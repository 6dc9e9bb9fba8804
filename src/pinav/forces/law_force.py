"""The force of a law: what a file states, what is fitted and what is discovered."""

import itertools
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from pinav.arguments import Scalar, Vector, dimension, real_array
from pinav.errors import InputError
from pinav.forces.force import AbstractForce
from pinav.forces.formulas import NUMERIC, Role
from pinav.forces.geometries import AbstractGeometry, Center, Ellipse, Line
from pinav.forces.kernels import quarter_turn
from pinav.forces.law_library import FORMULAS
from pinav.forces.laws import (
    AbstractLaw,
    ProfileLaw,
    SumLaw,
    Turned,
    potential_of,
    terms_of,
)
from pinav.forces.profiles import PROFILES
from pinav.settings import POSITIVE


class LawForce(AbstractForce):
    """The force of a law; its constants train.

    A file states it by the name of a law, or names with plus signs between them, and
    the values of the constants in their order.

    Raises:
        InputError: there are more or fewer values than constants.
    """

    law: AbstractLaw = eqx.field(static=True)
    constants: Float[Array, " constant"] = eqx.field(
        metadata=dimension(lambda force: tuple(one.unit for one in force.law.constants))
    )

    def __check_init__(self) -> None:
        expected = (len(self.law.constants),)
        if np.shape(self.constants) != expected:
            names = ", ".join(constant.name for constant in self.law.constants)
            raise InputError(
                f"LawForce.constants: {self.law.name} expects shape {expected} "
                f"({names}), got {np.shape(self.constants)}"
            )

    @property
    def name(self) -> str:
        """Name of the law."""
        return self.law.name

    @classmethod
    def of(cls, name: str, constants: Float[ArrayLike, " constant"]) -> "LawForce":
        """The force of a law, or of a sum of laws, by its name.

        Raises:
            InputError: there is no such law, or a scale is not positive.
        """
        count = np.size(constants)
        laws = list(_named_laws(count))
        words = name.split(" + ")
        terms = [[law for law in laws if law.name == word] for word in words]
        for some in itertools.product(*terms):
            law = some[0] if len(some) == 1 else SumLaw(some)
            if len(law.constants) == count:
                return force_of(law, constants)
        raise InputError(
            f"LawForce.name: there is no law {name!r} of {count} constants"
        )

    def potential(self, t: Scalar, x: Vector) -> Float[Array, ""]:
        """Potential energy per mass [L² T⁻²].

        Raises:
            InputError: the law, or a term of it, has none.
        """
        if any(term.turns for term in terms_of(self.law)):
            raise InputError(f"LawForce.potential: {self.law.name} has none")
        return self._height(x, turns=False)

    def stream(self, x: Vector) -> Float[Array, ""]:
        """Stream function [L² T⁻²] of the terms that turn."""
        return self._height(x, turns=True)

    def _height(self, x: Vector, *, turns: bool) -> Float[Array, ""]:
        value = potential_of(self.law, self.constants, tuple(x), NUMERIC, turns=turns)
        return jnp.zeros((), x.dtype) + value

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        force = -jax.grad(lambda x: self._height(x, turns=False))(x)
        if not any(term.turns for term in terms_of(self.law)):
            return force
        return force - quarter_turn(jax.grad(self.stream)(x))


def force_of(law: AbstractLaw, *values: ArrayLike) -> LawForce:
    """A law with values of its constants, numbers and points, in their order.

    Raises:
        InputError: they are too many or too few, or a scale is a number <= 0.
    """
    force = LawForce(law, jnp.concatenate([jnp.ravel(real_array(v)) for v in values]))
    if not isinstance(force.constants, Tracer):
        for index in law.indices(Role.SCALE):
            name = f"{law.name}.{law.constants[index].name}"
            POSITIVE.check(name, float(force.constants[index]))
    return force


def _named_laws(count: int) -> Iterator[AbstractLaw]:
    """Laws that a file may name, whose constants are no more than so many."""
    several = (Center(count=places) for places in range(2, count // 2 + 1))
    planes = (Center(), Ellipse(), Line(), *several)
    laws = [law for geometry in planes for law in _profile_laws(geometry)]
    for law in (*laws, *FORMULAS):
        yield law
        if not law.turns:
            yield Turned(law)
    for geometry in (Center(1), Center(3)):
        yield from _profile_laws(geometry)


def _profile_laws(geometry: AbstractGeometry) -> Iterator[AbstractLaw]:
    """The laws of every profile that is found, or fitted, in a geometry."""
    for profile in PROFILES.values():
        if geometry.family in (*profile.found_in, *profile.fitted_in):
            yield ProfileLaw(profile, geometry)
