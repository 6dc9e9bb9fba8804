"""Models as plain trees of numbers, which the explorer's page evaluates.

A module becomes a table with its class and its fields. The page knows the classes of
`EVALUATED`; any other cannot be shown.
"""

import base64
import dataclasses
import re
from typing import Any

import equinox as eqx
import jax
import numpy as np

from pinav.errors import InputError
from pinav.forces import SumForce, Superposition

Tree = dict[str, Any]

INLINE = 8
"""Arrays of at most so many numbers are written as numbers, longer ones as bytes."""

EVALUATED = frozenset(
    (
        *("Swimmer", "OverdampedSwimmer", "NeuralDynamics", "ZeroForce", "SumForce"),
        *("ConstantForce", "MagneticPropulsion", "RotatingField", "RollingPropulsion"),
        *("HeldProgramme", "LinearProgramme", "LinearDrag", "TensorDrag", "InFlow"),
        *("Advection", "Moving", "LinearMotion", "CircularMotion", "GaussianBarrier"),
        *("GaussianRidge", "GaussianSwirl", "HarmonicTrap", "KernelForce"),
        *("KernelPotential", "KernelStream", "KernelMixture", "TimedKernelPotential"),
        *("ChangingPotential", "NeuralForce", "NeuralPotential", "MLP", "Linear"),
        *("PositionFeatures", "PositionTimeFeatures", "LinearResponse"),
        *("StructuredForce", "CentralTerm", "EllipticTerm", "WallTerm", "LinearTerm"),
        *("HillLaw", "PlateauLaw", "RingLaw", "StepLaw", "ChannelLaw", "WaveLaw"),
        *("SaturatingResponse", "SlippingResponse", "StepOutResponse", "ZeroFlow"),
        *("UniformFlow", "ShearFlow", "PoiseuilleFlow", "VortexFlow", "SampledFlow"),
        *("SumFlow", "IsotropicTensor", "UniaxialTensor", "CholeskyTensor"),
        *("BrinkmanTensor", "ConstantDirector", "WavyDirector"),
    )
)
"""Classes that the page evaluates; `page/*.js` has an entry for each."""


def tree_of(value: Any) -> Any:
    """A model, or a part of it, as JSON holds it.

    Raises:
        InputError: it has a part that the page cannot evaluate.
    """
    if isinstance(value, Superposition):
        return tree_of(SumForce(value.terms))
    if isinstance(value, eqx.nn.MLP):
        _check_network(value)
        return {"kind": "MLP", "layers": [tree_of(layer) for layer in value.layers]}
    if isinstance(value, eqx.nn.Linear):
        weights = {"weight": tree_of(value.weight), "bias": tree_of(value.bias)}
        return {"kind": "Linear", **weights}
    if isinstance(value, eqx.Module):
        return _tree_of_module(value)
    if isinstance(value, tuple | list):
        return [tree_of(part) for part in value]
    if value is None or isinstance(value, bool | str):
        return value
    numbers = np.asarray(value, float)
    return numbers.tolist() if numbers.size <= INLINE else pack_array(numbers, "f8")


def _tree_of_module(value: eqx.Module) -> Tree:
    kind = type(value).__name__
    if kind not in EVALUATED or not type(value).__module__.startswith("pinav."):
        raise InputError(
            f"explore: the page cannot evaluate a {kind}; it knows the forces of pinav "
            "that docs/explore.md lists"
        )
    fields = dataclasses.fields(value)
    return {"kind": kind, **{f.name: tree_of(getattr(value, f.name)) for f in fields}}


def _check_network(network: eqx.nn.MLP) -> None:
    names = {getattr(network.activation, "__name__", "?")}
    final = network.final_activation(np.float64(0.3))
    if names != {"tanh"} or float(final) != 0.3:
        raise InputError(
            "explore: the page evaluates networks of tanh with a linear output, got "
            f"{', '.join(names)}"
        )


def pack_array(numbers: np.ndarray, dtype: str = "f4") -> Tree:
    """An array as its shape and the base64 of its bytes, least significant first."""
    data = np.ascontiguousarray(numbers, f"<{dtype}")
    text = base64.b64encode(data.tobytes()).decode("ascii")
    return {"shape": list(data.shape), dtype: text}


def leaf_table(tree: Any) -> list[Tree]:
    """Place and size of each array among the parameters, in the order of their vector.

    Args:
        tree: a model whose arrays are the parameters, and nothing else.
    """
    return [
        {"path": _words(path), "size": int(np.size(leaf))}
        for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]
    ]


def _words(path: tuple) -> list[str | int]:
    """The attributes and indices that lead to a leaf."""
    words = re.findall(r"\.(\w+)|\[(\d+)\]", jax.tree_util.keystr(path))
    return [name or int(index) for name, index in words]
