"""Functions of JAX as JavaScript: arrays that are read by their indices, and loops.

A function is traced once, and each primitive of its trace becomes an expression for one
entry of its result. Expressions nest until a value is read twice, or is summed over;
then a loop writes it into a buffer. What depends on the early inputs alone (parameters
and commands) is computed once for them, before the function that is called at each
time and state.
"""

import base64
import functools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core

Index = tuple[str, ...]

Tree = dict[str, Any]

LONGEST = 400
"""Characters of an expression above which its value is written into a buffer."""


class Value(NamedTuple):
    """An array of which JavaScript can tell each entry.

    Attributes:
        at: expression of the entry at an index.
        inputs: names of the inputs that it depends on.
        entry: expression of an entry of the memory that holds it; None where it has to
            be computed.
        places: place of each entry in that memory.
        constant: its numbers, where they depend on no input.
    """

    shape: tuple[int, ...]
    at: Callable[[Index], str]
    inputs: frozenset[str] = frozenset()
    entry: Callable[[str], str] | None = None
    places: np.ndarray = np.zeros((), int)
    constant: np.ndarray | None = None


class Program(NamedTuple):
    """A printed function.

    Attributes:
        text: a JavaScript function of the early inputs that returns a function of the
            late ones and of `out`, an array that it fills, row by row.
        inputs: names of the inputs that the result depends on.
    """

    text: str
    inputs: frozenset[str]


class UnknownPrimitive(Exception):
    """A function has a primitive that is not printed; the text is its name."""


Rule = Callable[["Printer", Any, list[Value]], list[Value]]


class Constants:
    """Arrays that printed functions read, each held once.

    Attributes:
        packed: the arrays, as the page decodes them.
    """

    def __init__(self) -> None:
        self.packed: list[Tree] = []
        self._names: dict[bytes, str] = {}

    def name(self, array: np.ndarray) -> str:
        """The variable that holds an array, row by row."""
        key = array.tobytes()
        if key not in self._names:
            self._names[key] = f"K{len(self.packed)}"
            self.packed.append(pack_array(array, "f8"))
        return self._names[key]

    def value(self, array: np.ndarray) -> Value:
        """A constant; where one number fills it, it stands in the expression itself."""
        numbers = array.astype(float)

        def entry(place: str) -> str:
            if not numbers.size:
                return "0"
            if place.isdigit() or np.all(numbers == numbers.flat[0]):
                return number(numbers.flat[int(place) if place.isdigit() else 0])
            return f"{self.name(numbers)}[{place}]"

        places = np.arange(array.size).reshape(array.shape)
        return self.stored(entry, places)._replace(constant=array)

    def stored(
        self,
        entry: Callable[[str], str],
        places: np.ndarray,
        inputs: frozenset[str] = frozenset(),
    ) -> Value:
        """An array in memory, whose entries are at these places."""
        find_strides = functools.cache(lambda: strides_of(places))

        def at(index: Index) -> str:
            if not places.size:
                return entry("0")  # of an empty array none is ever read
            start = int(places.flat[0])
            strides = find_strides()
            if strides is not None:
                return entry(linear(start, strides, index))
            rows = np.cumprod([1, *places.shape[:0:-1]])[::-1].tolist()
            table = self.name(places.astype(float))
            return entry(f"{table}[{linear(0, rows, index)}]")

        return Value(places.shape, at, inputs, entry, places)


class Printer:
    """The statements of one function, as they are written.

    Args:
        rules: how each primitive is printed.
        late: names of the inputs that change from call to call.
    """

    def __init__(
        self, constants: Constants, rules: dict[str, Rule], late: Sequence[str]
    ) -> None:
        self.constants = constants
        self.rules = rules
        self.late = frozenset(late)
        self.early_lines: list[str] = []
        self.late_lines: list[str] = []
        self.buffers: list[str] = []
        self.blocks: list[list[str]] = []
        self._serial = 0

    def name(self, letter: str) -> str:
        """A name that no other variable has."""
        self._serial += 1
        return f"{letter}{self._serial}"

    def buffer(self, shape: Sequence[int], inputs: frozenset[str]) -> Value:
        """An array of zeros at first, for statements to write into."""
        name, count = self.name("b"), int(np.prod(shape, dtype=int))
        self.buffers.append(f"const {name} = new Float64Array({count});")
        places = np.arange(count).reshape(shape)
        return self.constants.stored(lambda i: f"{name}[{i}]", places, inputs)

    def emit(self, text: str, inputs: frozenset[str]) -> None:
        """Add a statement: to the loop that is open, or where its inputs are known."""
        if self.blocks:
            self.blocks[-1].append(text)
        else:
            is_late = inputs & self.late
            (self.late_lines if is_late else self.early_lines).append(text)

    def store(self, value: Value) -> Value:
        """The value in memory, each entry computed once."""
        if value.entry is not None:
            return value
        if value.shape == ():
            name = self.name("s")
            self.emit(f"const {name} = {value.at(())};", value.inputs)
            places = np.zeros((), int)
            return self.constants.stored(lambda _: name, places, value.inputs)
        target = self.buffer(value.shape, value.inputs)
        self.write(value, target)
        return target

    def write(self, value: Value, target: Value, assign: str = "=") -> None:
        """Write, or add, each entry of a value to that of a target of its shape."""
        header, index = self.loops(value.shape)
        text = f"{header}{target.at(index)} {assign} {value.at(index)};"
        self.emit(text, value.inputs | target.inputs)

    def loops(self, shape: Sequence[int]) -> tuple[str, Index]:
        """Loops over an array, and the index inside of them."""
        index = tuple("0" if length == 1 else self.name("i") for length in shape)
        header = "".join(
            f"for (let {i} = 0; {i} < {length}; {i}++) "
            for i, length in zip(index, shape, strict=True)
            if length != 1
        )
        return header, index

    def run(self, jaxpr: Any, inputs: Sequence[Value]) -> list[Value]:
        """The results of a traced function, open or closed."""
        is_closed = isinstance(jaxpr, core.ClosedJaxpr)
        consts, jaxpr = (jaxpr.consts, jaxpr.jaxpr) if is_closed else ([], jaxpr)
        values: dict[Any, Value] = dict(zip(jaxpr.invars, inputs, strict=True))
        for variable, constant in zip(jaxpr.constvars, consts, strict=True):
            values[variable] = self.constants.value(np.asarray(constant))

        def read(variable: Any) -> Value:
            if isinstance(variable, core.Literal):
                return self.constants.value(np.asarray(variable.val))
            return values[variable]

        equations = _needed(jaxpr)
        uses = Counter(v for e in equations for v in _variables(e.invars))
        uses.update(_variables(jaxpr.outvars))
        for equation in equations:
            results = self._results(equation, [read(v) for v in equation.invars])
            for variable, result in zip(equation.outvars, results, strict=True):
                again = uses[variable] > 1 or _is_long(result)
                values[variable] = self.store(result) if again else result
        return [read(variable) for variable in jaxpr.outvars]

    def _results(self, equation: Any, inputs: list[Value]) -> list[Value]:
        name = equation.primitive.name
        if name not in self.rules:
            raise UnknownPrimitive(name)
        if union_of(inputs) & self.late:
            # Computed once for the early inputs, not at each call.
            inputs = [v if v.inputs & self.late else self.store(v) for v in inputs]
        return self.rules[name](self, equation, inputs)


def print_function(
    function: Callable[..., Any],
    early: dict[str, tuple[int, ...]],
    late: dict[str, tuple[int, ...]],
    constants: Constants,
    rules: dict[str, Rule],
) -> Program:
    """A function of JAX as JavaScript.

    Args:
        function: of the early and the late inputs, in this order; it returns an array.
        early: shape of each input that changes seldom, by name.
        late: shape of each input that changes from call to call, by name.
        constants: of the page; those of the function are added.
        rules: how each primitive is printed.

    Raises:
        UnknownPrimitive: there is no rule for a primitive.
    """
    shapes = {**early, **late}
    traced = jax.make_jaxpr(function)(
        *(jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes.values())
    )
    printer = Printer(constants, rules, tuple(late))
    inputs = []
    for name, shape in shapes.items():
        template = f"{name}[{{}}]" if shape else name
        places = np.arange(int(np.prod(shape, dtype=int))).reshape(shape)
        inputs.append(constants.stored(template.format, places, frozenset([name])))
    (result,) = printer.run(traced, inputs)
    if not result.inputs & printer.late:
        result = printer.store(result)
    size = int(np.prod(result.shape, dtype=int))
    places = np.arange(size).reshape(result.shape)
    out = constants.stored("out[{}]".format, places)
    header, index = printer.loops(result.shape)
    printer.late_lines.append(f"{header}{out.at(index)} = {result.at(index)};")
    body, before = map("\n".join, (printer.late_lines, printer.early_lines))
    text = (
        f"({', '.join(early)}) => {{\n"
        + "\n".join([*printer.buffers, before, ""])
        + f"return ({', '.join([*late, 'out'])}) => {{\n{body}\n}};\n}}"
    )
    return Program(text, result.inputs)


def union_of(values: Sequence[Value]) -> frozenset[str]:
    """Names of the inputs that any of several values depends on."""
    return frozenset[str]().union(*(value.inputs for value in values))


def strides_of(places: np.ndarray) -> list[int] | None:
    """Steps of places along each axis; None where they are not equal."""
    start, strides = int(places.flat[0]), []
    for axis, length in enumerate(places.shape):
        second = tuple(int(a == axis and length > 1) for a in range(places.ndim))
        strides.append(int(places[second]) - start)
    grid = np.indices(places.shape, sparse=True)
    steps = [part * stride for part, stride in zip(grid, strides, strict=True)]
    is_regular = np.array_equal(sum(steps, np.full(places.shape, start)), places)
    return strides if is_regular else None


def linear(start: int, strides: Sequence[int], index: Index) -> str:
    """Expression of a place: its start, and indices times strides."""
    terms = []
    for stride, i in zip(strides, index, strict=True):
        if i.isdigit():
            start += int(i) * stride
        elif stride:
            terms.append(i if stride == 1 else f"({i}) * {stride}")
    return " + ".join([*terms, str(start)] if start or not terms else terms)


def number(value: float | int) -> str:
    """A number as JavaScript reads it, to its last digit."""
    is_whole = value == np.trunc(value) and 0 < abs(value) < 1e15
    text = repr(int(value) if is_whole else float(value))
    text = text.replace("inf", "Infinity").replace("nan", "NaN")
    return f"({text})" if text.startswith("-") else text


def pack_array(numbers: np.ndarray, dtype: str = "f4") -> Tree:
    """An array as its shape and the base64 of its bytes, least significant first."""
    data = np.ascontiguousarray(numbers, f"<{dtype}")
    text = base64.b64encode(data.tobytes()).decode("ascii")
    return {"shape": list(data.shape), dtype: text}


def _variables(values: Sequence[Any]) -> list[Any]:
    return [value for value in values if not isinstance(value, core.Literal)]


def _is_long(value: Value) -> bool:
    if value.entry is not None:
        return False
    return len(value.at(("i",) * len(value.shape))) > LONGEST


def _needed(jaxpr: Any) -> list[Any]:
    """The equations on which the results depend."""
    wanted, kept = set(_variables(jaxpr.outvars)), []
    for equation in reversed(jaxpr.eqns):
        if not wanted.isdisjoint(equation.outvars):
            wanted.update(_variables(equation.invars))
            kept.append(equation)
    return kept[::-1]
