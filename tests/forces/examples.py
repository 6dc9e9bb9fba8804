"""An example of every force of the package, on which all laws of forces are tried."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pinav import forces
from pinav.actuation import LinearProgramme, RotatingField, SaturatingResponse
from pinav.fitting.engine.unvisited import FieldDoubt, Ground, ProfileDoubt
from pinav.forces import GaussianBarrier, KernelPotential, LinearDrag
from pinav.forces.law_force import LawForce
from pinav.forces.law_library import GAUSSIAN
from pinav.navigation.task.steering import HeldThrust

KEY = jax.random.key(0)
T, X, V = 0.4, jnp.array([4.2, 5.5]), jnp.array([0.3, -0.1])
"""Where laws are tried."""

CENTERS = jnp.array([[4.0, 5.0], [5.0, 5.5], [4.5, 6.5]])
PLACES, WEIGHTS, WIDTH = jnp.arange(0.5, 3.0, 0.5), jnp.linspace(0.4, -0.2, 5), 0.6
MIDDLE = [5.0, 4.0]


def propulsion(moment=(0.0, 0.0, 1.0), axis=(0.0, 1.0)):
    """A magnetic propulsion, with the thrust of the paper unless given others."""
    field = RotatingField(amplitude=1.5, frequency=2.0)
    return forces.MagneticPropulsion(field, list(moment), gain=0.2, axis=list(axis))


def barrier():
    """A Gaussian hill."""
    return GaussianBarrier(height=2.0, center=MIDDLE, width=1.5)


def ground(force, dim):
    """What a force among some places tells of other places."""
    return Ground.of(force, np.random.default_rng(0).uniform(0.5, 6.0, (60, dim)))


def drawn(doubt):
    """A force on unvisited ground."""
    return doubt.draw(np.random.default_rng(1))


def network(outputs):
    """The features and the network of a learned force."""
    features = forces.PositionFeatures(center=(5.0, 4.0), scale=(2.0, 3.0))
    return forces.tanh_network(2, outputs, width=3, depth=1, key=KEY), features


def kernel_force():
    """Three kernels."""
    weights = jnp.array([[0.3, -0.2], [0.1, 0.5], [-0.4, 0.2]])
    return forces.KernelForce(weights, CENTERS, 0.7)


def kernel_potential():
    """Three kernels of a potential."""
    return KernelPotential(jnp.array([0.3, -0.2, 0.5]), CENTERS, 0.7)


def kernel_profile():
    """A force along both axes that depends on x."""
    places = np.array([[3.0, 4.0], [5.0, 7.0]])
    basis = forces.KernelBasis.around(
        (forces.KernelAxis(0),), places, across=3, margin=1
    )
    weights = jnp.linspace(-0.4, 0.5, 2 * len(basis.centers)).reshape(-1, 2)
    return forces.KernelProfile(weights, basis, (0, 1), 2)


def field_table():
    """A table of a smooth field in the plane."""

    def field(places):
        x, y, _ = places.T
        return np.stack([1 + 0.2 * x * y, 0.5 * x**2, 2 + np.sin(y)], axis=1)

    return forces.MagneticFieldTable.sample(field, (2.0, 3.0), (8.0, 9.0), (9, 14))


def vortex():
    """A flow that turns."""
    return forces.VortexFlow(0.4, [4, 4], 2.0)


PROGRAMME = LinearProgramme(
    jnp.array([0.0, 1.0]), jnp.array([2.0, 3.0]), jnp.array([0.3, 0.9])
)
CHANGE = forces.TimedKernelPotential(
    jnp.arange(15.0).reshape(3, 5) / 9, CENTERS, 0.7, 0.0, 2.0
)

TENSORS = {
    "isotropic": lambda: forces.IsotropicTensor(0.4),
    "uniaxial": lambda: forces.UniaxialTensor(0.2, 0.5, forces.ConstantDirector(0.4)),
    "varying director": lambda: forces.UniaxialTensor(
        0.2, 0.5, forces.WavyDirector(0.4, 0.8, [0.5, -0.3])
    ),
    "cholesky": lambda: forces.CholeskyTensor.of(jnp.array([[0.5, -0.2], [-0.2, 0.3]])),
    "brinkman": lambda: forces.BrinkmanTensor(
        0.3, 0.5, jnp.array([3.0, 1.0]), CENTERS[:2], 1.2
    ),
}
TERMS: dict[str, Callable[[], Any]] = {
    "central": lambda: forces.CentralTerm(WEIGHTS, CENTERS[0], PLACES, WIDTH),
    "elliptic": lambda: forces.EllipticTerm(
        WEIGHTS, CENTERS[0], jnp.array([0.2, -0.1]), PLACES, WIDTH
    ),
    "wall": lambda: forces.WallTerm(WEIGHTS, 0.6, CENTERS[0], PLACES, WIDTH),
    "obstacles": lambda: forces.ObstaclesTerm(WEIGHTS, CENTERS, PLACES, WIDTH),
    "lattice": lambda: forces.LatticeTerm(
        jnp.linspace(-0.3, 0.5, 12), jnp.array([[1.0, 0.1], [0.2, 0.9]]), X
    ),
    "linear": lambda: forces.LinearTerm(jnp.arange(5.0) / 9, CENTERS[0], 2.0),
    "hills": lambda: forces.HillsTerm(
        jnp.linspace(-0.4, 0.7, 6),
        CENTERS[:2],
        jnp.array([[0.3, 0.2, -0.4], [0.9, 0.0, 0.0]]),
    ),
}
FORCES: dict[str, Callable[[], Any]] = {
    "linear": lambda: LinearDrag(0.3),
    **{
        f"{name} drag": lambda make=make: forces.TensorDrag(make())
        for name, make in TENSORS.items()
    },
    "ridge": lambda: forces.gaussian_ridge(
        2.0, MIDDLE, length=3.0, width=0.8, angle=0.6
    ),
    "drawn force": lambda: drawn(FieldDoubt(ground(barrier(), 2))),
    "drawn profile": lambda: drawn(
        ProfileDoubt(TERMS["central"](), ground(TERMS["central"](), 1), 0.4)
    ),
    "swirl": lambda: forces.gaussian_swirl(2.0, MIDDLE, width=1.5),
    "random barriers": lambda: forces.random_barriers(
        forces.Domain((3.0, 3.0), (7.0, 7.0)),
        3,
        heights=(1.0, 2.0),
        widths=(1.0, 2.0),
        key=KEY,
    ),
    "circling barrier": lambda: forces.Moving(
        barrier(), forces.CircularMotion(1.0, 0.7, 0.3)
    ),
    "moving trap": lambda: forces.Moving(
        forces.HarmonicTrap(0.7, MIDDLE), forces.LinearMotion([1, 2])
    ),
    "drag in shear": lambda: forces.InFlow(LinearDrag(0.3), forces.ShearFlow(0.2, 1.0)),
    "drag in a channel": lambda: forces.InFlow(
        forces.TensorDrag(TENSORS["brinkman"]()), forces.PoiseuilleFlow(0.8, 5.0, 6.0)
    ),
    "drag in a vortex": lambda: forces.InFlow(LinearDrag(0.3), vortex()),
    "advection": lambda: forces.Advection(vortex()),
    "zero": forces.ZeroForce,
    "constant": lambda: forces.ConstantForce([0.3, -0.2]),
    "linear force": lambda: forces.LinearForce(
        jnp.array([[0.3, 0.1], [0.2, -0.4]]), [5, 4]
    ),
    "barrier": barrier,
    "trap": lambda: forces.HarmonicTrap(0.7, MIDDLE),
    "power hill": lambda: forces.power_hill(2.0, MIDDLE, 1.5, 0.5),
    "compact hill": lambda: forces.compact_hill(2.0, MIDDLE, 4.0),
    "ring": lambda: forces.ring_barrier(2.0, MIDDLE, 1.5, 0.8),
    "Yukawa": lambda: forces.profile_barrier("Yukawa", 2.0, MIDDLE, (1.5, 0.8)),
    "soft wall": lambda: forces.soft_wall(2.0, 0.6, 5.0, 1.2),
    "plane waves": lambda: forces.PlaneWaves(
        [0.5, 0.3], jnp.array([[1.0, 0.2], [-0.3, 0.8]]), [0.1, 0.7]
    ),
    "propulsion": propulsion,
    "tilted propulsion": lambda: propulsion((1.0, 0.5, -0.3)),
    "rolling": lambda: forces.RollingPropulsion(
        jnp.eye(2), SaturatingResponse(3.0), PROGRAMME, delay=0.1
    ),
    "scheduled thrust": lambda: forces.ScheduledThrust(
        *(jnp.array([0.0, 1.0]), jnp.ones((2, 2)), jnp.zeros((2, 2)), 0.1, 0.2)
    ),
    "held thrust": lambda: HeldThrust(jnp.array([0.3, -0.2])),
    "weight": lambda: forces.Weight(1.5, 50.0, [0.3, -1.0]),
    "double layer": lambda: forces.DoubleLayer(
        0.3, 1.2, 0.5, forces.Plane([0.2, 1.0], 0.4)
    ),
    "dipole pull": lambda: forces.DipolePull(field_table(), 0.7),
    "induction pull": lambda: forces.InductionPull(field_table(), 0.4),
    "network of position": lambda: forces.NeuralForce(*network(2), scale=0.7),
    "network of the paper": lambda: forces.paper_force(KEY),
    "neural potential": lambda: forces.NeuralPotential(*network(1), scale=0.7),
    "kernel force": kernel_force,
    "kernel potential": kernel_potential,
    "kernel profile": kernel_profile,
    "kernel stream": lambda: forces.KernelStream(
        jnp.array([0.3, -0.2, 0.5]), CENTERS, 0.7
    ),
    "kernel mixture": lambda: forces.KernelMixture(
        kernel_potential(),
        forces.KernelStream(jnp.array([0.1, -0.4, 0.2]), CENTERS, 0.7),
    ),
    "layered potential": lambda: forces.LayeredPotential(
        (kernel_potential(), KernelPotential(jnp.array([0.2]), CENTERS[:1], 0.4))
    ),
    "timed potential": lambda: CHANGE,
    "changing potential": lambda: forces.ChangingPotential(kernel_potential(), CHANGE),
    **{f"{name} term": make for name, make in TERMS.items()},
    "structured": lambda: forces.StructuredForce(
        (TERMS["wall"](),), kernel_potential()
    ),
    "law": lambda: LawForce(GAUSSIAN, jnp.array([2.0, 5.0, 4.0, 1.5])),
    "sum": lambda: LinearDrag(0.3) + barrier() + propulsion(),
}
