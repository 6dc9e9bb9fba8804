import dataclasses
import enum
import json
import random
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Bool, Float, Int
from tests.damage import damaged

from pinav.analysis.discovery.candidates import POTENTIALS, ROTATIONS
from pinav.arguments import Scalar
from pinav.codec import SHORT, decode, encode
from pinav.errors import InputError
from pinav.forces.laws import AbstractLaw
from pinav.runs import RunFolder


class Colour(enum.Enum):
    RED = "red"
    BLUE = "blue"


class Option(msgspec.Struct, frozen=True):
    count: int
    names: tuple[str, ...] = ()


class Pair(NamedTuple):
    first: float
    second: float = 2.0


class Circle(eqx.Module):
    DERIVED: ClassVar = ("diameter",)

    radius: float

    @property
    def diameter(self):
        return 2 * self.radius


class Map(eqx.Module):
    x: Float[np.ndarray, " column"]
    values: Float[np.ndarray, "row column"]
    near: Bool[np.ndarray, "row column"]


class Thing(eqx.Module):
    name: str
    flag: bool
    colour: Colour
    option: Option
    pair: Pair
    maps: dict[str, Map]
    counts: Int[np.ndarray, " item"]
    device: Float[Array, " item"]
    scalar: Scalar
    either: tuple[float, int]
    rows: tuple[Pair, ...] = ()
    missing: float | None = None


def thing(rng, rows=3, columns=4):
    values = rng.normal(size=(rows, columns))
    return Thing(
        name="a\u00e9",
        flag=True,
        colour=Colour.BLUE,
        option=Option(3, ("x",)),
        pair=Pair(float(rng.normal())),
        maps={"one": Map(np.arange(columns) + 0.0, values, values > 0)},
        counts=np.arange(columns),
        device=jnp.asarray(values[0]),
        scalar=float(values[0, 0]),
        either=(np.inf, 3),
        rows=(Pair(1.0), Pair(-np.inf, 1e-300)),
    )


def through_json(value):
    document, arrays = encode(value)
    return decode(type(value), json.loads(json.dumps(document)), arrays), arrays


@settings(max_examples=40)
@given(seed=st.integers(0, 9999), rows=st.integers(1, 30), columns=st.integers(1, 30))
def test_a_value_comes_back_bit_for_bit(seed, rows, columns):
    value = thing(np.random.default_rng(seed), rows, columns)
    found, arrays = through_json(value)
    assert eqx.tree_equal(found, value)
    for name in ("maps", "option", "colour", "rows", "either"):
        assert type(getattr(found, name)) is type(getattr(value, name))
    assert ("maps/one/values" in arrays) == (rows * columns > SHORT)
    assert isinstance(found.device, jax.Array)


@pytest.mark.parametrize("shape", [(0,), (1,), (SHORT,), (SHORT + 1,)])
@pytest.mark.parametrize("number", [0.1, np.nan, -np.inf])
def test_numbers_that_are_not_finite_are_kept(shape, number):
    value = Map(np.full(shape, number), np.zeros((2, *shape)), np.ones((2, *shape)) > 0)
    found, _ = through_json(value)
    np.testing.assert_array_equal(found.x, value.x)
    assert found.near.shape == value.near.shape


@dataclasses.dataclass(frozen=True)
class Holder:
    law: AbstractLaw


@pytest.mark.parametrize(
    "law", [*POTENTIALS, *ROTATIONS, POTENTIALS[0] + POTENTIALS[1]]
)
def test_a_member_of_a_family_says_its_kind(law):
    assert through_json(Holder(law))[0] == Holder(law)


def test_derived_quantities_are_written_for_scripts_and_not_read():
    assert encode(Circle(1.5)).document == {"radius": 1.5, "diameter": 3.0}
    assert decode(Circle, {"radius": 1.5, "diameter": 7.0}, {}) == Circle(1.5)
    assert decode(Circle, {"radius": 1.5}, {}) == Circle(1.5)


def test_a_scalar_of_jax_is_a_number():
    whole = thing(np.random.default_rng(0))
    document, _ = encode(dataclasses.replace(whole, scalar=jnp.asarray(2.5)))
    assert document["scalar"] == 2.5


def test_what_no_file_can_hold_is_a_fault_of_the_program():
    with pytest.raises(TypeError, match="first: a file cannot hold a function"):
        encode(Pair(lambda: 0))
    with pytest.raises(TypeError, match=r"Named.kind needs another name"):
        encode(Named("a"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("name"), "name: this key is missing"),
        (lambda d: d.update(other=1), "other: this key is unknown"),
        (lambda d: d.update(name=1), "name: expected text in quotes, got 1"),
        (lambda d: d.update(flag="x"), "flag: expected true or false"),
        (lambda d: d.update(colour=["red"]), "colour: expected one of red, blue"),
        (lambda d: d.update(either=[1.0]), "either: expected 2 values, got 1"),
        (lambda d: d.update(rows=[{"first": "x"}]), "rows/0/first: expected a number"),
        (lambda d: d.update(rows=[{"kind": {}}]), "rows/0/kind: {} is unknown"),
        (lambda d: d.update(counts=[0.5]), r"counts: expected the shape \(item\)"),
        (lambda d: d.update(counts=[[1], [2, 3]]), "counts: "),
        (
            lambda d: d["maps"]["one"].update(x=[1.0]),
            "maps/one/values: expected the sh",
        ),
        (lambda d: d["maps"]["one"].update(x={"array": [3]}), "x: is missing"),
    ],
)
def test_what_is_no_such_value_is_refused_where_it_stands(change, message):
    document, arrays = encode(thing(np.random.default_rng(0)))
    change(document)
    with pytest.raises(InputError, match=message):
        decode(Thing, document, arrays)


def test_arrays_that_nobody_reads_are_refused():
    document, arrays = encode(Pair(1.0))
    with pytest.raises(InputError, match="array more: no field has this name"):
        decode(Pair, document, arrays | {"more": np.zeros(3)})


@pytest.fixture
def folder(tmp_path):
    return RunFolder.create(tmp_path / "run", {}, overwrite=False)


def test_a_result_of_other_arrays_or_of_another_version_is_refused(folder):
    large = thing(np.random.default_rng(0), 20, 20)
    folder.store("thing", large)
    assert eqx.tree_equal(folder.load("thing", Thing), large)
    with pytest.raises(InputError, match="by another version of pinav; repeat"):
        folder.load("thing", Map)
    folder.write_arrays("thing.npz", {"maps/one/values": np.zeros((20, 20))})
    with pytest.raises(InputError, match=r"thing.npz does not belong to thing.json"):
        folder.load("thing", Thing)


def test_a_smaller_result_leaves_no_arrays_of_the_last_one(folder):
    folder.store("thing", thing(np.random.default_rng(0), 20, 20))
    folder.store("thing", Pair(1.0))
    assert folder.load("thing", Pair) == Pair(1.0)
    assert not folder.has("thing.npz")
    assert "thing.npz" not in folder.manifest.entries()


@pytest.mark.parametrize("seed", range(200))
@pytest.mark.parametrize("in_manifest", [True, False])
def test_damage_is_one_line(folder, seed, in_manifest):
    """With the hashes of the manifest, or by the reader alone, as after a copy."""
    whole = thing(np.random.default_rng(0), 20, 20)
    folder.store("thing", whole)
    rng = random.Random(seed)
    file = folder.path / rng.choice(("thing.json", "thing.npz"))
    file.write_bytes(damaged(file.read_bytes(), rng))
    if not in_manifest:
        (folder.path / "manifest.json").unlink()
    complaint, found = "", whole
    try:
        found = folder.load("thing", Thing)
    except InputError as error:
        complaint = str(error)
    assert "\n" not in complaint
    assert not complaint or f"{folder.path}/thing." in complaint
    assert eqx.tree_equal(found, whole) or not in_manifest


class Named(eqx.Module):
    kind: str
