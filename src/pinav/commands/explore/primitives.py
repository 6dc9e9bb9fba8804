"""Rules by which each primitive of JAX is printed as JavaScript."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from pinav.commands.explore.printing import (
    Index,
    Printer,
    Rule,
    UnknownPrimitive,
    Value,
    number,
    union_of,
)

EXPRESSIONS = {
    **{
        name: f"Math.{name}({{}})"
        for name in (
            *("exp", "expm1", "log", "log1p", "sqrt", "cbrt", "abs", "sign", "floor"),
            *("ceil", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh"),
            *("tanh", "asinh", "acosh", "atanh"),
        )
    },
    **{name: f"Math.{name}({{}}, {{}})" for name in ("max", "min", "atan2")},
    **{
        name: f"({{}} {sign} {{}})"
        for name, sign in {
            **{"add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/"},
            **{"rem": "%", "pow": "**", "lt": "<", "le": "<=", "gt": ">", "ge": ">="},
            **{"lt_to": "<", "le_to": "<=", "eq": "==", "ne": "!=", "and": "&"},
            **{"or": "|", "xor": "^", "shift_right_logical": ">>>"},
        }.items()
    },
    "neg": "(-{})",
    "square": "({} ** 2)",
    "exp2": "(2 ** {})",
    "rsqrt": "(1 / Math.sqrt({}))",
    "logistic": "(1 / (1 + Math.exp(-{})))",
    "is_finite": "Number.isFinite({})",
    "clamp": "Math.min(Math.max({1}, {0}), {2})",
    "copy": "{}",
    "copy_p": "{}",
    "stop_gradient": "{}",
}
"""Primitives that act entry by entry: the expression of a result's entry."""


def combine(template: str, shape: Sequence[int], inputs: Sequence[Value]) -> Value:
    """Values that are combined entry by entry; a single number serves for all."""

    def at(index: Index) -> str:
        return template.format(*(v.at(index if v.shape else ()) for v in inputs))

    return Value(tuple(shape), at, union_of(inputs))


def entrywise(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """A primitive of one expression, which may depend on the types of numbers."""
    name, result = equation.primitive.name, equation.outvars[0].aval
    before = equation.invars[0].aval.dtype
    if np.issubdtype(result.dtype, np.complexfloating):
        raise UnknownPrimitive(f"complex {name}")
    inputs = [v if v.shape else printer.store(v) for v in inputs]
    if name == "integer_pow":
        template = f"({{}} ** {number(equation.params['y'])})"
    elif name == "convert_element_type":
        is_cut = np.issubdtype(before, np.floating) and result.dtype.kind in "iu"
        template = (
            "Math.trunc({})" if is_cut else "(+{})" if before == np.bool_ else "{}"
        )
        template = "(+({} != 0))" if result.dtype == np.bool_ else template
    elif name == "not":
        template = "(+!{})" if result.dtype == np.bool_ else "(~{})"
    else:
        template = EXPRESSIONS[name]
    if name == "div" and result.dtype.kind in "iu":
        template = f"Math.trunc{template}"
    return [combine(template, result.shape, inputs)]


def select(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """One of several values, chosen entry by entry."""
    which, *cases = [printer.store(inputs[0]), *inputs[1:]]
    template = "{1}"
    for k in range(1, len(cases)):
        template = f"({{0}} == {k} ? {{{k + 1}}} : {template})"
    return [combine(template, cases[0].shape, [which, *cases])]


def view(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """Entries at other places: the primitive itself tells which, applied to places."""
    value, *indices = inputs
    value = printer.store(value)
    places = evaluate(equation, [value.places, *_constants(equation, indices)])
    results = [
        printer.constants.stored(value.entry, new, value.inputs)
        for new in places
        if value.entry is not None
    ]
    if value.constant is None:
        return results
    numbers = evaluate(equation, [value.constant, *_constants(equation, indices)])
    return [r._replace(constant=n) for r, n in zip(results, numbers, strict=True)]


def assemble(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """An array of parts; the primitive itself tells their places, applied to places."""
    target = printer.buffer(equation.outvars[0].aval.shape, union_of(inputs))
    adds = equation.primitive.name == "scatter-add"
    if equation.primitive.name == "pad":
        everywhere = combine("{}", target.shape, [printer.store(inputs[1])])
        printer.write(everywhere, target)
        _place_part(printer, equation, inputs, 0, target)
    elif equation.primitive.name.startswith("scatter"):
        printer.write(inputs[0], target)
        _place_part(printer, equation, inputs, 2, target, "+=" if adds else "=")
    else:
        for k in range(len(inputs)):
            _place_part(printer, equation, inputs, k, target)
    return [target]


def _place_part(
    printer: Printer,
    equation: Any,
    inputs: list[Value],
    part: int,
    target: Value,
    assign: str = "=",
) -> None:
    """Write one of the inputs to where its entries are in the result."""
    is_scatter = equation.primitive.name.startswith("scatter")
    numbers = [np.zeros(v.shape, int) for v in inputs]
    if is_scatter:
        numbers[1] = _constants(equation, inputs[1:2])[0]
    shape = inputs[part].shape
    numbers[part] = np.arange(1, numbers[part].size + 1).reshape(shape)
    (marked,) = evaluate(equation, numbers)
    order = np.argsort(marked.ravel(), kind="stable")
    if len(order) < numbers[part].size or not np.array_equal(
        marked.ravel()[order][len(order) - numbers[part].size :], numbers[part].ravel()
    ):
        raise UnknownPrimitive(f"{equation.primitive.name} that overlaps or cuts off")
    places = order[len(order) - numbers[part].size :].reshape(shape)
    assert target.entry is not None
    there = printer.constants.stored(target.entry, places, target.inputs)
    printer.write(inputs[part], there, assign)


def dynamic_slice(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """A window that begins where it is told, held within the array."""
    value, shape = printer.store(inputs[0]), equation.outvars[0].aval.shape
    rooms = [whole - part for whole, part in zip(value.shape, shape, strict=True)]
    corner = [
        f"Math.min(Math.max({printer.store(start).at(())}, 0), {room})" if room else "0"
        for start, room in zip(inputs[1:], rooms, strict=True)
    ]

    def at(index: Index) -> str:
        return value.at(
            tuple(
                i if start == "0" else start if i == "0" else f"{i} + {start}"
                for i, start in zip(index, corner, strict=True)
            )
        )

    return [printer.store(Value(shape, at, union_of(inputs)))]


def gather(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """Windows that begin at given indices, held within the array."""
    if inputs[1].constant is not None:
        return view(printer, equation, inputs)
    value, indices = map(printer.store, inputs)
    numbers, sizes = (
        equation.params["dimension_numbers"],
        equation.params["slice_sizes"],
    )
    shape = equation.outvars[0].aval.shape
    batching = numbers.operand_batching_dims
    silent = {*numbers.collapsed_slice_dims, *batching}
    windows = [a for a in range(len(value.shape)) if a not in silent]

    def at(index: Index) -> str:
        where = [i for a, i in enumerate(index) if a not in numbers.offset_dims]
        place = ["0"] * len(value.shape)
        for axis, offset in zip(windows, numbers.offset_dims, strict=True):
            place[axis] = index[offset]
        for axis, source in zip(
            batching, numbers.start_indices_batching_dims, strict=True
        ):
            place[axis] = where[source]
        for k, axis in enumerate(numbers.start_index_map):
            start, room = indices.at((*where, str(k))), value.shape[axis] - sizes[axis]
            place[axis] += f" + Math.min(Math.max({start}, 0), {room})"
        return value.at(tuple(place))

    return [printer.store(Value(shape, at, union_of(inputs)))]


def contract(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """Products of two arrays, summed over common axes."""
    over, batch = equation.params["dimension_numbers"]
    shape = equation.outvars[0].aval.shape
    header, index = printer.loops(shape)
    inner, summed = printer.loops([inputs[0].shape[a] for a in over[0]])
    free, terms = iter(index[len(batch[0]) :]), []
    for side, value in enumerate(map(printer.store, inputs)):
        known = dict(zip(over[side], summed, strict=True))
        known |= dict(zip(batch[side], index, strict=False))
        axes = range(len(value.shape))
        terms.append(
            value.at(tuple(known[a] if a in known else next(free) for a in axes))
        )
    term = " * ".join(terms)
    return [
        _fold(printer, shape, inputs, (header, index, inner, term), FOLDS["reduce_sum"])
    ]


FOLDS = {
    "reduce_sum": ("0", "{0} + {1}"),
    "reduce_prod": ("1", "{0} * {1}"),
    "reduce_max": ("-Infinity", "Math.max({0}, {1})"),
    "reduce_min": ("Infinity", "Math.min({0}, {1})"),
    "reduce_and": ("1", "{0} & {1}"),
    "reduce_or": ("0", "{0} | {1}"),
}
"""Where each fold begins, and how it takes an entry more."""


def reduce(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """Entries folded over axes."""
    (value,), axes = inputs, equation.params["axes"]
    shape = equation.outvars[0].aval.shape
    header, index = printer.loops(shape)
    inner, over = printer.loops([value.shape[a] for a in axes])
    rest, along = iter(index), dict(zip(axes, over, strict=True))
    where = (along[a] if a in along else next(rest) for a in range(len(value.shape)))
    parts = header, index, inner, value.at(tuple(where))
    return [_fold(printer, shape, inputs, parts, FOLDS[equation.primitive.name])]


def _fold(
    printer: Printer,
    shape: Sequence[int],
    inputs: list[Value],
    parts: tuple[str, Index, str, str],
    fold: tuple[str, str],
) -> Value:
    """A buffer whose entries are folded in an inner loop."""
    (header, index, inner, term), (start, step) = parts, fold
    target, total = printer.buffer(shape, union_of(inputs)), printer.name("a")
    text = f"{inner}{total} = {step.format(total, term)}; {target.at(index)} = {total};"
    printer.emit(f"{header}{{ let {total} = {start}; {text} }}", target.inputs)
    return target


def inline(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """A function within a function."""
    names = ("jaxpr", "call_jaxpr", "fun_jaxpr")
    function = next(equation.params[n] for n in names if n in equation.params)
    return printer.run(function, inputs)


def scan(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """A loop of known length, with what it carries and what it leaves at each turn."""
    p, everything = equation.params, union_of(inputs)
    first, count, length = p["num_consts"], p["num_carry"], p["length"]
    carried = [printer.buffer(v.shape, everything) for v in inputs[first:][:count]]
    for value, target in zip(inputs[first:], carried, strict=False):
        printer.write(value, target)
    consts = [printer.store(v) for v in inputs[:first]]
    given = [printer.store(v) for v in inputs[first + count :]]
    shapes = [variable.aval.shape for variable in equation.outvars[count:]]
    left = [printer.buffer(shape, everything) for shape in shapes]
    k = printer.name("k")
    turn = f"for (let {k} = 0; {k} < {length}; {k}++)"
    if p["reverse"]:
        turn = f"for (let {k} = {length - 1}; {k} >= 0; {k}--)"
    printer.blocks.append([])
    rows = [_row(value, k, everything) for value in given]
    results = printer.run(p["jaxpr"], [*consts, *carried, *rows])
    for result, target in zip(results[count:], left, strict=True):
        printer.write(result, _row(target, k, everything))
    # All that is carried on is read before the first of it is replaced.
    kept = [printer.buffer(value.shape, everything) for value in carried]
    for values, targets in ((results[:count], kept), (kept, carried)):
        for value, target in zip(values, targets, strict=True):
            printer.write(value, target)
    body = " ".join(printer.blocks.pop())
    printer.emit(f"{turn} {{ {body} }}", everything)
    return [*carried, *left]


def _row(value: Value, k: str, inputs: frozenset[str]) -> Value:
    return Value(value.shape[1:], lambda index: value.at((k, *index)), inputs)


def refuse(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
    """What is printed of constants alone.

    Raises:
        UnknownPrimitive: always.
    """
    raise UnknownPrimitive(equation.primitive.name)


def fold_constants(rule: Rule) -> Rule:
    """The rule for what depends on inputs; the rest is computed now."""

    def folded(printer: Printer, equation: Any, inputs: list[Value]) -> list[Value]:
        constants = [v.constant for v in inputs if v.constant is not None]
        if len(constants) < len(inputs):
            return rule(printer, equation, inputs)
        return [printer.constants.value(n) for n in evaluate(equation, constants)]

    return folded


def evaluate(equation: Any, arrays: Sequence[Any]) -> list[np.ndarray]:
    """The results of a primitive for arrays of numbers."""
    inputs = [jax.numpy.asarray(array) for array in arrays]
    results = equation.primitive.bind(*inputs, **equation.params)
    many = equation.primitive.multiple_results
    return [np.asarray(result) for result in (results if many else [results])]


def _constants(equation: Any, values: Sequence[Value]) -> list[np.ndarray]:
    numbers = [value.constant for value in values if value.constant is not None]
    if len(numbers) < len(values):
        raise UnknownPrimitive(f"{equation.primitive.name} at places that change")
    return numbers


def _table(rule: Callable[..., list[Value]], *names: str) -> dict[str, Rule]:
    return dict.fromkeys(names, rule)


RULES: dict[str, Rule] = {
    **_table(
        *(view, "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "transpose"),
        *("slice", "rev", "split", "unstack"),
    ),
    **_table(inline, "jit", "pjit", "closed_call", "custom_jvp_call", "checkpoint"),
    **_table(inline, "custom_vjp_call", "custom_vjp_call_jaxpr"),
    **_table(
        fold_constants(entrywise),
        *(*EXPRESSIONS, "integer_pow", "convert_element_type", "not"),
    ),
    **_table(fold_constants(assemble), "concatenate", "stack", "pad", "scatter"),
    **_table(fold_constants(assemble), "scatter-add"),
    **_table(fold_constants(refuse), "iota", "cumsum", "sort"),
    **_table(fold_constants(reduce), *FOLDS),
    "select_n": fold_constants(select),
    "dynamic_slice": fold_constants(dynamic_slice),
    "gather": gather,
    "dot_general": fold_constants(contract),
    "scan": fold_constants(scan),
}
"""The rule of each primitive that is printed, by its name."""
