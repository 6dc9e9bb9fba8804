"""The candidate laws of a force of unknown structure."""

from pinav.forces.geometries import Center, Ellipse, Line
from pinav.forces.law_library import (
    CHANNEL,
    CONSTANT_FORCE,
    DOUBLE_WELL,
    GAUSSIAN_SWIRL,
    LATTICES,
    PLANE_WAVE,
    SADDLE,
    SOLID_ROTATION,
    WALL,
    profile_laws,
)
from pinav.forces.laws import AbstractLaw, ProfileLaw, Turned
from pinav.forces.profiles import Gaussian, Harmonic

POTENTIALS: tuple[AbstractLaw, ...] = (
    CONSTANT_FORCE,
    *profile_laws(Center()),
    ProfileLaw(Gaussian(), Ellipse()),
    SADDLE,
    WALL,
    CHANNEL,
    PLANE_WAVE,
    LATTICES[0],
    DOUBLE_WELL,
)
"""Conservative candidates."""

ROTATIONS: tuple[AbstractLaw, ...] = (
    GAUSSIAN_SWIRL,
    SOLID_ROTATION,
    Turned(ProfileLaw(Harmonic(), Line())),
)
"""Candidates without a potential."""

LIBRARY: tuple[AbstractLaw, ...] = (*POTENTIALS, *ROTATIONS)
"""All candidates."""
